"""Values of metrics: a `Rate`, a `Mean`, a count, or a mapping of them; their intervals, JSON, text and sums."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from lerobot_adamanip.util.json_fields import integer, listing, mapping, number, table, text

SUCCESS_KEYS = ("n_success", "n_episodes", "pc_success", "pc_success_ci95")
"""Keys of `success_summary`, for other tools; this package reads the counts instead."""
LINE = text(r"[^\r\n|]{1,200}", "a line of at most 200 characters without |")
COUNT = integer(0, 10**9)
_PAIR = listing(COUNT, 2, 2)
_MEAN = table({"mean": number(-(10**6), 10**6), "of": COUNT})


@dataclass(frozen=True)
class Rate:
    """Success rate with its 95 % Wilson interval. Without episodes ``rate`` is None and the interval [0, 1]."""

    count: int
    episodes: int
    rate: float | None
    low: float
    high: float


@dataclass(frozen=True)
class Mean:
    """Mean over ``count`` episodes; ``value`` is None without episodes."""

    total: float
    count: int

    @property
    def value(self) -> float | None:
        """Mean value; None without episodes."""
        return self.total / self.count if self.count else None


@dataclass(frozen=True)
class Difference:
    """Difference of two rates with its 95 % interval; significant if the interval excludes zero."""

    difference: float
    low: float
    high: float


@functools.cache
def wilson_interval(count: int, episodes: int) -> tuple[float, float]:
    """Returns the 95 % Wilson score interval of ``count / episodes``; (0, 1) without episodes."""
    if not 0 <= count <= episodes:
        raise ValueError(f"count must be in 0 ... {episodes}, got {count}")
    if episodes == 0:
        return 0.0, 1.0
    from scipy.stats import binomtest  # the import takes most of a second

    interval = binomtest(count, episodes).proportion_ci(method="wilson")
    share = count / episodes  # rounding must not move a bound past it
    return min(float(interval.low), share), max(float(interval.high), share)


def rate(count: int, episodes: int) -> Rate:
    """Returns the `Rate` of some counts."""
    low, high = wilson_interval(count, episodes)
    return Rate(count, episodes, count / episodes if episodes else None, low, high)


def success_summary(success: Rate) -> dict[str, Any]:
    """Returns a success rate with the keys of `lerobot-eval` (LeRobot's pull request 4628), in percent.

    Without episodes, ``pc_success`` and both bounds are None; LeRobot writes NaN, which is invalid JSON.
    """
    known = success.rate is not None
    bounds = [100 * success.low, 100 * success.high] if known else [None, None]
    percent = 100 * success.count / success.episodes if known else None
    return dict(zip(SUCCESS_KEYS, (success.count, success.episodes, percent, bounds), strict=True))


def difference(first: Rate, second: Rate) -> Difference:
    """Returns ``first - second`` (Newcombe 1998, method 10); 0 in [-1, 1] if a rate has no episodes."""
    if first.rate is None or second.rate is None:
        return Difference(0.0, -1.0, 1.0)
    gap = first.rate - second.rate
    down = math.hypot(first.rate - first.low, second.high - second.rate)
    up = math.hypot(first.high - first.rate, second.rate - second.low)
    return Difference(gap, max(-1.0, gap - down), min(1.0, gap + up))


def encode(value: Any) -> Any:
    """Returns a value as JSON: a rate as ``[count, episodes]``, a mean as ``{"mean", "of"}``."""
    if isinstance(value, Rate):
        return [value.count, value.episodes]
    if isinstance(value, Mean):
        return {"mean": value.value or 0.0, "of": value.count}
    return {str(name): encode(part) for name, part in value.items()} if isinstance(value, Mapping) else value


def decode(name: str, value: object) -> Any:
    """Returns the value in decoded JSON; raises ValueError if it is invalid."""
    if isinstance(value, list):
        return rate(*_PAIR(name, value))
    if not isinstance(value, Mapping):
        return COUNT(name, value)
    if "of" in value:
        mean = _MEAN(name, value)
        return Mean(mean["mean"] * mean["of"], mean["of"])
    return mapping(_key, decode, 10_000)(name, value)


def _key(name: str, value: object) -> str | int | float:
    key = str(LINE(name, value))
    if key.isdecimal():
        return int(key)
    return float(key) if key.replace(".", "", 1).isdecimal() else key


def show(value: Any) -> str:
    """Returns a value as text; omits zeros in mappings and halves of continuous hidden values."""
    if isinstance(value, Rate):
        return f"{value.count}/{value.episodes}"
    if isinstance(value, Mean):
        return "-" if value.value is None else f"{value.value:.2f}"
    if not isinstance(value, Mapping):
        return str(value)
    if value and all(isinstance(part, Mean) and not part.count for part in value.values()):
        return "-"
    texts = {str(name): show(part) for name, part in value.items()}
    # The boundary between the halves of a range differs between evaluations.
    texts = {name: part for name, part in texts.items() if " < " not in name and " >= " not in name}
    return ", ".join(f"{name} {part}" for name, part in texts.items() if part not in ("0", "0.00")) or "none"


def add(values: Iterable[Any]) -> Any:
    """Returns the sum of a metric's values; ignores None, which means not measured."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    if isinstance(known[0], Rate):
        return rate(sum(value.count for value in known), sum(value.episodes for value in known))
    if isinstance(known[0], Mean):
        return Mean(sum(value.total for value in known), sum(value.count for value in known))
    if isinstance(known[0], Mapping):
        names = dict.fromkeys(name for value in known for name in value)
        return {name: add(value.get(name) for value in known) for name in names}
    return sum(known)
