"""Success rates with confidence intervals. Pure functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

Z95 = 1.959963984540054
"""Two-sided 95 % quantile of the normal distribution."""
SUCCESS_KEYS = ("n_success", "n_episodes", "pc_success", "pc_success_ci95")
"""Keys of `success_summary`, for other tools; this package reads the counts instead."""


@dataclass(frozen=True)
class Rate:
    """Success rate with its 95 % Wilson interval. Without episodes ``rate`` is None and the interval [0, 1]."""

    count: int
    episodes: int
    rate: float | None
    low: float
    high: float


@dataclass(frozen=True)
class Difference:
    """Difference of two rates with its 95 % interval; significant if the interval excludes zero."""

    difference: float
    low: float
    high: float


def wilson_interval(count: int, episodes: int, z: float = Z95) -> tuple[float, float]:
    """Returns the Wilson score interval of ``count / episodes``; (0, 1) without episodes. ``z`` is the quantile."""
    if not 0 <= count <= episodes:
        raise ValueError(f"count must be in 0 ... {episodes}, got {count}")
    if episodes == 0:
        return 0.0, 1.0
    share, z2 = count / episodes, z * z
    middle = (share + z2 / (2 * episodes)) / (1 + z2 / episodes)
    half = z / (1 + z2 / episodes) * math.sqrt(share * (1 - share) / episodes + z2 / (4 * episodes**2))
    # Rounding must not move the bounds past their exact values.
    low = 0.0 if count == 0 else max(0.0, middle - half)
    high = 1.0 if count == episodes else min(1.0, middle + half)
    return min(low, share), max(high, share)


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
