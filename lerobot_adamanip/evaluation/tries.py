"""Classification of tries: causes of failure, tries after a failure, and the optimal blind strategy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from lerobot_adamanip.evaluation.rates import Rate, rate
from lerobot_adamanip.evaluation.record import EpisodeRecord, TryMade
from lerobot_adamanip.mechanisms import best_tries

NO_TRY, NOTHING_MOVED, KEY_MOVED, AJAR = "no try", "tried in vain", "key moved", "ajar"
CAUSES = (NO_TRY, NOTHING_MOVED, KEY_MOVED, AJAR)
"""Cause of a failed episode: no try; no joint moved; only the other joint (knob, cap, lever) moved; or the opening
joint moved, but not far enough."""
MIN_AJAR = 5e-3
"""Position of the opening joint above which it counts as ajar [rad or m]."""
PART_HELD, KEY_HELD, NO_FURTHER = "part held", "key held", "no further"
FAILED_AT = (PART_HELD, KEY_HELD, NO_FURTHER)
"""Cause of a failed try: the opening or the other joint is blocked, or a joint is at its limit after an earlier move
in the same direction."""


@dataclass(frozen=True)
class Recovery:
    """Statistics of tries after failed tries.

    Attributes:
        repeated: share of these failed tries that the next try repeats unchanged (same joint, same sign).
        untried: number of different failed tries so far -> share of next tries that differ from all of them.
    """

    repeated: Rate
    untried: Mapping[int, Rate]


def failure_cause(record: EpisodeRecord) -> str | None:
    """Returns the cause of an episode's failure, one of `CAUSES`; None for a success."""
    if record.success:
        return None
    if abs(next(iter(record.joints.values()), 0.0)) > MIN_AJAR:
        return AJAR
    if not record.try_sequence:
        return NO_TRY
    return KEY_MOVED if record.key_moved else NOTHING_MOVED


def failed_at(record: EpisodeRecord) -> list[str]:
    """Returns the cause of each failed try, one of `FAILED_AT`, in order."""
    moved = set[tuple[int, int]]()
    found = []
    for joint, sign, fails in record.counted_tries:
        if not fails:
            moved.add((joint, sign))
        elif (joint, sign) in moved:
            found.append(NO_FURTHER)
        else:
            found.append(KEY_HELD if joint else PART_HELD)
    return found


def made_tries(record: EpisodeRecord) -> int:
    """Returns the failed tries of an episode, plus one if the key of an unlocked object was moved."""
    return record.failed_tries + (record.key_moved and record.locked is False)


def best_tries_expected(record: EpisodeRecord) -> float:
    """Returns the expected failed tries of an optimal blind strategy in an episode, see `BEST_TRIES`."""
    return 0.0 if record.locked is False else _best_tries(record)[0]


def within_best_tries(record: EpisodeRecord) -> bool:
    """Returns whether an episode succeeded with the failed tries that an optimal blind strategy needs at worst.

    They depend on the category, not on what is hidden in this episode: a policy does not know that either.
    """
    return record.success and record.failed_tries <= _best_tries(record)[1]


def within_own_tries(record: EpisodeRecord) -> bool:
    """Returns whether an episode succeeded with the failed tries that its own hidden values make necessary at worst.

    An unlocked object needs none. This is stricter than `within_best_tries`, where others of the category are locked.
    """
    return record.success and record.failed_tries <= (0 if record.locked is False else _best_tries(record)[1])


def _best_tries(record: EpisodeRecord) -> tuple[float, int]:
    return best_tries(record.category, record.provenance.mechanism_rules, record.hidden_state)


def tried_locked_first(record: EpisodeRecord) -> bool:
    """Returns whether the first try was a pull at a locked door."""
    return bool(record.locked) and record.try_sequence[:1] == ((0, 1, True),)


def recovery(records: Iterable[EpisodeRecord]) -> Recovery:
    """Counts the tries after failed tries in all episodes. Moving a joint resets the failures."""
    repeated, followed = 0, 0
    untried, decided = Counter[int](), Counter[int]()
    for record in records:
        for failed, latest, tried in _decisions(record.counted_tries):
            followed += 1
            repeated += tried == latest
            decided[len(failed)] += 1
            untried[len(failed)] += tried not in failed
    return Recovery(
        rate(repeated, followed), {count: rate(untried[count], total) for count, total in sorted(decided.items())}
    )


def _decisions(
    sequence: Iterable[TryMade],
) -> Iterator[tuple[frozenset[tuple[int, int]], tuple[int, int], tuple[int, int]]]:
    """Yields, for each try after a failed one: the failures since the last motion, the latest failure, the try."""
    failed: frozenset[tuple[int, int]] = frozenset()
    latest: tuple[int, int] | None = None
    for joint, sign, fails in sequence:
        tried = joint, sign
        if failed and latest is not None:
            yield failed, latest, tried
        failed, latest = (failed | {tried} if fails else frozenset()), tried
