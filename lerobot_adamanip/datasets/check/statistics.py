"""Check the statistics of episodes against their rows, and of the dataset against its episodes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.check.layout import STATS, Layout
from lerobot_adamanip.datasets.pose_statistics import unscaled_poses
from lerobot_adamanip.datasets.reading import MAX_STATISTICS_BYTES
from lerobot_adamanip.datasets.statistics import QUANTILES
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import listed
from lerobot_adamanip.util.json_fields import read

OF_PLACE = ("index", "episode_index", "task_index")
"""Columns whose statistics are unused; LeRobot's merging does not update them."""
NEEDED = frozenset(("min", "max", "mean", "std", "count"))
_BINS = 5000
"""Number of bins of the histogram from which LeRobot takes quantiles."""
_ROUNDING, _ROUNDING_EACH = 1e-5, 2e-8
"""Rounding errors of float32 means, relative to the largest value: fixed part, and part per summed number."""
Stored = dict[str, dict[str, NDArray[np.float64]]]
"""Column -> statistic -> (episodes, D)."""
Statistics = dict[str, dict[str, NDArray[np.float64]]]
"""Column -> statistic -> (D,); for images (3, 1, 1)."""


def stored_statistics(table: pa.Table) -> Stored:
    """Returns the statistics of every episode, by row of ``meta/episodes``; skips irregular ones."""
    found: Stored = {}
    for name in table.column_names:
        values = numeric_array(table[name]) if name.startswith("stats/") and len(table) else None
        if values is not None:
            key, _, statistic = name.removeprefix("stats/").rpartition("/")
            found.setdefault(key, {})[statistic] = values.reshape(len(values), -1).astype(np.float64, copy=False)
    return found


def check_episode_statistics(
    where: Rows, columns: Mapping[str, NDArray[Any]], stored: Stored, row_of: Mapping[int, int], report: Report
) -> None:
    """Compares episodes' statistics with their rows; skips episodes that are known to be damaged.

    ``columns`` are (R, ...) values of whole episodes; ``row_of`` gives an episode's row in ``stored``.
    """
    for number, rows in where.runs():
        if number in report.damaged:
            continue
        wrong = []
        for key, values in columns.items():
            told = {name: each[row_of[number]] for name, each in stored.get(key, {}).items()}
            if key not in OF_PLACE and not set(told) >= NEEDED:
                wrong.append(f"none of {key}")
            elif key not in OF_PLACE and not _are_of(told, values[rows]):
                wrong.append(key)
        if wrong:
            report.add("episode-statistics", f"they differ from its rows: {listed(wrong)}", where.file, number)


def _are_of(told: Mapping[str, NDArray[np.float64]], values: NDArray[Any]) -> bool:
    """Returns whether statistics (D,) match an episode's values (T, ...); NaN is a difference."""
    numbers = values.astype(np.int8) if values.dtype == bool else values
    points = numbers.reshape(-1, values.shape[-1] if values.ndim > 1 else 1)
    if any(each.shape != points.shape[1:] for name, each in told.items() if name != "count"):
        return False
    lowest, highest = (points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64))
    largest = np.maximum(np.abs(lowest), np.abs(highest)) + 1e-6
    rounding = _ROUNDING + _ROUNDING_EACH * len(points)
    near = np.abs(told["min"] - lowest) <= _ROUNDING * largest
    near &= np.abs(told["max"] - highest) <= _ROUNDING * largest
    near &= np.abs(told["mean"] - points.mean(axis=0, dtype=np.float64)) <= rounding * largest
    # A difference of squares in float32 has the rounding error of the squares.
    near &= np.abs(told["std"] ** 2 - points.var(axis=0, dtype=np.float64)) <= rounding * largest**2
    near &= told["count"] == len(values)
    if len(values) > 1 and (names := [name for name in QUANTILES if name in told]):
        shares, found = np.array([QUANTILES[name] for name in names]), np.stack([told[name] for name in names])
        slack = 2.0 * (highest - lowest) / _BINS + 1e-6 * (1.0 + np.abs(found))
        # Equal values may begin right at the share.
        lower, upper = (np.quantile(points, shares + by, axis=0, method="inverted_cdf") for by in (-1e-6, 1e-6))
        near &= ((found >= lower - slack) & (found <= upper + slack)).all(axis=0)
    return bool(near.all())


def aggregated(stored: Stored, pictures: Collection[str]) -> Statistics:
    """Returns the statistics of the dataset, by LeRobot's aggregation of its episodes' statistics.

    Statistics of the columns ``pictures`` have shape (3, 1, 1), or (1, 1, 1) for depth.
    """
    from lerobot.datasets.compute_stats import aggregate_stats

    whole = {key: told for key, told in stored.items() if set(told) >= NEEDED}

    def shaped(key: str, name: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
        return value.reshape(-1, 1, 1) if key in pictures and name != "count" else value

    episodes = [
        {key: {name: shaped(key, name, each[row]) for name, each in told.items()} for key, told in whole.items()}
        for row in range(min((len(told["count"]) for told in whole.values()), default=0))
    ]
    return aggregate_stats(episodes) if episodes else {}


def read_statistics(root: Path) -> Statistics:
    """Returns ``meta/stats.json`` with flattened statistics; raises OSError or ValueError."""
    content = read(root / STATS, max_bytes=MAX_STATISTICS_BYTES)
    try:
        return {
            key: {name: np.asarray(value, np.float64).reshape(-1) for name, value in told.items()}
            for key, told in content.items()
        }
    except (AttributeError, TypeError) as error:
        raise ValueError(f"not statistics by column: {error}") from error


def check_statistics(layout: Layout, stored: Stored, report: Report) -> None:
    """Compares ``meta/stats.json`` with the statistics of the episodes.

    Accepts fixed ranges of rotation and gripper, see `pose_statistics.leave_poses_unscaled`.
    """
    try:
        told = read_statistics(layout.root)
    except FileNotFoundError:
        report.add("missing", "statistics of the dataset", STATS)
        return
    except (OSError, ValueError) as error:
        report.add("unreadable", str(error)[:200], STATS)
        return
    if not stored or len(layout.table) != layout.info["total_episodes"]:
        return  # unknown which episodes the statistics cover
    # A missing column has its own finding.
    true = aggregated({key: each for key, each in stored.items() if key in layout.features}, layout.picture_keys)
    fixed = unscaled_poses(true, layout.features)
    wrong = [f"none of {key}" for key in true if key not in told]
    for key in true.keys() & told.keys() - set(OF_PLACE):
        if names := [name for name in true[key] if not any(_same(told[key], of[key], name) for of in (true, fixed))]:
            wrong.append(f"{key} ({listed(names)})")
    if wrong:
        report.add("statistics", f"they differ from the episodes: {listed(sorted(wrong))}", STATS)


def _same(told: Mapping[str, NDArray[np.float64]], right: Mapping[str, NDArray[np.float64]], name: str) -> bool:
    found, wanted = told.get(name), right[name].reshape(-1)
    if found is None or found.shape != wanted.shape:
        return False
    scale = max(float(np.abs(right["min"]).max()), float(np.abs(right["max"]).max())) + 1e-6
    return bool(np.all(np.abs(found - wanted) <= 1e-4 * scale + 1e-6 * np.abs(wanted)))
