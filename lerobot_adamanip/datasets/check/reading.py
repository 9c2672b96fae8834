"""Rows of a data file, some thousand at a time and whole episodes together: memory does not grow with a dataset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.datasets.check.findings import Report, Rows, listed
from lerobot_adamanip.datasets.check.layout import Episode, Layout
from lerobot_adamanip.util.arrow import numeric_array

PLACE = ("index", "episode_index", "frame_index", "timestamp", "task_index")
"""Columns that LeRobot adds to every dataset."""
_BATCH_BYTES = 48_000_000
"""Decoded size of what is held at once."""


@dataclass(frozen=True)
class Batch:
    """Rows of whole episodes.

    Attributes:
        where: they belong.
        table: of their columns.
    """

    where: Rows
    table: pa.Table

    def column(self, key: str) -> NDArray[Any] | None:
        """Returns (R, ...) values; None for text, and where a cell is empty or of another shape than the others."""
        return numeric(self.table, key)

    def starts(self) -> NDArray[np.int64]:
        """Returns the first row of each episode."""
        return np.flatnonzero(np.r_[True, np.diff(self.where.episodes) != 0])


def numeric(table: pa.Table, key: str) -> NDArray[Any] | None:
    """Returns a column as (rows, ...) numpy, or None if it is not numeric and regular, or empty."""
    return numeric_array(table.column(key)) if table.num_rows else None


def points_last(values: NDArray[Any]) -> NDArray[Any]:
    """Returns (R,), (R, D) or (R, N, D) values as (R, D, N) numbers: reductions over N are then six times faster."""
    points = values.reshape(len(values), -1, values.shape[-1] if values.ndim > 1 else 1).transpose(0, 2, 1)
    return np.ascontiguousarray(points if points.dtype.kind == "f" else points.astype(np.float64))


def open_file(layout: Layout, name: str, first: Episode, report: Report) -> pq.ParquetFile | None:
    """Opens a data file that has the columns of the dataset; None, with a finding, if it cannot be read at all."""
    path = layout.root / name
    if not path.is_file():
        report.add("missing", "rows of the episode, and of what follows in this file", name, first.number)
        return None
    try:
        file = pq.ParquetFile(path)
    except (OSError, pa.ArrowException) as error:
        report.add("unreadable", str(error).partition("\n")[0][:200], name, first.number)
        return None
    if absent := [key for key in layout.data_keys if key not in file.schema_arrow.names]:
        report.add("schema", f"the file has no column {listed(absent)}", name, first.number)
        return None
    return file


def place(layout: Layout, name: str, file: pq.ParquetFile, episodes: Sequence[Episode], report: Report) -> Rows | None:
    """Returns where the rows of a file belong, and reports those that do not say so; None if nothing can be told."""
    try:
        table = file.read(columns=list(PLACE))
    except (OSError, pa.ArrowException):
        return _as_listed(name, episodes)  # what is broken is found where values are read
    columns = {key: numeric(table, key) for key in PLACE}
    if any(column is None for column in columns.values()):
        report.add("shape", "a row does not say where it belongs", name, episodes[0].number)
        return None
    told = {key: column for key, column in columns.items() if column is not None}
    where = _as_listed(name, episodes)
    if len(where) != len(table):
        where = _as_told(name, told["episode_index"])
        _check_lengths(where, episodes, report)
    _check_numbers(layout, where, told, episodes, report)
    return where


def _as_listed(name: str, episodes: Sequence[Episode]) -> Rows:
    lengths = [episode.length for episode in episodes]
    numbers = np.repeat([episode.number for episode in episodes], lengths)
    frames = np.concatenate([np.arange(length) for length in lengths])
    return Rows(name, numbers.astype(np.int64), frames.astype(np.int64))


def _as_told(name: str, episodes: NDArray[Any]) -> Rows:
    starts = np.flatnonzero(np.r_[True, np.diff(episodes) != 0])
    lengths = np.diff(np.r_[starts, len(episodes)])
    return Rows(name, episodes.astype(np.int64), np.concatenate([np.arange(length) for length in lengths]))


def _check_lengths(where: Rows, episodes: Sequence[Episode], report: Report) -> None:
    numbers, counts = np.unique(where.episodes, return_counts=True)
    found = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
    for episode in episodes:
        if (rows := found.pop(episode.number, 0)) != episode.length:
            message = f"{rows} rows, where the metadata says {episode.length}"
            report.add("length", message, where.file, episode.number)
    if found:
        rows, named = sum(found.values()), listed(found)
        report.add("unlisted", f"{rows} rows of episode {named}", where.file, min(found))


def _check_numbers(
    layout: Layout, where: Rows, told: dict[str, NDArray[Any]], episodes: Sequence[Episode], report: Report
) -> None:
    starts = {episode.number: episode.start for episode in episodes}
    known = np.isin(where.episodes, list(starts)) & ~np.isin(where.episodes, list(report.damaged))
    first = np.array([starts.get(number, 0) for number in np.unique(where.episodes).tolist()])
    expected = {
        "episode_index": where.episodes,
        "frame_index": where.frames,
        "index": first[np.unique(where.episodes, return_inverse=True)[1]] + where.frames,
    }
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


def batches(file: pq.ParquetFile, where: Rows, columns: Sequence[str], report: Report) -> Iterator[Batch]:
    """Yields the rows of a file, whole episodes together; a part that cannot be read is reported and left out."""
    held: list[pa.Table] = []
    start = end = 0
    for groups in _runs(file):
        rows = sum(file.metadata.row_group(group).num_rows for group in groups)
        table = _read(file, groups, columns)
        if table is None:
            yield from _whole(held, where[start:end])
            _report_unreadable(file, groups, where[end : end + rows], columns, report)
            held, start, end = [], end + rows, end + rows
            continue
        held, end = [*held, table], end + rows
        cut = end
        if end < len(where):  # the last episode may go on
            while cut > start and where.episodes[cut - 1] == where.episodes[end]:
                cut -= 1
        if cut > start:
            joined = pa.concat_tables(held)
            yield Batch(where[start:cut], joined.slice(0, cut - start))
            held, start = [joined.slice(cut - start)], cut
    yield from _whole(held, where[start:end])


def _whole(held: list[pa.Table], where: Rows) -> Iterator[Batch]:
    if len(where):
        yield Batch(where, pa.concat_tables(held))


def _runs(file: pq.ParquetFile) -> Iterator[list[int]]:
    """Yields row groups that are read at once."""
    run: list[int] = []
    size = 0
    for group in range(file.metadata.num_row_groups):
        bytes_ = file.metadata.row_group(group).total_byte_size
        if run and size + bytes_ > _BATCH_BYTES:
            yield run
            run, size = [], 0
        run.append(group)
        size += bytes_
    if run:
        yield run


def _read(file: pq.ParquetFile, groups: Sequence[int], columns: Sequence[str]) -> pa.Table | None:
    try:
        return file.read_row_groups(list(groups), columns=list(columns))
    except (OSError, pa.ArrowException):
        return None


def _report_unreadable(
    file: pq.ParquetFile, groups: Sequence[int], where: Rows, columns: Sequence[str], report: Report
) -> None:
    """Says which episodes of a run cannot be read, and in which column."""
    start = 0
    for group in groups:
        rows = file.metadata.row_group(group).num_rows
        if _read(file, [group], columns) is None:
            broken = [key for key in columns if _read(file, [group], [key]) is None]
            episodes = np.unique(where.episodes[start : start + rows]).tolist()
            for episode in episodes:
                report.add("unreadable", f"column {listed(broken)} cannot be decoded", where.file, episode)
        start += rows
