"""Metrics of episodes. To add a metric, add a field to `Metrics`; reports, result files and tables then show it.

Values hold counts, so that several evaluations can be pooled: a `Rate`, a `Mean`, or a mapping of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, get_type_hints

from lerobot_adamanip.evaluation.rates import (
    COUNT,
    SUCCESS_KEYS,
    Mean,
    Rate,
    add,
    decode,
    encode,
    rate,
    show,
    success_summary,
)
from lerobot_adamanip.evaluation.record import EpisodeRecord, TryMade, hidden_boundaries, hidden_names
from lerobot_adamanip.evaluation.text_format import interval_text
from lerobot_adamanip.mechanisms import best_tries
from lerobot_adamanip.util.json_fields import Check, integer, table

NO_TRY, NOTHING_MOVED, KEY_MOVED, AJAR = "no try", "tried in vain", "key moved", "ajar"
CAUSES = (NO_TRY, NOTHING_MOVED, KEY_MOVED, AJAR)
"""Cause of a failed episode: no try; in the end, no joint is moved; only the other joint (knob, cap, lever) is; or the
opening joint is, but not far enough."""
MIN_AJAR = 5e-3
"""Position of the opening joint above which it counts as ajar [rad or m]."""
PART_HELD, KEY_HELD, NO_FURTHER = "part held", "key held", "no further"
FAILED_AT = (PART_HELD, KEY_HELD, NO_FURTHER)
"""Cause of a failed try: the opening or the other joint is blocked, or a joint is at its limit after an earlier move
in the same direction."""
Records = Sequence[EpisodeRecord]


# One episode ------------------------------------------------------------------------------------------------------


def failure_cause(record: EpisodeRecord) -> str | None:
    """Returns the cause of an episode's failure, one of `CAUSES`; None for a success."""
    if record.success:
        return None
    if abs(next(iter(record.joints.values()), 0.0)) > MIN_AJAR:
        return AJAR
    if not record.try_sequence:
        return NO_TRY
    return KEY_MOVED if record.key_moved else NOTHING_MOVED


def failed_at(record: EpisodeRecord) -> Iterator[str]:
    """Yields the cause of each failed try, one of `FAILED_AT`, in order."""
    moved = set[tuple[int, int]]()
    for joint, sign, failed in record.counted_tries:
        if not failed:
            moved.add((joint, sign))
        elif (joint, sign) in moved:
            yield NO_FURTHER
        else:
            yield KEY_HELD if joint else PART_HELD


def count_tries(record: EpisodeRecord) -> int:
    """Returns the failed tries of an episode, plus one if the key of an unlocked object was moved."""
    return record.failed_tries + (record.key_moved and record.locked is False)


def necessary_tries(record: EpisodeRecord) -> tuple[float, int]:
    """Returns the failed tries that a strategy without sight of the hidden state needs, expected and at worst.

    The numbers are the category's, because a policy does not know the hidden state of this episode.
    """
    return best_tries(record.category, record.provenance.mechanism_rules, record.hidden_state)


def within_best_tries(record: EpisodeRecord) -> bool:
    """Returns whether an episode succeeded with at most the failed tries that are necessary at worst."""
    return record.success and record.failed_tries <= necessary_tries(record)[1]


def within_own_tries(record: EpisodeRecord) -> bool:
    """Returns `within_best_tries`, but an unlocked object allows no failed try."""
    return record.success and record.failed_tries <= (0 if record.locked is False else necessary_tries(record)[1])


def wasted_tries(record: EpisodeRecord) -> float:
    """Returns the tries of an episode minus those that an optimal blind strategy must expect in it."""
    return count_tries(record) - (0.0 if record.locked is False else necessary_tries(record)[0])


def tried_locked_first(record: EpisodeRecord) -> bool:
    """Returns whether the first try was a pull at a locked door."""
    return bool(record.locked) and record.try_sequence[:1] == ((0, 1, True),)


# Several episodes -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Recovery:
    """Statistics of tries after failed tries.

    Attributes:
        repeated: share of these failed tries that the next try repeats unchanged (same joint, same sign).
        untried: number of different failed tries so far -> share of next tries that differ from all of them.
    """

    repeated: Rate
    untried: Mapping[int, Rate]


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
    failures: frozenset[tuple[int, int]] = frozenset()
    latest: tuple[int, int] | None = None
    for joint, sign, failed in sequence:
        tried = joint, sign
        if failures and latest is not None:
            yield failures, latest, tried
        failures, latest = (failures | {tried} if failed else frozenset()), tried


def _solved(records: Records) -> list[EpisodeRecord]:
    return [record for record in records if record.success]


def _share(is_counted: Callable[[EpisodeRecord], bool]) -> Callable[[Records], Rate]:
    return lambda records: rate(sum(map(is_counted, records)), len(records))


def _mean_of_successes(tries: Callable[[EpisodeRecord], float]) -> Callable[[Records], Mean]:
    """Returns a mean over successes only: a failed episode with few tries must not improve it."""

    def measure(records: Records) -> Mean:
        return Mean(sum(map(tries, _solved(records))), len(_solved(records)))

    return measure


def _tried_locked_first(records: Records) -> Rate:
    return rate(sum(map(tried_locked_first, records)), sum(bool(record.locked) for record in records))


def _failed_at(records: Records) -> dict[str, Mean]:
    solved = _solved(records)
    counts = Counter(cause for record in solved for cause in failed_at(record))
    return {cause: Mean(counts[cause], len(solved)) for cause in FAILED_AT}


def _failures(records: Records) -> dict[str, int]:
    counts = Counter(map(failure_cause, records))
    return {cause: counts[cause] for cause in CAUSES}


def _by_hidden_value(records: Records) -> dict[str, Rate]:
    boundaries = hidden_boundaries((record.category, record.hidden_state) for record in records)
    successes: dict[str, list[bool]] = {}
    for record in records:
        for name in hidden_names(record.category, record.hidden_state, boundaries):
            successes.setdefault(name, []).append(record.success)
    return {name: rate(sum(values), len(values)) for name, values in sorted(successes.items())}


def _repeated(records: Records) -> Rate:
    return recovery(records).repeated


def _untried(records: Records) -> Mapping[int, Rate]:
    return recovery(records).untried


def _key_frames(records: Records) -> dict[int, int]:
    return dict(sorted(Counter(record.key_frames for record in _solved(records)).items()))


def _show_key_frames(lengths: Mapping[float, int]) -> str:
    count = sum(lengths.values())
    return f"{sum(length * times for length, times in lengths.items()) / count:.1f}" if count else "-"


# Metrics ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Metric:
    """How to measure and show a field of `Metrics`.

    Attributes:
        title: column or row heading.
        measure: unique episodes -> value.
        kind: type of the value: `Rate`, `Mean` or dict.
        show: value -> text.
    """

    title: str
    measure: Callable[[Records], Any]
    kind: type
    show: Callable[[Any], str] = show


@dataclass(frozen=True)
class Metrics:
    """Metrics of a set of episodes. All fields except ``success`` are None if not measured.

    Attributes:
        success: success rate.
        within_best_tries: share of episodes opened with the failed tries that an optimal blind strategy needs at worst.
        within_own_tries: the same with the failed tries that the episode's own hidden values make necessary at worst.
        wasted_tries: failed tries of the successes minus those of an optimal blind strategy. A negative value means
            that the policy succeeds where its guess is right and fails elsewhere.
        repeated: share of failed tries that the next try repeats unchanged.
        failed_at: cause of a failed try, one of `FAILED_AT` -> mean count per success.
        failures: cause, one of `CAUSES` -> number of failed episodes.
        hidden: name of a hidden value -> success rate in its episodes; meaningful within one category.
        key_frames: number of steps (key frames, or rows at control rate) -> number of successes. Old results contain
            the mean only.
        failed_tries: mean per success.
        untried: number of different failed tries so far -> share of next tries that differ from all of them.
        tried_locked_first: share of locked episodes in which the first try is a pull.
    """

    success: Annotated[Rate, Metric("success", _share(lambda record: record.success), Rate, interval_text)]
    within_best_tries: Annotated[
        Rate | None, Metric("opened within the best strategy's tries", _share(within_best_tries), Rate)
    ] = None
    within_own_tries: Annotated[
        Rate | None, Metric("opened within the scene's own tries", _share(within_own_tries), Rate)
    ] = None
    wasted_tries: Annotated[Mean | None, Metric("wasted tries", _mean_of_successes(wasted_tries), Mean)] = None
    repeated: Annotated[Rate | None, Metric("failed tries repeated", _repeated, Rate)] = None
    failed_at: Annotated[Mapping[str, Mean] | None, Metric("a success's failed tries", _failed_at, dict)] = None
    failures: Annotated[Mapping[str, int] | None, Metric("how failures ended", _failures, dict)] = None
    hidden: Annotated[Mapping[str, Rate] | None, Metric("by what is hidden", _by_hidden_value, dict)] = None
    key_frames: Annotated[
        Mapping[float, int] | None, Metric("steps of a success", _key_frames, dict, _show_key_frames)
    ] = None
    failed_tries: Annotated[Mean | None, Metric("failed tries", _mean_of_successes(count_tries), Mean)] = None
    untried: Annotated[Mapping[int, Rate] | None, Metric("something new after N failed tries", _untried, dict)] = None
    tried_locked_first: Annotated[Rate | None, Metric("tried the locked door first", _tried_locked_first, Rate)] = None

    def show(self, name: str) -> str:
        """Returns a metric as text; ``-`` if it was not measured."""
        value = getattr(self, name)
        return "-" if value is None else METRICS[name].show(value)

    def opened_within(self, key_frames: int) -> Rate:
        """Returns the share of episodes that succeed within a number of key frames."""
        opened = sum(count for length, count in (self.key_frames or {}).items() if length <= key_frames)
        return rate(opened, self.success.episodes)

    def columns(self) -> dict[str, object]:
        """Returns all metrics as text, for a line of CSV; the success as counts and interval."""
        success = self.success
        counts = {"successes": success.count, "episodes": success.episodes}
        interval = {"low": f"{success.low:.4f}", "high": f"{success.high:.4f}"}
        return {**counts, **interval, **{name: self.show(name) for name in METRICS if name != "success"}}

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-serialisable dictionary; includes LeRobot's success keys for other tools."""
        others = {name: encode(getattr(self, name)) for name in METRICS if name != "success"}
        counts = {"episodes": self.success.episodes, "successes": self.success.count}
        return {**counts, **success_summary(self.success), **others}

    @classmethod
    def from_json(cls, name: str, content: object) -> Metrics:
        """Returns the metrics in decoded JSON; raises ValueError that names the invalid field."""
        known = {**dict.fromkeys(METRICS.keys() - {"success"}), **content} if isinstance(content, Mapping) else content
        values = _METRICS(name, known)
        episodes, successes = values.pop("episodes"), values.pop("successes")
        metrics = cls(success=rate(successes, episodes), **values)
        if metrics.key_frames is not None and sum(metrics.key_frames.values()) != successes:
            raise ValueError(f"{name}: key_frames do not add up to {successes} successes")
        if sum((metrics.failures or {}).values()) not in (0, episodes - successes):
            raise ValueError(f"{name}: failures do not add up to the failed episodes")
        if any(part.episodes > episodes for part in (metrics.hidden or {}).values()):
            raise ValueError(f"{name}: a hidden value has more than {episodes} episodes")
        within = metrics.within_best_tries
        if within and (within.episodes != episodes or within.count > successes):
            raise ValueError(f"{name}: within_best_tries has other episodes than success, or more successes")
        return metrics


METRICS: Mapping[str, Metric] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(Metrics, include_extras=True).items()
}
"""Name -> metric, in table order."""


def _check(metric: Metric) -> Check:
    def check(name: str, value: object) -> Any:
        decoded = None if value is None else decode(name, value)
        if not isinstance(decoded, metric.kind | None):
            raise ValueError(f"{name} is no {metric.kind.__name__.lower()}")
        return decoded

    return check


_METRICS = table(
    {
        "episodes": integer(1, 10**9),
        "successes": COUNT,
        **{name: _check(metric) for name, metric in METRICS.items() if name != "success"},
    },
    ignored=(*SUCCESS_KEYS, "interval"),
)


def measure(records: Records) -> Metrics:
    """Returns the metrics of unique episodes."""
    return Metrics(**{name: metric.measure(records) for name, metric in METRICS.items()})


def pool(several: Iterable[Metrics]) -> Metrics:
    """Returns the pooled metrics of one or more evaluations."""
    parts = list(several)
    return Metrics(**{name: add([getattr(part, name) for part in parts]) for name in METRICS})
