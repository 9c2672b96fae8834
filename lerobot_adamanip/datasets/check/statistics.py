"""Check statistics: of each episode against its rows, and of the dataset against its episodes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.check.layout import STATS, Layout
from lerobot_adamanip.datasets.check.reading import points_last
from lerobot_adamanip.datasets.pose_statistics import unscaled_poses
from lerobot_adamanip.datasets.reading import MAX_STATISTICS_BYTES
from lerobot_adamanip.datasets.statistics import QUANTILES
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import listed
from lerobot_adamanip.util.json_fields import read

OF_PLACE = ("index", "episode_index", "task_index")
"""Columns whose statistics are not used; LeRobot's merging leaves them as they were."""
NEEDED = frozenset(("min", "max", "mean", "std", "count"))
_BINS = 5000
"""LeRobot reads quantiles off a histogram of so many bins."""
_ROUNDING, _ROUNDING_EACH = 1e-5, 2e-8
"""Of float32 means, relative to the largest value; and more for each number that numpy sums up one after the other."""
Stored = dict[str, dict[str, NDArray[np.float64]]]
"""Column -> statistic -> (episodes, D)."""
Statistics = dict[str, dict[str, NDArray[np.float64]]]
"""Column -> statistic -> (D,), of pictures (3, 1, 1)."""


def stored_statistics(table: pa.Table) -> Stored:
    """Returns the statistics of every episode, by row of ``meta/episodes``; without irregular ones."""
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
    """Compares episodes' statistics with their rows; skips episodes whose rows are known to be damaged.

    Args:
        where: places of the rows, whole episodes.
        columns: (R, ...) values.
        stored: statistics of all episodes.
        row_of: episode -> its row in ``stored``.
        report: takes one finding for each episode.
    """
    starts = where.starts()
    numbers = where.episodes[starts].tolist()
    rows = [row_of.get(number, 0) for number in numbers]  # an episode without metadata is known as damaged
    wrong: dict[int, list[str]] = {}
    for key, values in columns.items():
        if key in OF_PLACE:
            continue
        told, what = stored.get(key, {}), key
        if set(told) >= NEEDED:
            differ = _differ(values, starts, {name: each[rows] for name, each in told.items()})
        else:
            differ, what = np.ones(len(numbers), bool), f"none of {key}"
        for number in np.array(numbers)[differ].tolist():
            wrong.setdefault(number, []).append(what)
    for number, keys in wrong.items():
        if number not in report.damaged:
            report.add("episode-statistics", f"not those of its rows: {listed(keys)}", where.file, number)


def _differ(values: NDArray[Any], starts: NDArray[np.int64], told: dict[str, NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Returns (E,), which episodes' statistics are not those of the values; NaN counts as a difference."""
    counts = np.diff(np.r_[starts, len(values)])
    points = points_last(values)
    lowest = np.minimum.reduceat(points.min(axis=2), starts, axis=0)
    highest = np.maximum.reduceat(points.max(axis=2), starts, axis=0)
    elements = (counts * points.shape[2])[:, None]
    mean = np.add.reduceat(points.sum(axis=2, dtype=np.float64), starts, axis=0) / elements
    squares = np.add.reduceat(np.einsum("rdp,rdp->rd", points, points, dtype=np.float64), starts, axis=0) / elements
    if any(each.shape[1] != mean.shape[1] for name, each in told.items() if name != "count"):
        return np.ones(len(starts), bool)
    largest = np.maximum(np.abs(lowest), np.abs(highest)) + 1e-6
    rounding = _ROUNDING + _ROUNDING_EACH * elements
    near = np.abs(told["min"] - lowest) <= _ROUNDING * largest
    near &= np.abs(told["max"] - highest) <= _ROUNDING * largest
    near &= np.abs(told["mean"] - mean) <= rounding * largest
    # A difference of squares in float32 rounds by as much as the squares do.
    near &= np.abs(told["std"] ** 2 - (squares - mean**2)) <= rounding * largest**2
    near &= told["count"] == counts[:, None]
    for name, share in QUANTILES.items():
        if name in told and (counts > 1).any():
            near &= _is_quantile(points, starts, told[name], share, (lowest, highest)) | (counts < 2)[:, None]
    return np.asarray(~near.all(axis=1))


def _is_quantile(
    points: NDArray[Any],
    starts: NDArray[np.int64],
    told: NDArray[np.float64],
    share: float,
    limits: tuple[NDArray[Any], NDArray[Any]],
) -> NDArray[np.bool_]:
    """Returns (E, D), whether a share of the values is below: two bins of LeRobot's histogram either way."""
    lengths = np.diff(np.r_[starts, len(points)])
    slack = 2.0 * (limits[1] - limits[0]).astype(np.float64) / _BINS + 1e-6 * (1.0 + np.abs(told))
    # In the points' own precision, so that no larger copy of a cloud is made.
    upper, lower = (np.repeat(each.astype(points.dtype), lengths, axis=0) for each in (told + slack, told - slack))
    wanted = share * (lengths * points.shape[2])[:, None]
    below = np.add.reduceat(np.count_nonzero(points <= upper[:, :, None], axis=2), starts, axis=0)
    strictly = np.add.reduceat(np.count_nonzero(points < lower[:, :, None], axis=2), starts, axis=0)
    return np.asarray((below >= wanted - 1e-6) & (strictly <= wanted + 1e-6))


def aggregated(stored: Stored, pictures: Collection[str]) -> Statistics:
    """Returns the statistics of the dataset: LeRobot's aggregation of its episodes'.

    Args:
        stored: statistics of the episodes.
        pictures: columns whose statistics are of shape (3, 1, 1), or (1, 1, 1) of depth.
    """
    from lerobot.datasets.compute_stats import aggregate_stats

    whole = {key: told for key, told in stored.items() if set(told) >= NEEDED}

    def of_episode(row: int) -> Statistics:
        return {
            key: {
                name: values[row].reshape(-1, 1, 1) if key in pictures and name != "count" else values[row]
                for name, values in told.items()
            }
            for key, told in whole.items()
        }

    episodes = min((len(told["count"]) for told in whole.values()), default=0)
    return aggregate_stats([of_episode(row) for row in range(episodes)]) if episodes else {}


def read_statistics(root: Path) -> Statistics:
    """Returns ``meta/stats.json``, every statistic flat; raises OSError or ValueError."""
    content = read(root / STATS, max_bytes=MAX_STATISTICS_BYTES)
    if not isinstance(content, dict):
        raise ValueError("no statistics by column")
    try:
        return {
            key: {name: np.asarray(value, np.float64).reshape(-1) for name, value in told.items()}
            for key, told in content.items()
        }
    except (AttributeError, TypeError) as error:
        raise ValueError(f"not statistics by column: {error}") from error


def check_statistics(layout: Layout, stored: Stored, report: Report) -> None:
    """Compares ``meta/stats.json`` with the statistics of the episodes.

    Fixed ranges of rotation and gripper are no finding: see `pose_statistics.leave_poses_unscaled`.
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
        return  # it is unknown which episodes they are of
    # A lost column is a finding of its own.
    of_columns = {key: each for key, each in stored.items() if key in layout.info["features"]}
    wrong = []
    true = aggregated(of_columns, layout.picture_keys)
    fixed = unscaled_poses(true, layout.info["features"])
    for key, right in true.items():
        if key in OF_PLACE:
            continue
        if key not in told:
            wrong.append(f"none of {key}")
        elif names := [name for name in right if not any(_same(told[key], of[key], name) for of in (true, fixed))]:
            wrong.append(f"{key} ({listed(names)})")
    if wrong:
        report.add("statistics", f"not those of the episodes: {listed(wrong)}", STATS)


def _same(told: Mapping[str, NDArray[np.float64]], right: Mapping[str, NDArray[np.float64]], name: str) -> bool:
    found, wanted = told.get(name), right[name].reshape(-1)
    if found is None or found.shape != wanted.shape:
        return False
    scale = max(float(np.abs(right["min"]).max()), float(np.abs(right["max"]).max())) + 1e-6
    return bool(np.all(np.abs(found - wanted) <= 1e-4 * scale + 1e-6 * np.abs(wanted)))
