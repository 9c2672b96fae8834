"""Append prepared episodes to a LeRobotDataset in order, with the bytes that LeRobot's writer writes."""

from __future__ import annotations

import inspect
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.datasets.encoding import PreparedEpisode
from lerobot_adamanip.datasets.opening import VIDEO_PATH
from lerobot_adamanip.util.video import decoding_delay

_WRITER_PARTS = (
    "_current_file_start_frame", "_latest_episode", "_pq_writer", "_recorded_frames", "_root", "_save_episode_video",
    "close_writer",
)  # fmt: skip
"""Attributes of LeRobot's writer that `append_rows` uses."""
_EPISODE = ("episode_index", "episode_length", "episode_tasks", "episode_stats", "episode_metadata")
"""Parameters of the metadata's `save_episode`, in order."""


def can_append(dataset: Any) -> bool:
    """Returns whether this LeRobot's writer and metadata have the attributes that `append_rows` uses."""
    parameters = tuple(inspect.signature(dataset.meta.save_episode).parameters)
    return parameters == _EPISODE and all(hasattr(dataset.writer, part) for part in _WRITER_PARTS)


def in_order[T](numbered: Iterable[tuple[int, T]]) -> Iterator[T]:
    """Yields numbered values in order, each as soon as all earlier ones have arrived."""
    waiting: dict[int, T] = {}
    following = 0
    for number, value in numbered:
        waiting[number] = value
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def append(dataset: Any, episode: PreparedEpisode) -> int:
    """Appends an episode as ``add_frame`` and ``save_episode`` do; returns its number of rows."""
    table = pa.ipc.open_stream(episode.table).read_all()
    tasks = tasks_of_rows(episode.record, len(table))
    return append_rows(dataset, table, list(dict.fromkeys(tasks)), tasks, stats=episode.stats, videos=episode.videos)


def tasks_of_rows(record: Mapping[str, Any], rows: int) -> list[str]:
    """Returns the task of each row of an episode file: its instruction, with the memory if that is text."""
    tasks: list[str] = record.get("tasks") or [record["task"]] * rows
    return tasks


def append_rows(
    dataset: Any,
    table: pa.Table,
    tasks: list[str],
    task_of_row: list[str],
    *,
    stats: Mapping[str, Mapping[str, Any]],
    videos: Mapping[str, bytes],
) -> int:
    """Appends an episode from its table, like `append`; returns its number of rows.

    Args:
        dataset: LeRobotDataset that is being written.
        table: the rows; the columns `encoding.PLACE` are replaced.
        tasks: tasks of the episode; new ones are added to the dataset.
        task_of_row: task of each row.
        stats: column -> statistics; those of `encoding.PLACE` are recomputed.
        videos: column -> content of a video file with only this episode's frames.
    """
    from lerobot.datasets.compute_stats import compute_episode_stats

    writer, meta = dataset.writer, dataset.meta
    number, length = meta.total_episodes, len(table)
    meta.save_episode_tasks(tasks)
    numbers = {task: meta.get_task_index(task) for task in set(task_of_row)}
    place = {
        "index": np.arange(meta.total_frames, meta.total_frames + length),
        "episode_index": np.full((length,), number),
        "task_index": np.array([numbers[task] for task in task_of_row]),
    }
    every = {**stats, **compute_episode_stats(place, meta.features)}
    ordered = {key: every[key] for key in meta.features if key in every}
    metadata = _append_table(writer, meta, _with_columns(table, place))
    for key, content in videos.items():
        path = Path(tempfile.mkdtemp(dir=dataset.root)) / f"{key}_{number:03d}.mp4"
        path.write_bytes(content)
        size = meta.info.video_files_size_in_mb
        if number and decoding_delay(path) != decoding_delay(_latest_video(meta, key)):
            meta.info.video_files_size_in_mb = 0  # a new file: packets could precede those before them
        metadata.update(writer._save_episode_video(key, number, temp_path=path))
        meta.info.video_files_size_in_mb = size
    meta.save_episode(number, length, tasks, ordered, metadata)
    return length


def _latest_video(meta: Any, key: str) -> Path:
    chunk, file = (meta.latest_episode[f"videos/{key}/{name}"][0] for name in ("chunk_index", "file_index"))
    return Path(meta.root / VIDEO_PATH.format(video_key=key, chunk_index=chunk, file_index=file))


def _with_columns(table: pa.Table, columns: Mapping[str, Any]) -> pa.Table:
    for key, values in columns.items():
        at = table.schema.get_field_index(key)
        table = table.set_column(at, table.schema.field(at), pa.array(values, type=table.schema.field(at).type))
    return table


def _append_table(writer: Any, meta: Any, table: pa.Table) -> dict[str, Any]:
    """Writes an episode's rows as a row group; starts a new file when this one is full, by LeRobot's rule."""
    from lerobot.datasets.io_utils import get_file_size_in_mb
    from lerobot.datasets.utils import update_chunk_file_indices

    latest = writer._latest_episode
    chunk = file = begin = 0
    if latest is None:
        writer._current_file_start_frame = 0
    else:
        chunk, file, begin = latest["data/chunk_index"], latest["data/file_index"], latest["dataset_to_index"]
        size = get_file_size_in_mb(writer._root / meta.data_path.format(chunk_index=chunk, file_index=file))
        frames = begin - writer._current_file_start_frame
        per_frame = size / frames if frames > 0 else 0
        if size + per_frame * len(table) >= meta.data_files_size_in_mb:
            chunk, file = update_chunk_file_indices(chunk, file, meta.chunks_size)
            writer.close_writer()
            writer._current_file_start_frame = begin
    path = writer._root / meta.data_path.format(chunk_index=chunk, file_index=file)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not writer._pq_writer:
        writer._pq_writer = pq.ParquetWriter(path, schema=table.schema, compression="snappy", use_dictionary=True)
    writer._pq_writer.write_table(table)
    metadata = {
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": begin,
        "dataset_to_index": begin + len(table),
    }
    writer._latest_episode = metadata
    writer._recorded_frames += len(table)
    return metadata
