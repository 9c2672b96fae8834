"""Classification of tries: causes of failure, tries after a failure, and the optimal blind strategy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from lerobot_adamanip.evaluation.rates import Rate, rate
from lerobot_adamanip.evaluation.record import EpisodeRecord, TryMade
from lerobot_adamanip.mechanisms import fixed_direction

BEST_TRIES = {
    "locked": (1.0, 1),
    "direction": (0.5, 1),
    "mode": (1.0, 2),
    "turn_range": (0.0, 1),
    "knob_range": (0.0, 1),
}
"""Hidden value -> failed tries of an optimal blind strategy, expected and at worst. It pulls at a locked door once,
because that is cheaper than turning the key. It turns the wrong way half of the time, and tries three modes in
sequence. How far a key turns is felt at its stop, where a turn may be cut short."""
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
    for joint, sign, fails in record.try_sequence:
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


def best_tries(record: EpisodeRecord) -> float:
    """Returns the expected failed tries of an optimal blind strategy in an episode, see `BEST_TRIES`."""
    tries = _best_tries(record.category, record.provenance.mechanism_rules, record.hidden_state)
    return 0.0 if record.locked is False else sum(expected for expected, _ in tries)


def within_best_tries(record: EpisodeRecord) -> bool:
    """Returns whether an episode succeeded with the failed tries that an optimal blind strategy needs at worst.

    They depend on the category, not on what is hidden in this episode: a policy does not know that either.
    """
    hidden, rules = record.hidden_state, record.provenance.mechanism_rules
    return record.success and record.failed_tries <= best_tries_at_worst(record.category, rules, hidden)


def best_tries_at_worst(category: str, mechanism_rules: str, hidden: Collection[str]) -> int:
    """Returns the failed tries that an optimal blind strategy needs at worst, see `BEST_TRIES`.

    Args:
        category: of the object.
        mechanism_rules: see `lerobot_adamanip.mechanisms.MECHANISM_RULES`.
        hidden: names of the hidden values.
    """
    return sum(worst for _, worst in _best_tries(category, mechanism_rules, hidden))


def _best_tries(category: str, mechanism_rules: str, hidden: Collection[str]) -> list[tuple[float, int]]:
    known = {"direction"} if fixed_direction(category, mechanism_rules) else set()
    return [tries for name, tries in BEST_TRIES.items() if name in hidden and name not in known]


def tried_locked_first(record: EpisodeRecord) -> bool:
    """Returns whether the first try was a pull at a locked door."""
    return bool(record.locked) and record.first_part == "handle" and record.first_try_failed


def recovery(records: Iterable[EpisodeRecord]) -> Recovery:
    """Counts the tries after failed tries in all episodes. Moving a joint resets the failures."""
    repeated, followed = 0, 0
    untried, decided = Counter[int](), Counter[int]()
    for record in records:
        for failed, latest, tried in _decisions(record.try_sequence):
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
