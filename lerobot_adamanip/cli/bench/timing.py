"""How the benchmark measures and judges: medians after a warm-up, rates, limits. Pure, but for the clock."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

Limit = tuple[float, Literal["most", "least"]]


@dataclass
class Stopwatch:
    """Collects times of named stages [s]."""

    laps: dict[str, list[float]] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times what happens inside, as one more repeat of stage ``name``."""
        begin = time.perf_counter()
        yield
        self.laps.setdefault(name, []).append(time.perf_counter() - begin)

    def medians_ms(self, *, warm_up: int = 1) -> dict[str, float]:
        """Returns the median of each stage [ms], its first ``warm_up`` repeats left out if others remain."""
        return {name: median_ms(laps[warm_up:] or laps) for name, laps in self.laps.items()}


def median_ms(seconds: Sequence[float]) -> float:
    """Returns the median of durations [s] in ms, to the microsecond."""
    return round(1e3 * statistics.median(seconds), 3)


def repeat_ms(action: Callable[[], object], repeats: int, *, warm_up: int = 1) -> float:
    """Returns the median time of ``action()`` [ms] over ``repeats`` calls after ``warm_up`` more."""
    watch = Stopwatch()
    for _ in range(warm_up + repeats):
        with watch.stage("action"):
            action()
    return watch.medians_ms(warm_up=warm_up)["action"]


def compare_ms(plain: Callable[[], object], fast: Callable[[], object], repeats: int) -> dict[str, float]:
    """Times two ways of the same in turns, so that whatever else the machine does meets both.

    Returns ``plain_ms`` and ``ms``, medians after a warm-up, and ``speedup``, the median of each turn's ratio.
    """
    watch = Stopwatch()
    for _ in range(1 + repeats):
        for name, action in (("plain_ms", plain), ("ms", fast)):
            with watch.stage(name):
                action()
    ratios = [slow / quick for slow, quick in zip(watch.laps["plain_ms"], watch.laps["ms"], strict=True)]
    return {**watch.medians_ms(), "speedup": round(statistics.median(ratios[1:]), 2)}


def per_second(milliseconds: float) -> float:
    """Returns the rate [1/s] of something that takes so long [ms]."""
    return round(1e3 / milliseconds, 2) if milliseconds > 0 else 0.0


def ratio(slow: float, fast: float) -> float:
    """Returns how many times ``fast`` goes into ``slow``: a speed-up."""
    return round(slow / fast, 2) if fast > 0 else 0.0


def judge(measured: Mapping[str, float], limits: Mapping[str, Limit]) -> dict[str, dict[str, Any]]:
    """Returns {value, limit, kind, ok} for each limit whose quantity was measured; a limit itself is still ok."""
    return {
        name: {
            "value": measured[name],
            "limit": limit,
            "kind": kind,
            "ok": measured[name] <= limit if kind == "most" else measured[name] >= limit,
        }
        for name, (limit, kind) in limits.items()
        if name in measured
    }
