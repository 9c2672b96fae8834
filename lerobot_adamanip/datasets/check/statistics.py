"""Check the statistics of episodes against their rows, and of the dataset against its episodes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_adamanip.datasets.check.features import contract_of
from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.dataset import MAX_STATISTICS_BYTES, STATS, Dataset
from lerobot_adamanip.datasets.encoding import PLACE
from lerobot_adamanip.datasets.pose_statistics import unscaled_poses
from lerobot_adamanip.datasets.statistics import QUANTILES, row_statistics
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import listed
from lerobot_adamanip.util.json_fields import read

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
    """Returns the statistics of every episode, by row of `Dataset.statistics`; skips irregular ones."""
    result: Stored = {}
    for name in table.column_names:
        values = numeric_array(table[name]) if len(table) else None
        if values is not None:
            key, _, statistic = name.removeprefix("stats/").rpartition("/")
            result.setdefault(key, {})[statistic] = values.reshape(len(values), -1).astype(np.float64, copy=False)
    return result


def check_episode_statistics(
    where: Rows,
    columns: Mapping[str, NDArray[Any]],
    stored: Stored,
    row_of: Mapping[int, int],
    report: Report,
    *,
    ours: Collection[str] = (),
) -> None:
    """Compares episodes' statistics with their rows; skips episodes that are known to be damaged.

    ``columns``: (R, ...) values of whole episodes. ``row_of``: episode -> its row in ``stored``. ``ours``: columns that
    must have statistics.
    """
    for number, rows in where.runs():
        if number in report.damaged:
            continue
        wrong = []
        for key, values in columns.items():
            recorded_stats = {name: each[row_of[number]] for name, each in stored.get(key, {}).items()}
            if key in PLACE:  # LeRobot's merging does not update their statistics
                continue
            if not set(recorded_stats) >= NEEDED:
                wrong += [f"none of {key}"] if key in ours and key != POINT_CLOUD else []
            elif not _are_of(recorded_stats, values[rows]):
                wrong.append(key)
        if wrong:
            report.add("episode-statistics", f"they differ from its rows: {listed(wrong)}", where.file, number)


def _are_of(stored: Mapping[str, NDArray[np.float64]], values: NDArray[Any]) -> bool:
    """Returns whether statistics (D,) match an episode's values (T, ...); NaN is a difference."""
    numbers = values.astype(np.int8) if values.dtype == bool else values
    points = numbers.reshape(-1, values.shape[-1] if values.ndim > 1 else 1)
    if any(each.shape != points.shape[1:] for name, each in stored.items() if name != "count"):
        return False
    lowest, highest = (points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64))
    largest = np.maximum(np.abs(lowest), np.abs(highest)) + 1e-6
    rounding = _ROUNDING + _ROUNDING_EACH * len(points)
    near = np.abs(stored["min"] - lowest) <= _ROUNDING * largest
    near &= np.abs(stored["max"] - highest) <= _ROUNDING * largest
    near &= np.abs(stored["mean"] - points.mean(axis=0, dtype=np.float64)) <= rounding * largest
    # A difference of squares in float32 has the rounding error of the squares.
    near &= np.abs(stored["std"] ** 2 - points.var(axis=0, dtype=np.float64)) <= rounding * largest**2
    near &= stored["count"] == len(values)
    if len(values) > 1 and (names := [name for name in QUANTILES if name in stored]):
        shares, quantiles = np.array([QUANTILES[name] for name in names]), np.stack([stored[name] for name in names])
        slack = 2.0 * (highest - lowest) / _BINS + 1e-6 * (1.0 + np.abs(quantiles))
        # Equal values may begin right at the share.
        lower, upper = (np.quantile(points, shares + by, axis=0, method="inverted_cdf") for by in (-1e-6, 1e-6))
        near &= ((quantiles >= lower - slack) & (quantiles <= upper + slack)).all(axis=0)
    return bool(near.all())


def dataset_statistics(dataset: Dataset, stored: Stored) -> Statistics:
    """Returns the true statistics of a dataset: of all rows; for pictures, LeRobot's aggregation of the episodes'.

    Raises:
        OSError, ArrowException: a data file cannot be read.
    """
    from lerobot.datasets.compute_stats import aggregate_stats

    pictures = {
        key: recorded_stats
        for key, recorded_stats in stored.items()
        if key in dataset.keys_of("video", "image") and set(recorded_stats) >= NEEDED
    }
    episodes = [
        {
            key: {name: each[row].reshape(-1, *(() if name == "count" else (1, 1))) for name, each in own.items()}
            for key, own in pictures.items()
        }
        for row in range(len(dataset.table) if pictures else 0)
    ]
    rows = row_statistics(
        [dataset.root / name for name in dict.fromkeys(episode.file for episode in dataset.episodes)], dataset.features
    )
    return {**rows, **(aggregate_stats(episodes) if episodes else {})}


def repaired_statistics(dataset: Dataset, stored: Stored) -> Statistics:
    """Returns the true statistics, with fixed ranges of rotation and gripper if ``meta/stats.json`` has them.

    Raises:
        OSError, ArrowException: a data file cannot be read.
    """
    true = dataset_statistics(dataset, stored)
    fixed = unscaled_poses(true, dataset.features)
    try:
        written = read_statistics(dataset.root)
    except (OSError, ValueError):
        return true
    is_fixed = {key for key in written.keys() & true.keys() if _same(written[key], fixed[key], "std")}
    return {key: (fixed if key in is_fixed else true)[key] for key in true}


def read_statistics(root: Path) -> Statistics:
    """Returns ``meta/stats.json`` with flattened statistics; raises OSError or ValueError."""
    content = read(root / STATS, max_bytes=MAX_STATISTICS_BYTES)
    try:
        return {
            key: {name: np.asarray(value, np.float64).reshape(-1) for name, value in columns.items()}
            for key, columns in content.items()
        }
    except (AttributeError, TypeError) as error:
        raise ValueError(f"not statistics by column: {error}") from error


def check_statistics(dataset: Dataset, stored: Stored, report: Report) -> None:
    """Compares ``meta/stats.json`` with the rows, if no episode is damaged.

    Accepts fixed ranges of rotation and gripper, see `pose_statistics.leave_poses_unscaled`. Traces of
    LeRobot's tools (averaged quantiles, no statistics of clouds and added columns) are a warning or accepted.
    """
    try:
        written = read_statistics(dataset.root)
    except FileNotFoundError:
        report.add("missing", "statistics of the dataset", STATS)
        return
    except (OSError, ValueError) as error:
        report.add("unreadable", str(error)[:200], STATS)
        return
    if report.damaged or len(dataset.table) != dataset.info["total_episodes"]:
        return  # unknown which rows the statistics cover
    try:
        true = dataset_statistics(dataset, stored)
    except (OSError, pa.ArrowException):
        return  # `read_rows` reports the file
    fixed = unscaled_poses(true, dataset.features)
    ours, wrong, averaged = contract_of(dataset.features), list[str](), list[str]()
    for key in sorted(true.keys() - set(PLACE)):
        if key not in written:
            if key in ours:
                (averaged if key == POINT_CLOUD else wrong).append(f"none of {key}")
            continue
        names = [name for name in true[key] if not any(_same(written[key], of[key], name) for of in (true, fixed))]
        if names:
            only_quantiles = key == POINT_CLOUD or set(names) <= set(QUANTILES)
            (averaged if only_quantiles else wrong).append(f"{key} ({listed(names)})")
    if wrong:
        report.add("statistics", f"they differ from the rows: {listed(wrong)}", STATS)
    if averaged:
        report.add("averaged", f"not those of all rows: {listed(averaged)}", STATS)


def _same(stored: Mapping[str, NDArray[np.float64]], right: Mapping[str, NDArray[np.float64]], name: str) -> bool:
    value, expected = stored.get(name), right[name].reshape(-1)
    if value is None or value.shape != expected.shape:
        return False
    scale = max(float(np.abs(right["min"]).max()), float(np.abs(right["max"]).max())) + 1e-6
    near = np.abs(value - expected) <= 1e-4 * scale + 1e-6 * np.abs(expected)
    if name == "std":  # LeRobot's sums in float32 give a constant one
        largest = np.maximum(np.abs(right["min"]), np.abs(right["max"])).reshape(-1)
        near |= np.abs(value**2 - expected**2) <= 1e-5 * largest**2
    return bool(near.all())
