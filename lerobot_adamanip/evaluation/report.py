"""Comparison of evaluations: metrics by group, differences, and warnings about incomparable runs."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract.versions import joined_versions, mixed_versions
from lerobot_adamanip.evaluation.failed_tries import FailedTries, failed_tries_by_kind
from lerobot_adamanip.evaluation.metrics import METRICS, Metrics, count_tries, measure
from lerobot_adamanip.evaluation.rates import Difference, Mean, Rate, difference, encode, rate
from lerobot_adamanip.evaluation.record import (
    LIMITS,
    Boundaries,
    EpisodeRecord,
    hidden_boundaries,
    hidden_names,
    mixed_settings,
    without_repeats,
)
from lerobot_adamanip.evaluation.text_format import interval_text, markdown_table
from lerobot_adamanip.mechanisms.table import unchanged_rules

OBJECT_SPLITS = ("seen", "unseen", "novel", "external")
_SCENE_SPLITS = ("test", "validation", "train", "other")
_NO_DATA = frozenset({"-", "0/0"})
_MADE_BY = ("simulation_version", "version", "mechanism_rules")


@dataclass(frozen=True)
class Group:
    """Episodes with a common property.

    Attributes:
        by: ``all``, ``category``, ``objects``, ``category and objects``, ``scenes`` or ``hidden``.
        name: ``safe``, ``unseen``, ``safe, unseen``, ``test`` or ``safe: locked``.
    """

    by: str
    name: str

    @property
    def label(self) -> str:
        """Name in tables and plots."""
        return f"{self.name} {self.by}" if self.by in ("objects", "scenes") else self.name


ALL = Group("all", "all")


def groups_of(record: EpisodeRecord, boundaries: Boundaries) -> Iterator[Group]:
    """Yields every group that an episode belongs to."""
    objects = record.object_split or "external"
    yield ALL
    yield Group("category", record.category)
    yield Group("objects", objects)
    yield Group("category and objects", f"{record.category}, {objects}")
    yield Group("scenes", record.split or "other")
    for name in hidden_names(record.category, record.hidden_state, boundaries):
        yield Group("hidden", f"{record.category}: {name}")


def group_records(
    records: Sequence[EpisodeRecord], boundaries: Boundaries | None = None
) -> dict[Group, list[EpisodeRecord]]:
    """Returns group -> its episodes: ``all`` first, then sorted by kind of group.

    Args:
        records: unique episodes.
        boundaries: see `hidden_boundaries`; by default those of these records.
    """
    if boundaries is None:
        boundaries = hidden_boundaries((record.category, record.hidden_state) for record in records)
    groups: dict[Group, list[EpisodeRecord]] = {ALL: []}
    for record in records:
        for group in groups_of(record, boundaries):
            groups.setdefault(group, []).append(record)
    return {group: groups[group] for group in sorted(groups, key=_order)}


def _order(group: Group) -> tuple[int, int, str]:
    kinds = ("all", "category", "objects", "category and objects", "scenes", "hidden")
    names = {"objects": OBJECT_SPLITS, "scenes": _SCENE_SPLITS}.get(group.by, ())
    return (kinds.index(group.by), names.index(group.name) if group.name in names else 0, group.name)


def worth_showing(groups: Iterable[Group]) -> list[Group]:
    """Returns the groups without repeats: with a single category, its group equals ``all``."""
    groups = list(groups)
    names = {by: {group.name for group in groups if group.by == by} for by in ("category", "objects", "scenes")}
    hidden = {by for by in ("category", "scenes") if len(names[by]) < 2}
    if len(names["category"]) < 2 or len(names["objects"]) < 2:
        hidden.add("category and objects")
    return [group for group in groups if group.by not in hidden]


@dataclass(frozen=True)
class EvaluationSummary:
    """Summary of one evaluation.

    Attributes:
        episodes: number of unique episodes.
        repeats: number of dropped records whose episode appears again later.
        groups: metrics of each group; `ALL` always exists and comes first.
        composition: number of episodes of each category and split of objects, ``seen safe``, in each group.
        objects: success by object id.
        again: number of a repeat of a scene, 0 for the first episode -> success, and mean failed tries of its
            successes; empty if no scene is repeated.
        made_by: ``simulation_version``, ``version`` and ``mechanism_rules`` -> values that occur; several values if
            evaluations were mixed.
        versions: installed versions of each episode, by name.
        failed_tries: category -> kind of try -> number of failed ones, see `failed_tries`.
        limits: field of a record in `LIMITS` -> values that occur, as text.
        mixed: those with several values that are not to be mixed, see `mixed_settings`.
    """

    episodes: int
    repeats: int
    groups: Mapping[Group, Metrics]
    composition: Mapping[Group, Counter[str]]
    objects: Mapping[str, Rate]
    made_by: Mapping[str, tuple[str, ...]]
    versions: Sequence[Mapping[str, str]]
    limits: Mapping[str, tuple[str, ...]]
    mixed: Mapping[str, tuple[str, ...]]
    again: Mapping[int, tuple[Rate, Mean]]
    failed_tries: FailedTries

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
        again = [{"success": encode(success), "failed_tries": encode(tries)} for success, tries in self.again.values()]
        return {
            **self.overall.to_json(),
            "episodes": self.episodes,
            "scenes": self.scenes,
            "repeats": self.repeats,
            "groups": [
                {**asdict(group), "success": asdict(metrics.success), **metrics.to_json()}
                for group, metrics in self.groups.items()
            ],
            "objects": {
                name: {"episodes": success.episodes, "failures": success.episodes - success.count}
                for name, success in self.objects.items()
            },
            **({"again": again} if again else {}),
            "failed_tries_by_kind": self.failed_tries,
            **{f"{name.removesuffix('s')}s": values for name, values in self.made_by.items()},
            "installed": joined_versions(self.versions),
        }


def summarise(records: Sequence[EpisodeRecord], boundaries: Boundaries | None = None) -> EvaluationSummary:
    """Returns the summary of an evaluation; counts each episode once.

    Args:
        records: records of its log.
        boundaries: boundaries of continuous hidden values, see `hidden_boundaries`; by default those of these records.
    """
    kept = without_repeats(records)
    groups, objects = group_records(kept, boundaries), dict[str, list[bool]]()
    for record in kept:
        objects.setdefault(record.object_id, []).append(record.success)
    return EvaluationSummary(
        episodes=len(kept),
        repeats=len(records) - len(kept),
        groups={group: measure(part) for group, part in groups.items()},
        composition={
            group: Counter(f"{one.object_split or 'external'} {one.category}" for one in part)
            for group, part in groups.items()
        },
        objects={name: rate(sum(successes), len(successes)) for name, successes in sorted(objects.items())},
        made_by={name: tuple(sorted({str(getattr(one.provenance, name)) for one in kept})) for name in _MADE_BY},
        versions=[record.provenance.versions for record in kept],
        limits={name: tuple(sorted({str(getattr(record, name)) for record in kept})) for name in LIMITS},
        mixed=mixed_settings(kept),
        again=_again(kept) if max((record.repeat for record in kept), default=0) else {},
        failed_tries=failed_tries_by_kind(kept),
    )


def _again(records: Sequence[EpisodeRecord]) -> dict[int, tuple[Rate, Mean]]:
    result = {}
    for number in sorted({record.repeat for record in records}):
        part = [record for record in records if record.repeat == number]
        tries = [count_tries(record) for record in part if record.success]
        result[number] = rate(len(tries), len(part)), Mean(sum(tries), len(tries))
    return result


@dataclass(frozen=True)
class GroupDifference:
    """Success of the first evaluation minus that of another, in a group of equal composition."""

    first: str
    second: str
    group: Group
    success: Difference


@dataclass(frozen=True)
class Comparison:
    """Comparison of one or more evaluations.

    Attributes:
        summaries: by label, with equal boundaries of continuous hidden values.
        differences: success of the first evaluation minus that of each other one on the same scene split, by group.
            Without groups in which the two have different shares of categories or splits of objects.
        extra_tries: label of another evaluation -> failed tries of the first minus its own, where both succeeded.
    """

    summaries: Mapping[str, EvaluationSummary]
    differences: tuple[GroupDifference, ...]
    extra_tries: Mapping[str, Mean]

    @property
    def title(self) -> str:
        """Heading of tables and plots."""
        scenes = " and ".join(dict.fromkeys(summary.scenes for summary in self.summaries.values()))
        return f"Success on {scenes} scenes, with 95 % Wilson intervals"

    @property
    def groups(self) -> list[Group]:
        """Groups of all evaluations without repeats, in order."""
        groups = [group for summary in self.summaries.values() for group in summary.groups]
        kinds = list(dict.fromkeys(group.by for group in groups))
        return worth_showing(sorted(dict.fromkeys(groups), key=lambda group: kinds.index(group.by)))

    def table(self) -> str:
        """Returns a table with one column per evaluation, padded for a terminal."""
        return markdown_table(["", *self.summaries], self._rows(), align=True)

    def _rows(self) -> Iterator[list[str]]:
        summaries = list(self.summaries.values())
        yield ["episodes", *(f"{summary.episodes} on {summary.scenes} scenes" for summary in summaries)]
        for group in self.groups:
            yield [group.label, *(interval_text(summary.success(group)) for summary in summaries)]
        rows = [
            [metric.title, *(summary.overall.show(name) for summary in summaries)]
            for name, metric in METRICS.items()
            if name not in ("success", "hidden")  # the groups show both
        ]
        for group in self.groups:
            if group.by in ("category", "hidden"):
                parts = [summary.groups.get(group) for summary in summaries]
                cells = ["-" if metrics is None else metrics.show("wasted_tries") for metrics in parts]
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
                f"{name} {success.episodes - success.count}/{success.episodes}"
                for name, success in summary.objects.items()
                if success.count < success.episodes
            ]
            for number, (success, tries) in summary.again.items():
                mean = "-" if tries.value is None else f"{tries.value:.2f}"
                opened = f"{success.count}/{success.episodes} opened"
                yield f"Episode {number + 1} in a scene, {label}: {opened}, {mean} failed tries of a success"
            yield f"Failures by object, {label}: {', '.join(failed) or 'none'}"
        yield from (f"Warning: {warning}" for warning in self.warnings())

    def warnings(self) -> Iterator[str]:
        """Yields warnings about mixed or incomparable evaluations."""
        summaries = self.summaries.values()
        for label, summary in self.summaries.items():
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
                if len(values := summary.made_by[name]) > 1:
                    yield f"{label}: its episodes are of more than one {name.replace('_', ' ')}: {', '.join(values)}"
            for name, values in summary.mixed.items():
                yield f"{label}: {LIMITS[name]} are mixed ({', '.join(values)}); a number is of one setting"
        compared: dict[str, list[tuple[str, ...]]] = {
            "simulation versions": [summary.made_by["simulation_version"] for summary in summaries],
            "mechanism rules": [summary.made_by["mechanism_rules"] for summary in summaries],
            "splits of scenes": [(summary.scenes,) for summary in summaries],
            **{what: [summary.limits[name] for summary in summaries] for name, what in LIMITS.items()},
        }
        for what, values_by_label in compared.items():
            if len(set(values_by_label)) > 1:
                pairs = zip(self.summaries, values_by_label, strict=True)
                texts = "; ".join(f"{label} {', '.join(values)}" for label, values in pairs)
                yield f"not to be compared: {what} differ ({texts})"
        yield from self._not_compared()
        if mixed := mixed_versions(versions for summary in summaries for versions in summary.versions):
            yield f"measured with different versions installed: {mixed}"

    def _not_compared(self) -> Iterator[str]:
        """Yields which groups of two evaluations have no difference, and the episodes of the first such group."""
        (first, reference), *others = self.summaries.items()
        compared = {(one.second, one.group) for one in self.differences}
        for label, summary in others:
            shared = [group for group in self.groups if group in reference.groups and group in summary.groups]
            unlike = [group for group in shared if (label, group) not in compared]
            if unlike and summary.scenes == reference.scenes:
                own, other = (
                    ", ".join(f"{name} {count}" for name, count in one.composition[unlike[0]].items())
                    for one in (reference, summary)
                )
                names = ", ".join(group.label for group in unlike)
                yield f"{first} - {label}, no difference in {names}: other categories or objects ({own}; {other})"

    def to_json(self) -> dict[str, Any]:
        """Returns ``evaluations`` (label, metrics, groups as a list), ``differences`` and ``warnings``."""
        return {
            "evaluations": [{"label": label, **summary.to_json()} for label, summary in self.summaries.items()],
            "differences": [
                {"first": one.first, "second": one.second, **asdict(one.group), **asdict(one.success)}
                for one in self.differences
            ],
            "extra_tries": encode(self.extra_tries),
            "warnings": list(self.warnings()),
        }


def _shares(composition: Counter[str]) -> dict[str, Fraction]:
    return {name: Fraction(count, composition.total()) for name, count in composition.items()}


def compare(evaluations: Mapping[str, Sequence[EpisodeRecord]]) -> Comparison:
    """Summarises evaluations and compares each one with the first.

    Args:
        evaluations: label -> records; at least one.
    """
    records = itertools.chain.from_iterable(evaluations.values())
    boundaries = hidden_boundaries((record.category, record.hidden_state) for record in records)
    summaries = {label: summarise(records, boundaries) for label, records in evaluations.items()}
    (first, reference), *others = summaries.items()
    differences = tuple(
        GroupDifference(first, label, group, difference(reference.success(group), summary.success(group)))
        for label, summary in others
        if summary.scenes == reference.scenes
        for group, own in reference.composition.items()
        if (other := summary.composition.get(group)) and _shares(own) == _shares(other)
    )
    failed_tries = {
        label: {record.scene: count_tries(record) for record in without_repeats(records) if record.success}
        for label, records in evaluations.items()
    }
    extra = {}
    for label, _ in others:
        shared = failed_tries[first].keys() & failed_tries[label].keys()
        extra[label] = Mean(
            sum(failed_tries[first][scene] - failed_tries[label][scene] for scene in shared), len(shared)
        )
    return Comparison(summaries, differences, extra)
