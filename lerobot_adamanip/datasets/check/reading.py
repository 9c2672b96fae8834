"""Read the rows of a data file, and check that each says where it belongs. One file is held at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.datasets.check.findings import Report, Rows, first_line
from lerobot_adamanip.datasets.check.layout import Episode, Layout
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import listed

PLACE = ("index", "episode_index", "frame_index", "timestamp", "task_index")
"""Columns that LeRobot adds to every dataset."""


def read_rows(layout: Layout, name: str, episodes: Sequence[Episode], report: Report) -> tuple[Rows, pa.Table] | None:
    """Reads a data file; None, with findings, where its rows cannot be assigned to episodes.

    Args:
        layout: of the dataset.
        name: of the file.
        episodes: that the metadata place in it, in order.
        report: takes the findings.
    """
    path = layout.root / name
    if not path.is_file():
        report.add("missing", "rows of the episode, and of what follows in this file", name, episodes[0].number)
        return None
    try:
        file = pq.ParquetFile(path)
    except (OSError, pa.ArrowException) as error:
        report.add("unreadable", first_line(error), name, episodes[0].number)
        return None
    if absent := [key for key in layout.data_keys if key not in file.schema_arrow.names]:
        report.add("schema", f"the file has no column {listed(absent)}", name, episodes[0].number)
        return None
    where = _as_listed(name, episodes)
    table = _read(file, layout.data_keys)
    if table is None:
        _report_unreadable(file, where, layout.data_keys, report)
        return None
    return _placed(layout, where, table, episodes, report)


def points_last(values: NDArray[Any]) -> NDArray[Any]:
    """Returns (R,), (R, D) or (R, N, D) values as (R, D, N) numbers: reductions over N are then six times faster."""
    points = values.reshape(len(values), -1, values.shape[-1] if values.ndim > 1 else 1).transpose(0, 2, 1)
    return np.ascontiguousarray(points if points.dtype.kind == "f" else points.astype(np.float64))


def _as_listed(name: str, episodes: Sequence[Episode]) -> Rows:
    lengths = [episode.length for episode in episodes]
    numbers = np.repeat([episode.number for episode in episodes], lengths)
    return Rows(name, numbers.astype(np.int64), np.concatenate([np.arange(length) for length in lengths]))


def _read(file: pq.ParquetFile, columns: Sequence[str], group: int | None = None) -> pa.Table | None:
    try:
        return file.read(columns) if group is None else file.read_row_group(group, columns)
    except (OSError, pa.ArrowException):
        return None


def _report_unreadable(file: pq.ParquetFile, where: Rows, columns: Sequence[str], report: Report) -> None:
    """Reports the episodes of each row group that cannot be read, and the columns."""
    start = 0
    for group in range(file.metadata.num_row_groups):
        end = start + file.metadata.row_group(group).num_rows
        if broken := [key for key in columns if _read(file, [key], group) is None]:
            for episode in np.unique(where.episodes[start:end]).tolist():
                report.add("unreadable", f"column {listed(broken)} cannot be decoded", where.file, episode)
        start = end


def _placed(
    layout: Layout, where: Rows, table: pa.Table, episodes: Sequence[Episode], report: Report
) -> tuple[Rows, pa.Table] | None:
    columns = {key: numeric_array(table[key]) if len(table) else None for key in PLACE}
    if any(column is None for column in columns.values()):
        report.add("shape", "a row does not say where it belongs", where.file, episodes[0].number)
        return None
    told: dict[str, NDArray[Any]] = {key: column for key, column in columns.items() if column is not None}
    if len(where) != len(table):
        numbers = told["episode_index"].astype(np.int64)
        starts = Rows(where.file, numbers, numbers).starts()
        lengths = np.diff(np.r_[starts, len(numbers)])
        where = Rows(where.file, numbers, np.concatenate([np.arange(length) for length in lengths]))
        _check_lengths(where, episodes, report)
    _check_numbers(layout, where, told, episodes, report)
    return where, table


def _check_lengths(where: Rows, episodes: Sequence[Episode], report: Report) -> None:
    numbers, counts = np.unique(where.episodes, return_counts=True)
    found = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
    for episode in episodes:
        if (rows := found.pop(episode.number, 0)) != episode.length:
            message = f"{rows} rows, where the metadata says {episode.length}"
            report.add("length", message, where.file, episode.number)
    if found:
        message = f"{sum(found.values())} rows of episode {listed(list(found))}"
        report.add("unlisted", message, where.file, min(found))


def _check_numbers(
    layout: Layout, where: Rows, told: dict[str, NDArray[Any]], episodes: Sequence[Episode], report: Report
) -> None:
    starts = {episode.number: episode.start for episode in episodes}
    known = np.isin(where.episodes, list(starts)) & ~np.isin(where.episodes, list(report.damaged))
    first = np.array([starts.get(number, 0) for number in where.episodes.tolist()])
    expected = {"episode_index": where.episodes, "frame_index": where.frames, "index": first + where.frames}
    for key, values in expected.items():
        report.add_rows("index", f"{key} does not count on", where, known & (told[key] != values))
    off = np.abs(told["timestamp"].astype(np.float64) - where.frames / layout.fps) > 1e-4
    report.add_rows("timestamp", f"timestamp is not frame_index / {layout.fps}", where, known & off)
    tasks = {episode.number: episode.tasks for episode in episodes}
    pairs = np.unique(np.stack([where.episodes, told["task_index"].astype(np.int64)]), axis=1).T.tolist()
    wrong = [(e, task) for e, task in pairs if e in tasks and layout.tasks and layout.tasks.get(task) not in tasks[e]]
    for number, task in wrong:
        mine = known & (where.episodes == number) & (told["task_index"] == task)
        report.add_rows("task", f"task_index {task} is none of the episode's tasks", where, mine)
