"""Metrics of episodes. To add a metric, add a field to `Metrics`; reports, result files and tables then show it.

Values hold counts, so that several evaluations can be pooled: a `Rate`, a `Mean`, or a mapping of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, get_type_hints

from lerobot_adamanip.evaluation.groups import hidden_boundaries, hidden_names
from lerobot_adamanip.evaluation.metric_values import COUNT, Mean, add, decode, encode, mean_length, show
from lerobot_adamanip.evaluation.rates import SUCCESS_KEYS, Rate, rate, success_summary
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.text_format import interval_text
from lerobot_adamanip.evaluation.tries import (
    CAUSES,
    FAILED_AT,
    best_tries_expected,
    failed_at,
    failure_cause,
    made_tries,
    recovery,
    tried_locked_first,
    within_best_tries,
    within_own_tries,
)
from lerobot_adamanip.util.json_fields import Check, integer, table

Records = Sequence[EpisodeRecord]


@dataclass(frozen=True)
class Metric:
    """How to measure and show a field of `Metrics`.

    Attributes:
        title: column or row heading.
        measure: unique episodes -> value.
        kind: type of the value: `Rate`, `Mean` or dict.
        show: value -> text.
        by_objects: whether policy tables show it by split of objects.
        is_detail: whether short tables omit it.
    """

    title: str
    measure: Callable[[Records], Any]
    kind: type
    show: Callable[[Any], str] = show
    by_objects: bool = False
    is_detail: bool = True


def _solved(records: Records) -> list[EpisodeRecord]:
    return [record for record in records if record.success]


def _success(records: Records) -> Rate:
    return rate(len(_solved(records)), len(records))


def _tries_of_successes(records: Records, tries: Callable[[EpisodeRecord], float]) -> Mean:
    """Returns the mean tries of successes only: a failed episode with few tries must not improve the mean."""
    solved = _solved(records)
    return Mean(sum(map(tries, solved)), len(solved))


def _within_best_tries(records: Records) -> Rate:
    return rate(sum(map(within_best_tries, records)), len(records))


def _within_own_tries(records: Records) -> Rate:
    return rate(sum(map(within_own_tries, records)), len(records))


def _failed_tries(records: Records) -> Mean:
    return _tries_of_successes(records, made_tries)


def _wasted_tries(records: Records) -> Mean:
    return _tries_of_successes(records, lambda record: made_tries(record) - best_tries_expected(record))


def _tried_locked_first(records: Records) -> Rate:
    locked = [record for record in records if record.locked]
    return rate(sum(map(tried_locked_first, locked)), len(locked))


def _failed_at(records: Records) -> dict[str, Mean]:
    solved = _solved(records)
    found = Counter(kind for record in solved for kind in failed_at(record))
    return {kind: Mean(found[kind], len(solved)) for kind in FAILED_AT}


def _failures(records: Records) -> dict[str, int]:
    found = Counter(map(failure_cause, records))
    return {cause: found[cause] for cause in CAUSES}


def _by_hidden_value(records: Records) -> dict[str, Rate]:
    boundaries, found = hidden_boundaries(records), dict[str, list[bool]]()
    for record in records:
        for name in hidden_names(record.category, record.hidden_state, boundaries):
            found.setdefault(name, []).append(record.success)
    return {name: rate(sum(each), len(each)) for name, each in sorted(found.items())}


def _repeated(records: Records) -> Rate:
    return recovery(records).repeated


def _untried(records: Records) -> Mapping[int, Rate]:
    return recovery(records).untried


def _key_frames(records: Records) -> dict[int, int]:
    return dict(sorted(Counter(record.key_frames for record in _solved(records)).items()))


def _show_key_frames(lengths: Mapping[float, int]) -> str:
    mean = mean_length(lengths)
    return "-" if mean is None else f"{mean:.1f}"


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
        key_frames: number of key frames -> number of successes. Old results contain the mean only.
        failed_tries: mean per success.
        untried: number of different failed tries so far -> share of next tries that differ from all of them.
        tried_locked_first: share of locked episodes in which the first try is a pull.
    """

    success: Annotated[Rate, Metric("success", _success, Rate, interval_text)]
    within_best_tries: Annotated[
        Rate | None,
        Metric("opened within the best strategy's tries", _within_best_tries, Rate, by_objects=True, is_detail=False),
    ] = None
    within_own_tries: Annotated[Rate | None, Metric("opened within the scene's own tries", _within_own_tries, Rate)] = (
        None
    )
    wasted_tries: Annotated[
        Mean | None, Metric("wasted tries", _wasted_tries, Mean, by_objects=True, is_detail=False)
    ] = None
    repeated: Annotated[
        Rate | None, Metric("failed tries repeated", _repeated, Rate, by_objects=True, is_detail=False)
    ] = None
    failed_at: Annotated[Mapping[str, Mean] | None, Metric("a success's failed tries", _failed_at, dict)] = None
    failures: Annotated[Mapping[str, int] | None, Metric("how failures ended", _failures, dict)] = None
    hidden: Annotated[Mapping[str, Rate] | None, Metric("by what is hidden", _by_hidden_value, dict)] = None
    key_frames: Annotated[
        Mapping[float, int] | None, Metric("key frames of a success", _key_frames, dict, _show_key_frames)
    ] = None
    failed_tries: Annotated[Mean | None, Metric("failed tries", _failed_tries, Mean)] = None
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

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-serialisable dictionary; includes LeRobot's success keys for other tools."""
        found = {name: encode(getattr(self, name)) for name in METRICS if name != "success"}
        counts = {"episodes": self.success.episodes, "successes": self.success.count}
        return {**counts, **success_summary(self.success), **found}

    @classmethod
    def from_json(cls, name: str, content: object) -> Metrics:
        """Returns the metrics in decoded JSON; raises ValueError that names the invalid field."""
        known = {**dict.fromkeys(METRICS.keys() - {"success"}), **content} if isinstance(content, Mapping) else content
        found = _METRICS(name, known)
        episodes, successes = found.pop("episodes"), found.pop("successes")
        made = cls(success=rate(successes, episodes), **found)
        if made.key_frames is not None and sum(made.key_frames.values()) != successes:
            raise ValueError(f"{name}: key_frames are not of {successes} successes")
        if sum((made.failures or {}).values()) not in (0, episodes - successes):
            raise ValueError(f"{name}: causes are not of the episodes that failed")
        if any(each.episodes > episodes for each in (made.hidden or {}).values()):
            raise ValueError(f"{name}: a hidden value has more than {episodes} episodes")
        return made


METRICS: Mapping[str, Metric] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(Metrics, include_extras=True).items()
}
"""Name -> metric, in table order."""


def _check(metric: Metric) -> Check:
    def check(name: str, value: object) -> Any:
        found = None if value is None else decode(name, value)
        if not isinstance(found, metric.kind | None):
            raise ValueError(f"{name} is no {metric.kind.__name__.lower()}")
        return found

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
    found = list(several)
    return Metrics(**{name: add([getattr(each, name) for each in found]) for name in METRICS})
