"""From episode files to a LeRobotDataset, in a folder beside the final one and renamed to it when whole."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip import schema
from lerobot_adamanip.demos.collection import CollectionPaths, CollectionSpec, write_manifest
from lerobot_adamanip.demos.shards import RecordedEpisode, read_shard, sync_folder, write_atomically
from lerobot_adamanip.errors import DatasetError
from lerobot_adamanip.hub.cards import dataset_card

_VIDEO_FILE_MB = 25
"""LeRobot copies the whole video file to append an episode: small files keep that cheap."""
_PLAIN_COLUMNS = ("object_id", "seed", "expert", "trials", "success", "attempts", "slot")
_JSON_COLUMNS = ("hidden_state", "camera", "versions", "failures", "episode_record")


def assemble(
    folders: CollectionPaths,
    options: CollectionSpec,
    shards: list[Path],
    repo_id: str,
    progress: Callable[[int, int], None],
) -> None:
    """Writes the dataset of ``shards``, in this order, and puts it in place. Starts over if it was interrupted.

    Raises:
        DatasetError: if there are no shards, or one is damaged.
    """
    if not shards:
        raise DatasetError(
            "No episode was recorded.", got="0 episodes", allowed="1 or more", hint="a larger --max-attempts"
        )
    shutil.rmtree(folders.assembling, ignore_errors=True)
    first = read_shard(shards[0])
    dataset = _create(folders.assembling, options, first, repo_id)
    records: list[dict[str, Any]] = []
    for number, path in enumerate(shards):
        episode = read_shard(path)
        _append(dataset, episode)
        records.append(episode.record)
        progress(number + 1, len(shards))
    dataset.finalize()
    _finish(folders.assembling, options, records, repo_id)
    os.replace(folders.assembling, folders.root)
    sync_folder(folders.root.parent)


def _create(root: Path, options: CollectionSpec, first: RecordedEpisode, repo_id: str) -> Any:
    import av
    import datasets
    from lerobot.configs.video import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    av.logging.set_libav_level(av.logging.ERROR)
    datasets.disable_progress_bars()
    features = schema.dataset_features(options.num_points, options.image_size)
    camera = first.record["camera"]
    features[schema.POINT_CLOUD]["info"] = {"unit": "m", "frame": "robot_base"}
    features[schema.FRONT_IMAGE]["info"] = {"intrinsics": camera.get("intrinsics"), "cameras": "meta/cameras.json"}
    return LeRobotDataset.create(
        repo_id=repo_id,
        fps=schema.FPS,
        features=features,
        root=root,
        robot_type="panda",
        # One thread: the same frames then give the same file on every run.
        rgb_encoder=RGBEncoderConfig(vcodec="h264", crf=20, preset="veryfast", g=2),
        encoder_threads=1,
        video_backend="pyav",
        video_files_size_in_mb=_VIDEO_FILE_MB,
    )


def _append(dataset: Any, episode: RecordedEpisode) -> None:
    for row in range(len(episode)):
        frame = {key: column[row] for key, column in episode.columns.items()}
        dataset.add_frame({**frame, "task": episode.record["task"]})
    dataset.save_episode()


def _finish(root: Path, options: CollectionSpec, records: list[dict[str, Any]], repo_id: str) -> None:
    from lerobot.datasets.io_utils import load_stats, write_stats

    stats = load_stats(root)
    if stats is None:
        raise DatasetError(
            "LeRobot wrote no statistics.", got=root / "meta", allowed="meta/stats.json", hint="lerobot 0.6.1"
        )
    # Sorted, because LeRobot's order changes from run to run.
    write_stats(dict(sorted(schema.fix_pose_statistics(stats).items())), root)
    add_episode_columns(root, {key: [record[key] for record in records] for key in _PLAIN_COLUMNS})
    add_episode_columns(root, {key: [_json(record[key]) for record in records] for key in _JSON_COLUMNS})
    write_atomically(root / "meta" / "cameras.json", _cameras([record["camera"] for record in records]))
    write_atomically(root / "README.md", dataset_card(root, options, records, repo_id).encode())
    shutil.rmtree(root / "images", ignore_errors=True)
    write_manifest(root / "meta" / "collection.json", options)


def add_episode_columns(root: Path, columns: dict[str, list[Any]]) -> None:
    """Adds per-episode columns to a finalised dataset: readable as ``ds.meta.episodes[i][name]``.

    LeRobot has no call for this; its reader takes whatever columns ``meta/episodes`` has.

    Args:
        root: of the dataset.
        columns: name -> one value per episode, by episode index.
    """
    for path in sorted((root / "meta" / "episodes").glob("*/*.parquet")):
        table = pq.read_table(path)
        indices = table["episode_index"].to_pylist()
        for name, values in columns.items():
            table = table.append_column(name, pa.array([values[index] for index in indices]))
        # Hugging Face's schema note lists the columns of before; without it the reader takes the types of the file.
        table = table.replace_schema_metadata(None)
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="snappy")
        write_atomically(path, sink.getvalue().to_pybytes())


def _cameras(cameras: list[dict[str, Any]]) -> bytes:
    fixed = {key: value for key, value in cameras[0].items() if all(camera.get(key) == value for camera in cameras)}
    content = {
        "front": {
            "constant": fixed,
            "per_episode": sorted(set(cameras[0]) - set(fixed)),
            "where": "column `camera` of meta/episodes holds every episode's parameters as JSON",
        }
    }
    return (_json(content, indent=2) + "\n").encode()


def _json(value: Any, indent: int | None = None) -> str:
    return json.dumps(value, sort_keys=True, indent=indent)
