"""What follows a try that failed: the same again, what has failed before, or something else. Pure functions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from lerobot_adamanip.evaluation.rates import Rate, rate
from lerobot_adamanip.evaluation.record import EpisodeRecord, TryMade


@dataclass(frozen=True)
class Recovery:
    """How tries follow each other.

    Attributes:
        repeated: of the failed tries that another one follows, those that are repeated unchanged: the same joint, sent
            the same way.
        untried: how many different tries have failed -> of the tries that follow, those that have not failed yet.
    """

    repeated: Rate
    untried: Mapping[int, Rate]


def recovery(records: Iterable[EpisodeRecord]) -> Recovery:
    """Counts over all episodes, successful or not. What has failed may work as soon as a joint has moved."""
    repeated, followed = 0, 0
    untried, decided = Counter[int](), Counter[int]()
    for record in records:
        for failed, latest, joint_and_sign in _decisions(record.try_sequence):
            followed += 1
            repeated += joint_and_sign == latest
            decided[len(failed)] += 1
            untried[len(failed)] += joint_and_sign not in failed
    return Recovery(
        rate(repeated, followed), {count: rate(untried[count], episodes) for count, episodes in sorted(decided.items())}
    )


def failed_since_motion[Try](failed: frozenset[Try], tried: Try, fails: bool) -> frozenset[Try]:
    """Returns what has failed since something last gave way, after one more try."""
    return failed | {tried} if fails else frozenset()


def _decisions(
    sequence: Iterable[TryMade],
) -> Iterator[tuple[frozenset[tuple[int, int]], tuple[int, int], tuple[int, int]]]:
    """Yields, for each try after a failed one: what has failed by then, the latest of it, and what is tried."""
    failed: frozenset[tuple[int, int]] = frozenset()
    latest: tuple[int, int] | None = None
    for joint, sign, fails in sequence:
        tried = joint, sign
        if failed and latest is not None:
            yield failed, latest, tried
        failed, latest = failed_since_motion(failed, tried, fails), tried
