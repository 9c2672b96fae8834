"""Evaluations side by side: what each amounts to, how they differ, and what forbids to compare them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lerobot_adamanip.evaluation.groups import Group, hidden_boundaries, worth_showing
from lerobot_adamanip.evaluation.metrics import EvaluationSummary, summarise, warnings_of
from lerobot_adamanip.evaluation.rates import Difference, difference, success_summary
from lerobot_adamanip.evaluation.record import EpisodeRecord


@dataclass(frozen=True)
class GroupDifference:
    """Success of the first evaluation less that of another, in one group that both have episodes of."""

    first: str
    second: str
    group: Group
    success: Difference


@dataclass(frozen=True)
class Comparison:
    """One or more evaluations.

    Attributes:
        summaries: by label, in the order given; continuous hidden values are parted at the same places in all.
        differences: of the first from every other one on the same split of scenes, by group.
        warnings: what a reader has to know, see `warnings_of`.
    """

    summaries: Mapping[str, EvaluationSummary]
    differences: tuple[GroupDifference, ...]
    warnings: tuple[str, ...]

    @property
    def title(self) -> str:
        """What the rates are, and on whose scenes."""
        scenes = " and ".join(dict.fromkeys(summary.scenes for summary in self.summaries.values()))
        return f"Success on {scenes} scenes, with 95 % Wilson intervals"

    @property
    def groups(self) -> list[Group]:
        """The groups of any of them that say something of their own, in order."""
        found = [group for summary in self.summaries.values() for group in summary.groups]
        kinds = list(dict.fromkeys(group.by for group in found))
        ordered = sorted(dict.fromkeys(found), key=lambda group: kinds.index(group.by))
        return worth_showing(ordered)

    def to_json(self) -> dict[str, Any]:
        """Returns ``evaluations`` (label, and its summary with groups as a list), ``differences`` and ``warnings``.

        Each evaluation and each group has LeRobot's keys too, see `success_summary`.
        """
        return {
            "evaluations": [{"label": label, **_summary(summary)} for label, summary in self.summaries.items()],
            "differences": [
                {"first": one.first, "second": one.second, **asdict(one.group), **asdict(one.success)}
                for one in self.differences
            ],
            "warnings": list(self.warnings),
        }


def compare(evaluations: Mapping[str, Sequence[EpisodeRecord]]) -> Comparison:
    """Summarises evaluations and compares every one with the first.

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
    return Comparison(summaries, differences, tuple(warnings_of(summaries)))


def _summary(summary: EvaluationSummary) -> dict[str, Any]:
    groups = [
        {**asdict(group), **asdict(result), **success_summary(result.success)}
        for group, result in summary.groups.items()
    ]
    return {
        "episodes": summary.episodes,
        **success_summary(summary.overall.success),
        "scenes": summary.scenes,
        "repeats": summary.repeats,
        "groups": groups,
        "tried_locked_first": asdict(summary.tried_locked_first),
        "recovery": asdict(summary.recovery),
        "objects": {name: asdict(result) for name, result in summary.objects.items()},
        "failures": dict(summary.failures),
        "fingerprints": summary.fingerprints,
        "versions": summary.versions,
        "mechanism_presets": summary.mechanism_rules,
    }
