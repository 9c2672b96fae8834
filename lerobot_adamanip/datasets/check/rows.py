"""Read a data file and check its rows: places, shapes, finite values, rotations, clouds in the workspace, labels.

One file is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome, Phase
from lerobot_adamanip.contract.pointcloud import Workspace, as_points
from lerobot_adamanip.datasets.check.dense_rows import DENSE_LABELS, check_dense_course, check_dense_values
from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.dataset import Dataset, Episode
from lerobot_adamanip.datasets.dense import is_dense_collection
from lerobot_adamanip.datasets.opening import first_line
from lerobot_adamanip.hardware.features import UNLABELLED, names_of
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import listed

Columns = dict[str, NDArray[Any]]
"""Column -> (R, ...) values."""
PLACE = ("index", "episode_index", "frame_index", "timestamp", "task_index")
"""Columns that LeRobot adds to every dataset."""
ORTHONORMAL = 1e-3
"""Largest deviation of rotation rows from length 1, and of their product from 0."""
MARGIN = 1e-4
"""Rounding allowance for points outside the workspace [m] and openings outside [0, 1]."""
LABELS: Mapping[str, tuple[int, int]] = {
    schema.PHASE: (UNLABELLED, max(Phase)), schema.OUTCOME: (schema.GOES_ON, max(Outcome)),
    schema.TRIED: (-1, schema.MAX_OBJECT_JOINTS - 1), schema.TRIAL: (UNLABELLED, 10_000),
}  # fmt: skip
"""Column -> smallest and largest code."""


# Reading --------------------------------------------------------------------------------------------------------------


def read_rows(dataset: Dataset, name: str, episodes: Sequence[Episode], report: Report) -> tuple[Rows, pa.Table] | None:
    """Reads a data file; returns None, with findings, if its rows cannot be assigned to its episodes."""
    path, first = dataset.root / name, episodes[0].number
    keys = [key for key in dataset.features if key not in dataset.keys_of("video")]
    if not path.is_file():
        report.add("missing", "rows of this and the following episodes in this file", name, first)
        return None
    try:
        file = pq.ParquetFile(path)
    except (OSError, pa.ArrowException) as error:
        report.add("unreadable", first_line(error), name, first)
        return None
    if absent := [key for key in keys if key not in file.schema_arrow.names]:
        report.add("schema", f"the file has no column {listed(absent)}", name, first)
        return None
    numbers = np.repeat([episode.number for episode in episodes], [episode.length for episode in episodes])
    where = _counted(name, numbers)
    try:
        table = file.read(keys)
    except (OSError, pa.ArrowException):
        _report_unreadable(file, where, keys, report)
        return None
    places = {key: values for key in PLACE if len(table) and (values := numeric_array(table[key])) is not None}
    if len(places) < len(PLACE):
        report.add("shape", "a row lacks its episode or index", name, first)
        return None
    if len(where) != len(table):
        where = _counted(name, places["episode_index"])
        _check_lengths(where, episodes, report)
    _check_places(dataset, where, places, episodes, report)
    return where, table


def _counted(name: str, numbers: NDArray[Any]) -> Rows:
    """Returns the places of rows, given their episodes; each run of one episode counts from 0."""
    where = Rows(name, numbers.astype(np.int64), np.arange(len(numbers)))
    starts = where.starts()
    return Rows(name, where.episodes, where.frames - np.repeat(starts, np.diff(np.r_[starts, len(numbers)])))


def _report_unreadable(file: pq.ParquetFile, where: Rows, columns: Sequence[str], report: Report) -> None:
    """Reports the episodes and columns of each row group that cannot be read."""
    start = 0
    for group in range(file.metadata.num_row_groups):
        end, broken = start + file.metadata.row_group(group).num_rows, []
        for key in columns:
            try:
                file.read_row_group(group, [key])
            except (OSError, pa.ArrowException):
                broken.append(key)
        for episode in np.unique(where.episodes[start:end]).tolist() if broken else ():
            report.add("unreadable", f"column {listed(broken)} cannot be decoded", where.file, episode)
        start = end


def _check_lengths(where: Rows, episodes: Sequence[Episode], report: Report) -> None:
    numbers, counts = np.unique(where.episodes, return_counts=True)
    counted = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
    for episode in episodes:
        if (rows := counted.pop(episode.number, 0)) != episode.length:
            report.add("length", f"{rows} rows, but the metadata says {episode.length}", where.file, episode.number)
    if counted:
        rows, unlisted = sum(counted.values()), listed(list(counted))
        report.add("unlisted", f"{rows} rows of episode {unlisted}", where.file, min(counted))


def _check_places(dataset: Dataset, where: Rows, places: Columns, episodes: Sequence[Episode], report: Report) -> None:
    starts = {episode.number: episode.start for episode in episodes}
    known = np.isin(where.episodes, list(starts)) & ~np.isin(where.episodes, list(report.damaged))
    first = np.array([starts.get(number, 0) for number in where.episodes.tolist()])
    expected = {"episode_index": where.episodes, "frame_index": where.frames, "index": first + where.frames}
    for key, values in expected.items():
        report.add_rows("index", f"{key} is not consecutive", where, known & (places[key] != values))
    off = np.abs(places["timestamp"].astype(np.float64) - where.frames / dataset.fps) > 1e-4
    report.add_rows("timestamp", f"timestamp is not frame_index / {dataset.fps}", where, known & off)
    for episode in episodes if dataset.tasks else ():
        own = known & (where.episodes == episode.number)
        for task in np.unique(places["task_index"][own]).tolist():
            if dataset.tasks.get(task) not in episode.tasks:
                wrong = own & (places["task_index"] == task)
                report.add_rows("task", f"task_index {task} is not a task of the episode", where, wrong)


# Values ---------------------------------------------------------------------------------------------------------------


def check_values(
    where: Rows, table: pa.Table, features: Mapping[str, Mapping[str, Any]], workspace: Workspace, report: Report
) -> Columns:
    """Checks rows; returns the columns whose cells all have the right shape."""
    columns: Columns = {}
    for key, feature in features.items():
        if feature["dtype"] in ("video", "image", "string", "language"):
            continue
        values = numeric_array(table[key])
        shape = tuple(feature["shape"])
        shape = () if shape == (1,) else shape
        if values is None or values.shape[1:] != shape:
            _report_shape(where, table, key, shape, report)
            continue
        columns[key] = values
        if values.dtype.kind == "f":
            broken = ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
            report.add_rows("not-finite", f"NaN or infinity in {key}", where, broken)
    is_dense = is_dense_collection(features)
    with np.errstate(invalid="ignore"):
        _check_poses(where, columns, features, report)
        _check_clouds(where, columns, workspace, report)
        if is_dense:
            check_dense_values(where, columns, features, report)
    for key, (lowest, highest) in {**LABELS, **(DENSE_LABELS if is_dense else {})}.items():
        if key in columns:
            wrong = (columns[key] < lowest) | (columns[key] > highest)
            report.add_rows("label", f"{key} is not in {lowest} ... {highest}", where, wrong)
    if schema.TRIED in columns and schema.FAILED in columns:
        wrong = columns[schema.FAILED].astype(bool) & (columns[schema.TRIED] < 0)
        report.add_rows("label", f"{schema.FAILED} without a try", where, wrong)
    return columns


def _report_shape(where: Rows, table: pa.Table, key: str, shape: tuple[int, ...], report: Report) -> None:
    chunks = [chunk.storage if isinstance(chunk, pa.ExtensionArray) else chunk for chunk in table[key].chunks]
    shapes = [_shape(cell) for chunk in chunks for cell in chunk.to_pylist()]
    wrong = np.array([cell_shape != shape for cell_shape in shapes])
    wrong[0] |= not wrong.any()  # cells without a shape
    wrong_shapes = sorted({str(cell_shape) for cell_shape, bad in zip(shapes, wrong.tolist(), strict=True) if bad})
    report.add_rows("shape", f"{key} has cells of shape {', '.join(wrong_shapes[:3])}, not {shape}", where, wrong)


def _shape(cell: Any) -> tuple[int, ...] | None:
    """Returns the shape of nested lists; None for an empty cell, or for lists of unequal lengths."""
    try:
        return None if cell is None else np.shape(cell)
    except ValueError:
        return None


def _check_poses(where: Rows, columns: Columns, features: Mapping[str, Mapping[str, Any]], report: Report) -> None:
    """Checks the columns that begin with a pose; other kinds of dense actions and states have other names."""
    for key in (schema.STATE, schema.ACTION, schema.KEY_FRAME):
        if key not in columns or names_of(features[key])[: schema.ACTION_DIM] != list(schema.POSE_NAMES):
            continue
        values = columns[key].astype(np.float64)
        finite = np.isfinite(values).all(axis=1)
        rows = values[:, schema.ROTATION_DIMS].reshape(-1, 2, 3)
        stretched = np.abs(np.linalg.norm(rows, axis=2) - 1.0).max(axis=1)
        slanted = np.abs((rows[:, 0] * rows[:, 1]).sum(axis=1))
        off = finite & (np.maximum(stretched, slanted) > ORTHONORMAL)
        report.add_rows("rotation", f"rotation 6D of {key} is not orthonormal", where, off)
        opening = values[:, schema.GRIPPER_DIM]
        beyond = finite & ((opening < -MARGIN) | (opening > 1.0 + MARGIN))
        report.add_rows("gripper", f"gripper of {key} is not in [0, 1]", where, beyond)


def _check_clouds(where: Rows, columns: Columns, workspace: Workspace, report: Report) -> None:
    if schema.POINT_CLOUD not in columns or columns[schema.POINT_CLOUD].shape[-1] % 3:
        return
    clouds = as_points(columns[schema.POINT_CLOUD])
    lowest, highest = clouds.min(axis=1), clouds.max(axis=1)
    beyond = (lowest < np.array(workspace.lower) - MARGIN) | (highest > np.array(workspace.upper) + MARGIN)
    # A camera that sees nothing gives zeros: see `pointcloud.farthest_point_order`.
    nothing = ((lowest == 0.0) & (highest == 0.0)).all(axis=1)
    finite = np.isfinite(lowest + highest).all(axis=1)
    box = f"{tuple(workspace.lower)} to {tuple(workspace.upper)}"
    report.add_rows("workspace", f"points outside {box} m", where, finite & beyond.any(axis=1) & ~nothing)


def check_course(where: Rows, columns: Mapping[str, NDArray[Any]], report: Report) -> None:
    """Checks recorded episodes: `trial` never falls, success is never taken back, and only the last row is final."""
    first = np.zeros(len(where), bool)
    first[where.starts()] = True
    if schema.DONE in columns:
        wrong = columns[schema.DONE].astype(bool) != np.r_[first[1:], True]
        report.add_rows("label", f"{schema.DONE} is not true in the last row only", where, wrong)
    if schema.SUCCESS in columns:
        success = columns[schema.SUCCESS].astype(np.int8)
        wrong = ~first & (np.diff(success, prepend=success[:1]) < 0)
        report.add_rows("label", f"{schema.SUCCESS} turns false again", where, wrong)
    if schema.TRIAL in columns:
        trial = columns[schema.TRIAL].astype(np.int64)
        wrong = np.where(first, trial != 0, np.diff(trial, prepend=trial[:1]) < 0) & (trial != UNLABELLED)
        report.add_rows("label", f"{schema.TRIAL} does not count failed tries up from 0", where, wrong)
    if schema.KEY_FRAME in columns:
        check_dense_course(where, first, columns, report)
