"""What a list of episodes amounts to: success with intervals, tries, failures by object. Pure functions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from lerobot_adamanip.evaluation.record import EpisodeRecord

Z95 = 1.959963984540054
"""Two-sided 95 % quantile of the normal distribution."""
BEST_TRIES = {"locked": 1.0, "direction": 0.5, "mode": 1.0}
"""Tries in vain, on average, of the best strategy that sees nothing either. A pull tells that a door is locked, and is
cheaper than its key. A direction is wrong half of the time. Of three motions, tried one after the other, zero, one or
two fail."""


@dataclass(frozen=True)
class Rate:
    """A share of episodes with its 95 % Wilson interval; ``rate`` is None, and the interval [0, 1], of no episodes."""

    count: int
    episodes: int
    rate: float | None
    low: float
    high: float


@dataclass(frozen=True)
class Tries:
    """Tries that led nowhere, per episode.

    Attributes:
        made: mean per episode.
        best: the same mean for the best strategy that does not see the hidden state either.
        wasted: ``made - best``. Below zero: luck, or success without the tries that knowing nothing costs on average.
    """

    made: float
    best: float
    wasted: float


@dataclass(frozen=True)
class ObjectResult:
    """Episodes and failures on one object."""

    episodes: int
    failures: int


@dataclass(frozen=True)
class EvaluationSummary:
    """What an evaluation amounts to.

    Attributes:
        episodes: counted, each once.
        repeats: records dropped because the same episode came again later in the log.
        overall, locked, unlocked, seen, unseen: success of all episodes and of those that were so.
        categories: success by category, in order of appearance.
        tried_locked_door_first: of the locked episodes, those that took the handle first and pulled in vain.
        key_frames_of_successes: mean; None without a success.
        tries: that led nowhere.
        objects: per object id, in order.
    """

    episodes: int
    repeats: int
    overall: Rate
    locked: Rate
    unlocked: Rate
    seen: Rate
    unseen: Rate
    categories: dict[str, Rate]
    tried_locked_door_first: Rate
    key_frames_of_successes: float | None
    tries: Tries
    objects: dict[str, ObjectResult]


def wilson_interval(count: int, episodes: int, z: float = Z95) -> tuple[float, float]:
    """Returns Wilson's score interval of a share ``count / episodes``; (0, 1) of no episodes. ``z`` is the quantile."""
    if not 0 <= count <= episodes:
        raise ValueError(f"count must be in 0 ... {episodes}, got {count}")
    if episodes == 0:
        return 0.0, 1.0
    share, z2 = count / episodes, z * z
    middle = (share + z2 / (2 * episodes)) / (1 + z2 / episodes)
    half = z / (1 + z2 / episodes) * math.sqrt(share * (1 - share) / episodes + z2 / (4 * episodes**2))
    # Rounding must not push the bounds past what they are exactly.
    low = 0.0 if count == 0 else max(0.0, middle - half)
    high = 1.0 if count == episodes else min(1.0, middle + half)
    return min(low, share), max(high, share)


def rate(count: int, episodes: int) -> Rate:
    """Returns a `Rate`."""
    low, high = wilson_interval(count, episodes)
    return Rate(count, episodes, count / episodes if episodes else None, low, high)


def difference_interval(first: Rate, second: Rate) -> tuple[float, float, float]:
    """Returns ``first - second`` and its 95 % interval (Newcombe 1998, method 10).

    Where zero lies outside, the difference is real. Two rates of no episodes differ by anything: (0, -1, 1).
    """
    if first.rate is None or second.rate is None:
        return 0.0, -1.0, 1.0
    difference = first.rate - second.rate
    down = math.hypot(first.rate - first.low, second.high - second.rate)
    up = math.hypot(first.high - first.rate, second.rate - second.low)
    return difference, max(-1.0, difference - down), min(1.0, difference + up)


def without_repeats(records: Iterable[EpisodeRecord]) -> list[EpisodeRecord]:
    """Returns the records with each episode once, the last one winning, in the order of those kept.

    An episode is its seed, object and hidden state. So an evaluation that was repeated into the same log is counted
    once, and one seed on seen and on unseen objects is two episodes.
    """
    last: dict[tuple[object, ...], EpisodeRecord] = {}
    for record in records:
        last.pop(record.identity, None)
        last[record.identity] = record
    return list(last.values())


def tried_locked_door_first(record: EpisodeRecord) -> bool:
    """Whether a robot took the handle first and pulled at a door that was locked."""
    return bool(record.locked) and record.first_part == "handle" and record.first_try_failed


def best_tries(record: EpisodeRecord) -> float:
    """Returns the tries in vain that the best strategy under the same uncertainty makes in this episode, on average."""
    hidden = record.hidden_state
    if record.locked is False:
        return 0.0
    return sum(cost for name, cost in BEST_TRIES.items() if name in hidden)


def count_tries(records: Sequence[EpisodeRecord]) -> Tries:
    """Counts tries that led nowhere, against the best possible under the same uncertainty.

    Made: each try at what opens that was blocked (``blocked_pulls``); each turn of the key against its direction
    (``wrong_turns``); and working the key of what was not locked, one (``key_moved``). Best: see `BEST_TRIES`.
    """
    made = best = 0.0
    for record in records:
        made += record.blocked_pulls + record.wrong_turns + (record.key_moved and record.locked is False)
        best += best_tries(record)
    number = max(1, len(records))
    return Tries(made / number, best / number, (made - best) / number)


def summarise(records: Sequence[EpisodeRecord]) -> EvaluationSummary:
    """Summarises the records of an evaluation, each episode counted once."""
    kept = without_repeats(records)

    def success(where: Callable[[EpisodeRecord], bool]) -> Rate:
        chosen = [record for record in kept if where(record)]
        return rate(sum(record.success for record in chosen), len(chosen))

    locked = [record for record in kept if record.locked is True]
    lengths = [record.key_frames for record in kept if record.success]
    return EvaluationSummary(
        episodes=len(kept),
        repeats=len(records) - len(kept),
        overall=success(lambda _: True),
        locked=success(lambda record: record.locked is True),
        unlocked=success(lambda record: record.locked is False),
        seen=success(lambda record: record.object_split == "seen"),
        unseen=success(lambda record: record.object_split == "unseen"),
        categories={
            name: success(lambda record, name=name: record.category == name)  # type: ignore[misc]
            for name in dict.fromkeys(record.category for record in kept)
        },
        tried_locked_door_first=rate(sum(map(tried_locked_door_first, locked)), len(locked)),
        key_frames_of_successes=sum(lengths) / len(lengths) if lengths else None,
        tries=count_tries(kept),
        objects=_by_object(kept),
    )


def _by_object(records: Sequence[EpisodeRecord]) -> dict[str, ObjectResult]:
    episodes = Counter(record.object_id for record in records)
    failures = Counter(record.object_id for record in records if not record.success)
    return {name: ObjectResult(episodes[name], failures[name]) for name in sorted(episodes)}
