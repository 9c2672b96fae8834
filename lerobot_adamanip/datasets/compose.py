"""Write a dataset from selected episodes of other datasets, for merge, filter and split.

Rows, videos, columns of episodes and statistics are copied; indices are renumbered. LeRobot's own tools re-encode
videos and drop columns of episodes that they do not know.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_adamanip.datasets.appending import append_rows, can_append
from lerobot_adamanip.datasets.cutting import cut_episode
from lerobot_adamanip.datasets.dataset import TASKS, Dataset, camera_of, read_back
from lerobot_adamanip.datasets.encoding import quieten, video_encoder
from lerobot_adamanip.datasets.opening import as_typed, damaged, plain_feature
from lerobot_adamanip.datasets.pose_statistics import keep_unscaled_poses
from lerobot_adamanip.datasets.selection import Selection, write_selection
from lerobot_adamanip.datasets.statistics import compute_statistics, write_statistics
from lerobot_adamanip.datasets.writing import add_episode_columns, camera_records, cameras_json, workspace_info
from lerobot_adamanip.hardware.camera_frames import read_calibrations, to_json
from lerobot_adamanip.hardware.features import (
    ARM,
    CALIBRATIONS,
    CAMERA_NAMES,
    FRONT_CAMERA,
    SAFETY,
    is_dense,
    names_of,
)
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.json_fields import read

Progress = Callable[[int, int], None]
"""Called with the number of finished episodes and the total number."""
Column = NDArray[Any]
Pieces = Sequence[tuple[Dataset, int]]
"""Source datasets and episode indices, in the order of the new dataset."""
_OF_COLLECTION = ("meta/collection.json", "meta/attempts.jsonl")
_OF_ROBOT = (CALIBRATIONS, SAFETY)


@dataclass(frozen=True)
class Addition:
    """Columns and tasks that every episode of the new dataset has beside those of its source.

    Attributes:
        features: column -> description, after the source's own.
        compute: gets an episode's rows and their tasks; returns column -> (T, ...) values, and the new tasks.
    """

    features: Mapping[str, dict[str, Any]]
    compute: Callable[[pa.Table, list[str]], tuple[Mapping[str, Column], list[str]]]


NOTHING = Addition({}, lambda table, tasks: ({}, tasks))


def compose(
    out: Path,
    pieces: Pieces,
    repo_id: str,
    selection: Selection | None,
    progress: Progress = lambda done, total: None,
    *,
    addition: Addition = NOTHING,
) -> None:
    """Writes a dataset of these episodes and verifies it by reading it back.

    Recordings beside simulated demonstrations lose the column `ARM`, which no policy reads.

    Args:
        out: a folder that does not exist.
        pieces: one or more episodes, of datasets with equal features.
        repo_id: repository id for LeRobot.
        selection: the dataset that the new one is a part of, if any; its manifest and attempts are copied.
        progress: called after each episode.
        addition: further columns, and changed tasks.

    Raises:
        DatasetError: a source is damaged, or the sources are recordings with different calibrations.
        ConfigurationError: this version of LeRobot writes datasets differently.
    """
    from lerobot.datasets.feature_utils import get_hf_features_from_features

    sources = list({source.root: source for source, _ in pieces}.values())
    _require_same_calibrations(sources)
    own = sources[0].info["features"]
    if not all(ARM in source.features for source in sources):
        own = {key: feature for key, feature in own.items() if key != ARM}
    info = {**sources[0].info, "features": {**own, **addition.features}}
    dataset, lengths = _create(out, info, repo_id), []
    schema = get_hf_features_from_features(dataset.meta.features).arrow_schema
    for done, (source, episode) in enumerate(pieces, start=1):
        lengths.append(_append(dataset, schema, source, episode, addition))
        files.crash_point("episode assembled")
        progress(done, len(pieces))
    dataset.finalize()
    files.crash_point("dataset written")
    _restore_info(out, sources)
    _describe(out, pieces, selection, dataset.meta.features)
    keep_unscaled_poses(out, sources)
    files.crash_point("dataset described")
    files.sync_tree(out)
    files.crash_point("dataset synced")
    read_back(out, lengths)
    files.crash_point("dataset verified")


def _create(out: Path, info: Mapping[str, Any], repo_id: str) -> Any:
    import lerobot
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.utils.constants import DEFAULT_FEATURES

    quieten()
    own = {key: plain_feature(feature) for key, feature in info["features"].items() if key not in DEFAULT_FEATURES}
    dataset = LeRobotDataset.create(
        repo_id=repo_id,
        fps=info["fps"],
        features=own,
        root=out,
        robot_type=info.get("robot_type"),
        rgb_encoder=video_encoder(),
        video_backend="pyav",
        video_files_size_in_mb=info.get("video_files_size_in_mb"),
        data_files_size_in_mb=info.get("data_files_size_in_mb"),
    )
    if info.get("chunks_size"):
        dataset.meta.update_chunk_settings(chunks_size=info["chunks_size"])
    if not can_append(dataset):
        raise ConfigurationError(
            "This version of LeRobot writes datasets differently.",
            got=f"lerobot {lerobot.__version__}",
            allowed="a version of docs/compatibility.md",
            hint="pip install 'lerobot==0.6.1'",
        )
    return dataset


def _append(dataset: Any, schema: pa.Schema, source: Dataset, index: int, addition: Addition) -> int:
    episode = source.episodes[index]
    table = source.rows(episode)
    numbers = table["task_index"].to_pylist()
    if unknown := set(numbers) - source.tasks.keys():
        raise damaged(source.root, f"{TASKS}: lacks task {unknown.pop()} of episode {episode.number}")
    tasks = [source.tasks[number] for number in numbers]
    videos = {
        key: cut_episode(source.root, key, feature, episode.row, source.fps)
        for key, feature in dataset.meta.features.items()
        if feature["dtype"] == "video"
    }
    columns, row_tasks = addition.compute(table, tasks)
    stats = {**source.statistics_of(index), **compute_statistics(columns, addition.features)}
    for key, values in columns.items():
        table = table.append_column(schema.field(key), pa.array(values.tolist(), schema.field(key).type))
    own = list(episode.tasks) if row_tasks == tasks else list(dict.fromkeys(row_tasks))
    return append_rows(dataset, _with_types(table, schema), own, row_tasks, stats=stats, videos=videos)


def _with_types(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Returns rows with LeRobot's types; its editing tools store the same values with other list types."""
    from datasets.table import table_cast

    if table.schema.equals(schema, check_metadata=True):
        return table
    plain = table.select(schema.names)
    cast = plain if plain.schema.equals(schema) else table_cast(plain, schema)
    return cast.replace_schema_metadata(schema.metadata)


def _restore_info(out: Path, sources: Sequence[Dataset]) -> None:
    """Replaces LeRobot's description of the new videos by the sources', where all sources agree."""
    path = out / "meta" / "info.json"
    info = read(path)
    for key, feature in info["features"].items():
        if key not in sources[0].features:
            continue
        details = [source.features[key].get("info") or {} for source in sources]
        if any(details):
            agreed = {name for name, value in details[0].items() if all(each.get(name) == value for each in details)}
            agreed |= {"video.codec"} & details[0].keys()  # videos of another codec were re-encoded
            feature["info"] = {name: value for name, value in details[0].items() if name in agreed}
    box = sources[0].workspace
    if box != DEFAULT_WORKSPACE and POINT_CLOUD in info["features"]:  # a merged dataset has no manifest
        info["features"][POINT_CLOUD].setdefault("info", {}).update(workspace_info(box))
    cameras = {camera_of(source.features) for source in sources} - {FRONT}
    if len(cameras) == 1:  # simulated clouds of a mix name no camera
        info["features"][POINT_CLOUD].setdefault("info", {})["camera"] = cameras.pop()
    files.write_atomically(path, json.dumps(info, indent=4, ensure_ascii=False).encode())


def _describe(
    out: Path, pieces: Pieces, selection: Selection | None, features: Mapping[str, Mapping[str, Any]]
) -> None:
    """Adds data that LeRobot does not write: episodes' own columns, cameras, calibrations and collection files."""
    write_statistics(out, features)
    rows = [source.own_columns.slice(episode, 1) for source, episode in pieces]
    columns = pa.concat_tables(rows, promote_options="permissive")
    add_episode_columns(out, columns)
    if cameras := camera_records(columns):
        files.write_atomically(out / "meta" / "cameras.json", cameras_json(cameras))
    first = pieces[0][0]
    if is_dense(features):
        _copy(first.root, out, _OF_ROBOT)
    if selection is not None:
        write_selection(out, selection)
        _copy(first.root, out, _OF_COLLECTION)


def _require_same_calibrations(sources: Sequence[Dataset]) -> None:
    """Raises `DatasetError` for recordings with different calibrations, since a dataset holds only one."""
    dense = [source for source in sources if is_dense(source.features)]
    if len(set(map(_robot, dense))) > 1:
        names = " ".join(as_typed(source.root) for source in dense)
        raise DatasetError(
            "These recordings have different camera calibrations or safety limits; a recording can hold only one.",
            got=", ".join(source.root.name for source in dense),
            allowed=f"recordings with the same {' and '.join(_OF_ROBOT)}",
            hint=f"adamanip keyframes {names} --out BOTH, which converts each with its own",
        )


def _robot(recording: Dataset) -> tuple[bytes, bytes | None]:
    """Returns its calibrations, without the pose of a front camera that its rows hold, and its safety limits."""
    path = recording.root / CALIBRATIONS
    known = read_calibrations(path) if path.is_file() else {}
    if FRONT_CAMERA in known and set(CAMERA_NAMES) <= set(names_of(recording.features.get(ARM))):
        known[FRONT_CAMERA] = known[FRONT_CAMERA].at(np.eye(4))
    return to_json(known), _content(recording.root / SAFETY)


def _copy(source: Path, out: Path, names: Sequence[str]) -> None:
    for name in names:
        if (content := _content(source / name)) is not None:
            files.write_atomically(out / name, content)


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None
