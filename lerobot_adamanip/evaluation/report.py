"""Comparison of evaluations: metrics by group, differences, and warnings about incomparable runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract.versions import joined_versions, mixed_versions
from lerobot_adamanip.evaluation.groups import (
    ALL,
    Boundaries,
    Group,
    group_records,
    hidden_boundaries,
    without_repeats,
    worth_showing,
)
from lerobot_adamanip.evaluation.metric_values import Mean, encode
from lerobot_adamanip.evaluation.metrics import METRICS, Metrics, measure
from lerobot_adamanip.evaluation.rates import Difference, Rate, difference, rate
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.text_format import interval_text
from lerobot_adamanip.mechanisms.unchanged_rules import unchanged_rules

_MADE_BY = ("simulation_version", "version", "mechanism_rules")
_NO_DATA = frozenset({"-", "0/0"})
_LIMITS = {"max_key_frames": "lengths of episodes", "max_failed_tries": "limits of failed tries", "poses": "poses"}
"""Field of a record that decides how hard its episode is -> what a warning calls its values."""


@dataclass(frozen=True)
class EvaluationSummary:
    """Summary of one evaluation.

    Attributes:
        episodes: number of unique episodes.
        repeats: number of dropped records whose episode appears again later.
        groups: metrics of each group; `ALL` always exists and comes first.
        objects: success by object id.
        made_by: ``simulation_version``, ``version`` and ``mechanism_rules`` -> values that occur; more than one each
            if evaluations were mixed.
        versions: installed versions by name; different ones are joined by ``and``.
        limits: field of a record in `_LIMITS` -> values that occur, as text.
    """

    episodes: int
    repeats: int
    groups: Mapping[Group, Metrics]
    objects: Mapping[str, Rate]
    made_by: Mapping[str, tuple[str, ...]]
    versions: Mapping[str, str]
    limits: Mapping[str, tuple[str, ...]]

    @property
    def scenes(self) -> str:
        """Split of the scenes; several are joined by ``and``."""
        return " and ".join(group.name for group in self.groups if group.by == "scenes")

    @property
    def overall(self) -> Metrics:
        """Metrics of all episodes."""
        return self.groups[ALL]

    def success(self, group: Group) -> Rate:
        """Returns the success rate of a group; a rate without episodes if the group does not exist."""
        return self.groups[group].success if group in self.groups else rate(0, 0)

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-serialisable dictionary, with LeRobot's keys for each success rate."""
        groups = [
            {**asdict(group), "success": asdict(found.success), **found.to_json()}
            for group, found in self.groups.items()
        ]
        objects = {
            name: {"episodes": each.episodes, "failures": each.episodes - each.count}
            for name, each in self.objects.items()
        }
        made_by = {f"{name.removesuffix('s')}s": values for name, values in self.made_by.items()}
        told = {"scenes": self.scenes, "repeats": self.repeats, "groups": groups, "objects": objects}
        return {**self.overall.to_json(), "episodes": self.episodes, **told, **made_by, "installed": self.versions}


def summarise(records: Sequence[EpisodeRecord], boundaries: Boundaries | None = None) -> EvaluationSummary:
    """Returns the summary of an evaluation; counts each episode once.

    Args:
        records: records of its log.
        boundaries: of continuous hidden values, see `hidden_boundaries`; by default those of these records.
    """
    kept = without_repeats(records)
    objects: dict[str, list[bool]] = {}
    for record in kept:
        objects.setdefault(record.object_id, []).append(record.success)
    return EvaluationSummary(
        episodes=len(kept),
        repeats=len(records) - len(kept),
        groups={group: measure(chosen) for group, chosen in group_records(kept, boundaries).items()},
        objects={name: rate(sum(each), len(each)) for name, each in sorted(objects.items())},
        made_by={name: tuple(sorted({str(getattr(each.provenance, name)) for each in kept})) for name in _MADE_BY},
        versions=joined_versions(each.provenance.versions for each in kept),
        limits={name: tuple(sorted({str(getattr(each, name)) for each in kept})) for name in _LIMITS},
    )


@dataclass(frozen=True)
class GroupDifference:
    """Success of the first evaluation minus that of another, in a group that both have."""

    first: str
    second: str
    group: Group
    success: Difference


@dataclass(frozen=True)
class Comparison:
    """Comparison of one or more evaluations.

    Attributes:
        summaries: by label, with equal boundaries of continuous hidden values.
        differences: of the first from each other one on the same scene split, by group.
        extra_tries: label of another one -> failed tries of the first minus its own, in the scenes that both opened.
        warnings: mixed or incomparable evaluations.
    """

    summaries: Mapping[str, EvaluationSummary]
    differences: tuple[GroupDifference, ...]
    extra_tries: Mapping[str, Mean]
    warnings: tuple[str, ...]

    @property
    def title(self) -> str:
        """Heading of tables and plots."""
        scenes = " and ".join(dict.fromkeys(summary.scenes for summary in self.summaries.values()))
        return f"Success on {scenes} scenes, with 95 % Wilson intervals"

    @property
    def groups(self) -> list[Group]:
        """Groups of all evaluations without repeats, in order."""
        found = [group for summary in self.summaries.values() for group in summary.groups]
        kinds = list(dict.fromkeys(group.by for group in found))
        return worth_showing(sorted(dict.fromkeys(found), key=lambda group: kinds.index(group.by)))

    def rows(self) -> Iterator[list[str]]:
        """Yields table rows: a name, and one cell per evaluation."""
        found = list(self.summaries.values())
        yield ["episodes", *(f"{summary.episodes} on {summary.scenes} scenes" for summary in found)]
        for group in self.groups:
            yield [group.label, *(interval_text(summary.success(group)) for summary in found)]
        rows = [
            [metric.title, *(summary.overall.show(name) for summary in found)]
            for name, metric in METRICS.items()
            if name not in ("success", "hidden")  # the groups show both
        ]
        for group in self.groups:
            if group.by in ("category", "hidden"):
                cells = [each.groups[group].show("wasted_tries") if group in each.groups else "-" for each in found]
                rows.append([f"wasted tries, {group.label}", *cells])
        yield from (row for row in rows if not set(row[1:]) <= _NO_DATA)

    def lines(self) -> Iterator[str]:
        """Yields the lines below the table: repeats, differences, failures by object, warnings."""
        if repeats := sum(summary.repeats for summary in self.summaries.values()):
            yield f"{repeats} repeated episodes were counted once, the last record of each."
        shown = set(self.groups)
        for one in self.differences:
            if one.group in shown:
                gap, low, high = (100 * value for value in (one.success.difference, one.success.low, one.success.high))
                yield f"{one.first} - {one.second}, {one.group.label}: {gap:+.1f} points [{low:+.1f}, {high:+.1f}]"
        for label, extra in self.extra_tries.items():
            if extra.value is not None:
                scenes = f"{extra.count} scenes that both opened"
                yield f"{next(iter(self.summaries))} - {label}, failed tries in the {scenes}: {extra.value:+.2f}"
        for label, summary in self.summaries.items():
            failed = [
                f"{name} {each.episodes - each.count}/{each.episodes}"
                for name, each in summary.objects.items()
                if each.count < each.episodes
            ]
            yield f"Failures by object, {label}: {', '.join(failed) or 'none'}"
        yield from (f"Warning: {warning}" for warning in self.warnings)

    def to_json(self) -> dict[str, Any]:
        """Returns ``evaluations`` (label, metrics, groups as a list), ``differences`` and ``warnings``."""
        return {
            "evaluations": [{"label": label, **summary.to_json()} for label, summary in self.summaries.items()],
            "differences": [
                {"first": one.first, "second": one.second, **asdict(one.group), **asdict(one.success)}
                for one in self.differences
            ],
            "extra_tries": encode(self.extra_tries),
            "warnings": list(self.warnings),
        }


def compare(evaluations: Mapping[str, Sequence[EpisodeRecord]]) -> Comparison:
    """Summarises evaluations and compares each one with the first.

    Args:
        evaluations: label -> records; at least one.
    """
    boundaries = hidden_boundaries(record for records in evaluations.values() for record in records)
    summaries = {label: summarise(records, boundaries) for label, records in evaluations.items()}
    (first, reference), *others = summaries.items()
    differences = tuple(
        GroupDifference(first, label, group, difference(reference.success(group), summary.success(group)))
        for label, summary in others
        if summary.scenes == reference.scenes
        for group in reference.groups
        if group in summary.groups
    )
    mine, *theirs = (_failed_tries(records) for records in evaluations.values())
    extra = {
        label: Mean(sum(mine[scene] - tries[scene] for scene in both), len(both))
        for label, tries in zip(list(evaluations)[1:], theirs, strict=True)
        for both in [mine.keys() & tries.keys()]
    }
    return Comparison(summaries, differences, extra, tuple(warnings_of(summaries)))


def _failed_tries(records: Sequence[EpisodeRecord]) -> dict[tuple[object, ...], int]:
    """Returns scene -> failed tries of the successes."""
    return {each.identity: each.failed_tries for each in without_repeats(records) if each.success}


def warnings_of(summaries: Mapping[str, EvaluationSummary]) -> Iterator[str]:
    """Yields warnings about mixed or incomparable evaluations."""
    for label, summary in summaries.items():
        if " and " in summary.scenes:
            yield f"{label}: {summary.scenes} scenes are mixed; a number is of one split"
        elif summary.scenes != "test":
            yield f"{label}: no test result, but one on {summary.scenes} scenes; lerobot-eval --env.split=test"
        if "train" in summary.scenes:
            yield f"{label}: scenes that demonstrations are recorded in are among these"
        for rules in summary.made_by["mechanism_rules"]:
            if line := unchanged_rules(map(category_of, summary.objects), rules):
                yield f"{label}: {line}"
        for name in ("simulation_version", "mechanism_rules"):
            if len(found := summary.made_by[name]) > 1:
                yield f"{label}: its episodes are of more than one {name.replace('_', ' ')}: {', '.join(found)}"
    compared: list[tuple[str, list[tuple[str, ...]]]] = [
        ("simulation versions", [summary.made_by["simulation_version"] for summary in summaries.values()]),
        ("mechanism rules", [summary.made_by["mechanism_rules"] for summary in summaries.values()]),
        ("splits of scenes", [(summary.scenes,) for summary in summaries.values()]),
        *((what, [summary.limits[name] for summary in summaries.values()]) for name, what in _LIMITS.items()),
    ]
    for what, sets in compared:
        if len(set(sets)) > 1:
            told = "; ".join(f"{label} {', '.join(one)}" for label, one in zip(summaries, sets, strict=True))
            yield f"not to be compared: {what} differ ({told})"
    if mixed := mixed_versions(summary.versions for summary in summaries.values()):
        yield f"measured with different versions installed: {mixed}"
