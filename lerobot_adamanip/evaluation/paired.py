"""Paired comparison: two policies in the same scenes. Pure functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from lerobot_adamanip.evaluation.metrics import within_best_tries
from lerobot_adamanip.evaluation.record import EpisodeRecord

FAILED, OPENED, WITHIN_TRIES = "0", "1", "2"
"""Outcome of a scene: failed; opened; opened within the failed tries that the best strategy needs at worst."""

MAX_COUNTED_TRIES = 9
"""Failed tries of a scene are counted up to this number, which is a digit."""


@dataclass(frozen=True)
class PairedDifference:
    """Difference of two success rates in the same scenes.

    Attributes:
        difference: mean over scenes and trainings.
        low, high: 95 % interval over the scenes; the spread between trainings is not in it.
        by_training: training seed -> difference.
    """

    difference: float
    low: float
    high: float
    by_training: Mapping[int, float]


def outcomes(records: Iterable[EpisodeRecord]) -> str:
    """Returns the outcomes of an evaluation's scenes in the order of their seeds, one digit each."""
    return "".join(
        WITHIN_TRIES if within_best_tries(record) else OPENED if record.success else FAILED
        for record in _in_order(records)
    )


def failed_tries(records: Iterable[EpisodeRecord]) -> str:
    """Returns the failed tries in an evaluation's scenes in the order of their seeds, one digit each, 9 for more."""
    return "".join(str(min(record.failed_tries, MAX_COUNTED_TRIES)) for record in _in_order(records))


def _in_order(records: Iterable[EpisodeRecord]) -> list[EpisodeRecord]:
    return sorted(records, key=lambda record: record.given_seed)


def paired_difference(
    pairs: Mapping[int, Sequence[tuple[str, str]]], min_outcome: str, repeats: int = 1
) -> PairedDifference:
    """Returns the difference of two policies, first minus second, in the share of scenes with at least ``min_outcome``.

    Equal seeds of several evaluations (categories) count as one scene, because they draw similar poses and hidden
    states. The interval is Student's t with one added scene for either policy (Bonett and Price 2012, for proportions),
    so it does not collapse where the policies agree. With C evaluations an added scene counts 1 / sqrt(C), the standard
    deviation of a mean over C independent ones; a whole scene would hide every small difference.

    Args:
        pairs: training seed -> outcomes of both policies in some evaluations, all of the same length.
        min_outcome: `OPENED` or `WITHIN_TRIES`.
        repeats: number of consecutive episodes that play one scene; their mean counts as one scene.
    """
    gaps = {}
    for seed, evaluations in pairs.items():
        gap = np.mean(
            [[(a >= min_outcome) - (b >= min_outcome) for a, b in zip(*pair, strict=True)] for pair in evaluations],
            axis=0,
        )
        gaps[seed] = np.array([gap[first : first + repeats].mean() for first in range(0, len(gap), repeats)])
    scenes = np.mean(list(gaps.values()), axis=0)
    added = max(map(len, pairs.values())) ** -0.5
    interval = stats.ttest_1samp([*scenes, added, -added], 0.0).confidence_interval()
    by_training = {seed: float(gap.mean()) for seed, gap in gaps.items()}
    low, high = max(-1.0, float(interval.low)), min(1.0, float(interval.high))
    return PairedDifference(float(scenes.mean()), low, high, by_training)
