"""What a kill has lost and can be made again: metadata of episodes, tasks, totals, statistics."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.check.contract import OF_LEROBOT
from lerobot_adamanip.datasets.check.inventory import Found, file_numbers
from lerobot_adamanip.datasets.check.layout import EPISODES, INFO, STATS, TASKS, VERSION, VideoPart
from lerobot_adamanip.datasets.check.reading import numeric
from lerobot_adamanip.datasets.statistics import compute_statistics, write_episodes
from lerobot_adamanip.util import files

Features = Mapping[str, Mapping[str, Any]]


def episode_row(root: Path, found: Found, features: Features, tasks: Mapping[int, str], place: str) -> dict[str, Any]:
    """Returns the metadata that LeRobot's writer gives an episode, from its rows and frames.

    Args:
        root: of the dataset.
        found: the episode.
        features: of the dataset.
        tasks: task_index -> text.
        place: file of ``meta/episodes`` that it goes to.
    """
    run = found.run
    chunk, file = file_numbers(run.file)
    row: dict[str, Any] = {
        "episode_index": run.number,
        "tasks": [tasks[index] for index in run.tasks],
        "length": run.length,
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": run.start,
        "dataset_to_index": run.start + run.length,
    }
    for key, part in found.videos.items():
        chunk, file = file_numbers(part.file)
        row |= {f"videos/{key}/chunk_index": chunk, f"videos/{key}/file_index": file}
        row |= {f"videos/{key}/from_timestamp": part.start, f"videos/{key}/to_timestamp": part.end}
    for key, told in episode_statistics(root, found, features).items():
        row |= {f"stats/{key}/{name}": np.asarray(value).tolist() for name, value in told.items()}
    row["meta/episodes/chunk_index"], row["meta/episodes/file_index"] = file_numbers(place)
    return row


def episode_statistics(root: Path, found: Found, features: Features) -> dict[str, dict[str, Any]]:
    """Returns the statistics of an episode, by LeRobot's functions; of pictures, as its decoded frames show them."""
    run = found.run
    table = pq.read_table(root / run.file).slice(run.at, run.length)
    columns = {key: numeric(table, key) for key in table.column_names if key in features}
    known = {key: values for key, values in columns.items() if values is not None}
    stats = compute_statistics(known, features)
    pictures = {
        key: picture_statistics(root / part.file, part, run.length, features[key]) for key, part in found.videos.items()
    }
    return stats | pictures


def picture_statistics(path: Path, part: VideoPart, length: int, feature: Mapping[str, Any]) -> dict[str, Any]:
    """Returns statistics of an episode's frames, as LeRobot samples and scales them: colours of 0 to 1, depth as is."""
    import av
    from lerobot.datasets.compute_stats import auto_downsample_height_width, get_feature_stats, sample_indices

    wanted = set(sample_indices(length))
    decode, scale = _decoder(feature.get("info") or {})
    pictures: list[NDArray[Any]] = []
    number = -1
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            if (frame.time or 0.0) < part.start - 1e-3:
                continue
            number += 1
            if number in wanted:
                pictures.append(auto_downsample_height_width(decode(frame)))
            if number + 1 >= length:
                break
    stats = get_feature_stats(np.stack(pictures), axis=(0, 2, 3), keepdims=True)
    return {name: value if name == "count" else np.squeeze(value / scale, axis=0) for name, value in stats.items()}


def _decoder(info: Mapping[str, Any]) -> tuple[Callable[[Any], NDArray[Any]], float]:
    """Returns what makes an array (C, H, W) of a video's frame, and the number that statistics are divided by."""
    from lerobot.configs.video import DepthEncoderConfig
    from lerobot.datasets.depth_utils import dequantize_depth

    if not (info.get("is_depth_map") or info.get("video.is_depth_map")):
        return lambda frame: frame.to_ndarray(format="rgb24").transpose(2, 0, 1), 255.0
    told = DepthEncoderConfig.from_video_info(dict(info))
    unit = info.get("depth_unit") or "mm"
    ranges = {name: getattr(told, name) for name in ("depth_min", "depth_max", "shift", "use_log", "pix_fmt")}

    def depth(frame: Any) -> NDArray[Any]:
        found = np.asarray(dequantize_depth(frame, **ranges, output_unit=unit, output_tensor=False))
        return found.reshape(1, *found.squeeze().shape)

    return depth, 1.0


def write_episode_rows(root: Path, rows: Sequence[Mapping[str, Any]], place: str, like: pa.Table) -> None:
    """Writes rows to a file of ``meta/episodes`` with the others' columns, order and types; empty what is not known."""
    table = pa.Table.from_pylist([dict(row) for row in rows])
    for field in like.schema:
        if field.name == "listed_in":
            continue
        if field.name not in table.column_names:
            table = table.append_column(field, pa.nulls(len(table), field.type))
        else:
            at = table.schema.get_field_index(field.name)
            table = table.set_column(at, field, table[field.name].cast(field.type))
    order = [name for name in like.schema.names if name in table.column_names]
    write_episodes(root / place, table.select([*order, *(name for name in table.column_names if name not in order)]))


def write_tasks(root: Path, tasks: Mapping[int, str]) -> None:
    """Writes ``meta/tasks.parquet`` as LeRobot does."""
    import pandas as pd

    ordered = sorted(tasks)
    frame = pd.DataFrame({"task_index": ordered}, index=pd.Index([tasks[index] for index in ordered], name="task"))
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pandas(frame), sink, compression="snappy")
    files.write_atomically(root / TASKS, sink.getvalue().to_pybytes())


def write_info(root: Path, info: Mapping[str, Any], episodes: int, rows: int, tasks: int) -> None:
    """Writes ``meta/info.json`` with these totals."""
    totals = {"total_episodes": episodes, "total_frames": rows, "total_tasks": tasks}
    content = {**info, **totals, "splits": {"train": f"0:{episodes}"}}
    files.write_atomically(root / INFO, (json.dumps(content, indent=4) + "\n").encode())


def write_statistics(root: Path, stats: Mapping[str, Mapping[str, Any]]) -> None:
    """Writes ``meta/stats.json``, in our order."""
    plain = {
        key: {name: np.asarray(value).tolist() for name, value in told.items()} for key, told in sorted(stats.items())
    }
    files.write_atomically(root / STATS, (json.dumps(plain, indent=4) + "\n").encode())


def guessed_info(root: Path, name: str) -> dict[str, Any] | None:
    """Returns ``meta/info.json`` of a dataset of the contract's columns, from a data file; None of any other."""
    try:
        columns = pq.read_schema(root / name)
        head = pq.ParquetFile(root / name).read_row_group(0, columns=[schema.POINT_CLOUD, "timestamp"])
    except (OSError, KeyError, pa.ArrowException):
        return None
    cloud = numeric(head, schema.POINT_CLOUD) if schema.POINT_CLOUD in columns.names else None
    times = numeric(head, "timestamp") if "timestamp" in columns.names else None
    if cloud is None or cloud.shape[-1] % 3 or times is None:
        return None
    videos = sorted(path.name for path in (root / "videos").glob("*") if any(path.glob("*/*.mp4")))
    contract = schema.dataset_features(images=False)
    contract[schema.POINT_CLOUD]["shape"] = cloud.shape[1:]
    contract |= {key: {"dtype": dtype, "shape": (1,), "names": None} for key, dtype in OF_LEROBOT.items()}
    if set(columns.names) - set(contract):
        return None
    features = {key: {**contract[key], "shape": list(contract[key]["shape"])} for key in columns.names}
    for key in videos:
        shape = _video_shape(next(iter(sorted((root / "videos" / key).glob("*/*.mp4")))))
        features[key] = {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}
    fps = schema.FPS if len(times) < 2 or times[1] <= times[0] else round(1.0 / float(times[1] - times[0]))
    return {**_INFO, "fps": fps, "features": features}


_INFO: Mapping[str, Any] = {
    "codebase_version": VERSION, "total_episodes": 0, "total_frames": 0, "total_tasks": 0, "chunks_size": 1000,
    "data_files_size_in_mb": 100, "video_files_size_in_mb": 200,
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4", "robot_type": None,
}  # fmt: skip


def _video_shape(path: Path) -> list[int]:
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        height, width = int(stream.height), int(stream.width)
    return [height, width, 3]


def next_episode_file(root: Path) -> str:
    """Returns the file of ``meta/episodes`` after the last one that is there."""
    there = sorted(path.relative_to(root).as_posix() for path in (root / "meta" / "episodes").glob("*/*.parquet"))
    if not there:
        return EPISODES.format(chunk_index=0, file_index=0)
    chunk, file = file_numbers(there[-1])
    return EPISODES.format(chunk_index=chunk, file_index=file + 1)
