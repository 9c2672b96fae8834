"""Read the rows of a data file and check their indices. Keeps one file in memory at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.dataset import Dataset, Episode
from lerobot_adamanip.datasets.opening import first_line
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import listed

PLACE = ("index", "episode_index", "frame_index", "timestamp", "task_index")
"""Columns that LeRobot adds to every dataset."""


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
    numbers = np.repeat([each.number for each in episodes], [each.length for each in episodes])
    where = _counted(name, numbers)
    try:
        table = file.read(keys)
    except (OSError, pa.ArrowException):
        _report_unreadable(file, where, keys, report)
        return None
    places = {key: numeric_array(table[key]) if len(table) else None for key in PLACE}
    told = {key: values for key, values in places.items() if values is not None}
    if len(told) < len(PLACE):
        report.add("shape", "a row lacks its episode or index", name, first)
        return None
    if len(where) != len(table):
        where = _counted(name, told["episode_index"])
        _check_lengths(where, episodes, report)
    _check_places(dataset, where, told, episodes, report)
    return where, table


def _counted(name: str, numbers: NDArray[Any]) -> Rows:
    """Returns the places of rows, given their episodes; each run of one episode counts from 0."""
    where = Rows(name, numbers.astype(np.int64), np.arange(len(numbers)))
    starts = where.starts()
    lengths = np.diff(np.r_[starts, len(numbers)])
    return Rows(name, where.episodes, where.frames - np.repeat(starts, lengths))


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
    found = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
    for episode in episodes:
        if (rows := found.pop(episode.number, 0)) != episode.length:
            report.add("length", f"{rows} rows, but the metadata says {episode.length}", where.file, episode.number)
    if found:
        report.add("unlisted", f"{sum(found.values())} rows of episode {listed(list(found))}", where.file, min(found))


def _check_places(
    dataset: Dataset, where: Rows, told: dict[str, NDArray[Any]], episodes: Sequence[Episode], report: Report
) -> None:
    starts = {episode.number: episode.start for episode in episodes}
    known = np.isin(where.episodes, list(starts)) & ~np.isin(where.episodes, list(report.damaged))
    first = np.array([starts.get(number, 0) for number in where.episodes.tolist()])
    expected = {"episode_index": where.episodes, "frame_index": where.frames, "index": first + where.frames}
    for key, values in expected.items():
        report.add_rows("index", f"{key} is not consecutive", where, known & (told[key] != values))
    off = np.abs(told["timestamp"].astype(np.float64) - where.frames / dataset.fps) > 1e-4
    report.add_rows("timestamp", f"timestamp is not frame_index / {dataset.fps}", where, known & off)
    for episode in episodes if dataset.tasks else ():
        mine = known & (where.episodes == episode.number)
        for task in np.unique(told["task_index"][mine]).tolist():
            if dataset.tasks.get(task) not in episode.tasks:
                wrong = mine & (told["task_index"] == task)
                report.add_rows("task", f"task_index {task} is not a task of the episode", where, wrong)
