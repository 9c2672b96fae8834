"""Statistics of an episode, and of a finished dataset: ``meta/stats.json``."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import POINT_CLOUD, Statistics
from lerobot_adamanip.util import files
from lerobot_adamanip.util.arrow import numeric_array

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
PICTURES = ("video", "image")
_NOT_NUMERIC = (*PICTURES, "string", "language")
_CLOUD_STEP = 1e-4
"""Resolution of the quantiles of clouds [m]."""
_CLOUD_REACH = 100_000
"""Largest coordinate of a cloud in quantiles, in steps; farther points are clipped to it."""
_BATCH_ROWS = 1024


def compute_statistics(
    columns: Mapping[str, Any], features: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Computes an episode's statistics by LeRobot's function, without those of the cloud.

    Statistics of a single coordinate of a farthest-point ordered cloud mean nothing, and would be most of
    ``meta/episodes``. ``columns`` are (T, ...) values, or paths of T images. Returns column -> statistic -> values in a
    row's shape.
    """
    from lerobot.datasets.compute_stats import compute_episode_stats

    others = {key: values for key, values in columns.items() if key != POINT_CLOUD}
    stats: dict[str, dict[str, Any]] = compute_episode_stats(others, dict(features))
    return stats


def write_statistics(root: Path, features: Mapping[str, Mapping[str, Any]]) -> None:
    """Writes ``meta/stats.json`` of a finished dataset: statistics of all rows, sorted by column.

    LeRobot's writer averages the quantiles of the episodes instead. Statistics of pictures stay as it has written them.
    """
    from lerobot.datasets.io_utils import load_stats

    stored: Statistics = load_stats(root) or {}
    pictures = {key: recorded_stats for key, recorded_stats in stored.items() if features[key]["dtype"] in PICTURES}
    rows = row_statistics(sorted((root / "data").glob("*/*.parquet")), features)
    content = json.dumps(plain_statistics({**rows, **pictures}), indent=4) + "\n"
    files.write_atomically(root / "meta" / "stats.json", content.encode())


def plain_statistics(stats: Statistics) -> dict[str, dict[str, Any]]:
    """Returns statistics as lists of numbers, sorted by column, for JSON."""
    return {key: {name: np.asarray(value).tolist() for name, value in stats[key].items()} for key in sorted(stats)}


def row_statistics(paths: Sequence[Path], features: Mapping[str, Mapping[str, Any]]) -> Statistics:
    """Returns the statistics of all rows of data files: column -> statistic -> values in a row's shape.

    Quantiles are numpy's, linear between values. Rows with NaN or infinity are left out. A cloud has statistics of its
    x, y and z over all points, the same for every point; its quantiles have a resolution of 0.1 mm. Columns of pictures
    and text, and columns with empty or ragged cells, have none.

    Raises:
        OSError, ArrowException: a data file cannot be read.
    """
    statistics: Statistics = {}
    for key, feature in features.items():
        if feature["dtype"] not in _NOT_NUMERIC:
            with contextlib.suppress(_IrregularCellsError):
                compute = cloud_statistics if key == POINT_CLOUD else value_statistics
                statistics[key] = compute(_batches(paths, key))
    return statistics


class _IrregularCellsError(Exception):
    """A column that cannot be an array."""


def _batches(paths: Sequence[Path], key: str) -> Iterator[NDArray[Any]]:
    """Yields the cells of a column as (R, ...) arrays, in order."""
    for path in paths:
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(_BATCH_ROWS, columns=[key] if key in file.schema_arrow.names else []):
                values = numeric_array(batch.column(0)) if batch.num_columns else None
                if values is None:
                    raise _IrregularCellsError(key)
                yield values


def value_statistics(batches: Iterable[NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Returns the statistics of all rows of (R, ...) batches."""
    parts = list(batches)
    if not parts or len({part.shape[1:] for part in parts}) > 1:
        raise _IrregularCellsError
    values = np.concatenate(parts)
    values = values.reshape(len(values), *(values.shape[1:] or (1,)))
    finite = values[np.isfinite(values).all(axis=tuple(range(1, values.ndim)))].astype(np.float64)
    if not len(finite):
        raise _IrregularCellsError
    quantiles = np.quantile(finite, list(QUANTILES.values()), axis=0)
    return {
        "min": finite.min(axis=0),
        "max": finite.max(axis=0),
        "mean": finite.mean(axis=0),
        "std": finite.std(axis=0),
        "count": np.array([len(values)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def cloud_statistics(batches: Iterable[NDArray[np.float32]]) -> dict[str, NDArray[Any]]:
    """Returns the statistics of the points of (R, 3 N) batches: (3 N,) values, equal for every point."""
    bins = np.zeros((3, 2 * _CLOUD_REACH + 1), np.int64)
    lowest, highest, sums, squares = np.full(3, np.inf), np.full(3, -np.inf), np.zeros(3), np.zeros(3)
    rows, widths = 0, set[tuple[int, ...]]()
    for batch in batches:
        rows, widths = rows + len(batch), widths | {batch.shape[1:]}
        points = as_points(batch).reshape(-1, 3).astype(np.float64)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            lowest, highest = np.minimum(lowest, points.min(axis=0)), np.maximum(highest, points.max(axis=0))
            sums, squares = sums + points.sum(axis=0), squares + np.square(points).sum(axis=0)
            steps = np.rint(points / _CLOUD_STEP).clip(-_CLOUD_REACH, _CLOUD_REACH).astype(np.int64) + _CLOUD_REACH
            bins += np.stack([np.bincount(axis, minlength=bins.shape[1]) for axis in steps.T])
    total = int(bins[0].sum())
    if not total or len(widths) > 1:
        raise _IrregularCellsError
    mean, below = sums / total, bins.cumsum(axis=1)
    quantiles = {
        name: np.array([np.searchsorted(axis, share * total) - _CLOUD_REACH for axis in below]) * _CLOUD_STEP
        for name, share in QUANTILES.items()
    }
    axes = {
        "min": lowest,
        "max": highest,
        "mean": mean,
        "std": np.sqrt(np.maximum(squares / total - np.square(mean), 0.0)),
        **{name: value.clip(lowest, highest) for name, value in quantiles.items()},
    }
    ((width,),) = widths
    return {"count": np.array([rows]), **{name: np.tile(value, width // 3) for name, value in axes.items()}}
