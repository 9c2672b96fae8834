"""Open a dataset; raise one clear error if it is missing, half written, or has another layout."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, manifest_path
from lerobot_adamanip.datasets.description import (
    VERSION,
    OtherFormatError,
    UntrustedValueError,
    check_info,
    check_video,
)
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, is_dense
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import parse, read
from lerobot_adamanip.util.video import open_mp4

MAX_STATISTICS_BYTES = 100_000_000
JSON_COLUMNS = ("hidden_state", "hidden_overrides", "start", "camera", "versions", "failures", "episode_record")
"""Columns of episodes that hold JSON."""


def load_check(root: str | Path, *, num_points: int | None = None, recordings: bool = False) -> dict[str, Any]:
    """Checks a dataset without decoding it, and returns its ``meta/info.json``.

    Args:
        root: folder of a LeRobotDataset.
        num_points: required number of points per cloud; None for any.
        recordings: also accept a robot's recording, whose rows are ticks without clouds.

    Raises:
        DatasetError: it is missing or half written (no metadata, no Parquet footer, missing rows or videos), or a
            column of the contract is missing or has another shape.
    """
    folder = Path(root).absolute()
    info = checked_info(folder)
    try:
        read(folder / "meta" / "stats.json", max_bytes=MAX_STATISTICS_BYTES)
    except (OSError, ValueError) as error:
        raise damaged(folder, f"meta/stats.json: {error}") from error
    _check_rows(folder, info)
    if not is_dense(info["features"]):
        _check_features(folder, info, num_points)
    elif not recordings:
        raise _recording(folder, info["features"])
    return info


def open_dataset(root: str | Path, *, num_points: int | None = None, **options: Any) -> Any:
    """Returns a checked ``LeRobotDataset``; passes ``options`` on (``episodes``, ``delta_timestamps``, ...)."""
    load_check(root, num_points=num_points)
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    folder = Path(root).absolute()
    return LeRobotDataset(f"local/{folder.name}", root=folder, **options)


def episode_table(root: str | Path, *, statistics: bool = False) -> pa.Table:
    """Returns the per-episode columns of a dataset, ordered by episode; statistics only if wanted."""
    paths = sorted((Path(root) / "meta" / "episodes").glob("*/*.parquet"))
    tables = [read_episodes(path, statistics=statistics) for path in paths]
    return pa.concat_tables(tables, promote_options="default").sort_by("episode_index")


def read_episodes(path: Path, *, statistics: bool = False) -> pa.Table:
    """Returns a file of ``meta/episodes``, with or without statistics; never with those of clouds.

    LeRobot's tools write statistics of each coordinate of a cloud, which are most of the file.
    """
    left_out = f"stats/{schema.POINT_CLOUD}/" if statistics else "stats/"
    return pq.read_table(path, columns=[name for name in pq.read_schema(path).names if not name.startswith(left_out)])


def episode_records(root: str | Path) -> list[dict[str, Any]]:
    """Returns each episode's columns, with JSON decoded; raises `DatasetError` if some are missing."""
    rows: list[dict[str, Any]] = episode_table(root).to_pylist()
    try:
        return [{**row, **{name: parse(row[name]) for name in JSON_COLUMNS}} for row in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            "The episodes do not say how they were made.",
            got=f"{Path(root).name}: {type(error).__name__} {error}",
            allowed="the columns that `adamanip collect` writes into meta/episodes",
            hint="a dataset of `adamanip collect`",
        ) from error


def checked_info(folder: Path) -> dict[str, Any]:
    """Returns ``meta/info.json`` of an absolute folder.

    Raises:
        DatasetError: there is no dataset, it has another format, is damaged, or has values that are not passed on.
    """
    if not is_dataset(folder):
        raise missing_dataset(folder)
    try:
        info = read_info(folder)
    except UntrustedValueError as error:
        raise untrusted(folder, error) from error
    except OtherFormatError as error:
        raise DatasetError(
            "This dataset has another format.",
            got=f"{as_typed(folder)}: {error}",
            allowed=f"format {VERSION} of LeRobot",
            hint=f"{conversion_command(folder)}, which converts format v2.1",
        ) from error
    except (OSError, ValueError) as error:
        raise damaged(folder, f"meta/info.json: {error}") from error
    return info


def conversion_command(folder: Path) -> str:
    """Returns LeRobot's command that converts a dataset from format v2.1."""
    module = "lerobot.scripts.convert_dataset_v21_to_v30"
    return f"python -m {module} --repo-id=local/{folder.name} --root={as_typed(folder)} --push-to-hub=false"


def is_dataset(folder: Path) -> bool:
    """Returns whether a folder holds a dataset, complete or not."""
    return (folder / "meta" / "info.json").exists() or any(folder.glob("data/*/*.parquet"))


def missing_dataset(folder: Path) -> DatasetError:
    """Returns the error for a path without a dataset; names an unfinished collection or datasets in the folder."""
    partial, shown = CollectionPaths(folder.resolve()), as_typed(folder)
    if partial.partial.is_dir():
        done = len(list(partial.episodes.glob("*.safetensors")))
        return DatasetError(
            "This dataset is not finished.",
            got=f"{done} episodes in {partial.partial}",
            allowed=f"a complete dataset at {folder}",
            hint="the same `adamanip collect` command; it resumes",
        )
    got, hint = shown, f"adamanip collect {shown} --category safe"
    if folder.is_dir():
        inside = sorted(as_typed(path.parent.parent) for path in folder.glob("*/meta/info.json"))
        got = f"{shown}, a folder with other files" if any(folder.iterdir()) else f"{shown}, an empty folder"
        hint = f"{inside[0]}, which is a dataset" if inside else "another folder"
    elif folder.exists():
        got, hint = f"{shown}, a file", "the folder of a dataset"
    return DatasetError("There is no dataset.", got=got, allowed="a folder with meta/info.json", hint=hint)


def as_typed(folder: Path) -> str:
    """Returns a folder's path as a user types it: relative if it is below the working directory."""
    here = Path.cwd()
    return str(folder.relative_to(here) if folder.is_relative_to(here) else folder)


def workspace_of(root: Path, features: dict[str, Any]) -> Workspace:
    """Returns the workspace of a dataset's clouds: from the manifest, the column's description, or the default."""
    told: Any = (features.get(schema.POINT_CLOUD, {}).get("info") or {}).get("workspace")
    if manifest_path(root).exists():
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # `read_manifest` reports errors
            told = read(manifest_path(root))["collection"]["environment"]["workspace"]
    try:
        return DEFAULT_WORKSPACE if told is None else Workspace(tuple(told["lower"]), tuple(told["upper"]))
    except (KeyError, TypeError, ValueError):
        return DEFAULT_WORKSPACE


def camera_of(features: dict[str, Any]) -> str:
    """Returns the key of the camera whose depth became a dataset's clouds; a dataset names it if it is not `FRONT`."""
    return str((features.get(schema.POINT_CLOUD, {}).get("info") or {}).get("camera", FRONT))


def _recording(folder: Path, features: dict[str, Any]) -> DatasetError:
    name = as_typed(folder)
    hint = f"adamanip keyframes {name} --out {name}-keyframes"
    if not any(key.endswith(DEPTH_SUFFIX) for key in features):
        hint = "lerobot-record with a camera that tells depth: this recording has none to make clouds of"
    return DatasetError(
        "This is a recording of ticks, not a dataset of key frames.",
        got=f"{name}, without {schema.POINT_CLOUD}",
        allowed="a dataset of `adamanip collect` or `adamanip keyframes`",
        hint=hint,
    )


def damaged(folder: Path, what: object) -> DatasetError:
    """Returns the error for a half written or damaged dataset."""
    return DatasetError(
        "This dataset is half written or damaged.",
        got=f"{folder}: {what}",
        allowed="complete Parquet, JSON and video files",
        hint=f"adamanip check {as_typed(folder)} --repair, which mends counts and statistics and lists other damage",
    )


def untrusted(folder: Path, error: object) -> DatasetError:
    """Returns the error for a value of a dataset that could make a library do something else."""
    return DatasetError(
        "This dataset has a value that is not passed on to other programs.",
        got=f"{folder}: {error}"[:400],
        allowed="values that LeRobot or `adamanip` writes",
        hint="a copy of the dataset from a source that you trust",
    )


def read_info(folder: Path) -> dict[str, Any]:
    """Returns ``meta/info.json`` after checking it.

    Raises:
        OSError: it does not exist.
        OtherFormatError: the dataset has another format.
        UntrustedValueError: a value is not one that LeRobot or this project writes.
        ValueError: it is not JSON, or lacks a field.
    """
    return check_info(read(folder / "meta" / "info.json"))


def read_back(root: str | Path, lengths: Sequence[int] | None = None) -> None:
    """Reads a whole dataset: all rows and all video frames.

    Raises:
        DatasetError: anything is missing or unreadable, or the episodes' numbers of rows differ from ``lengths``.
    """
    folder = Path(root).absolute()
    info = load_check(folder, recordings=True)
    try:
        found = [int(row["length"]) for row in episode_table(folder).to_pylist()]
        rows = sum(pq.read_table(path).num_rows for path in (folder / "data").glob("*/*.parquet"))
        frames = {
            key: sum(_decoded(path) for path in (folder / "videos" / key).glob("*/*.mp4"))
            for key, feature in info["features"].items()
            if feature["dtype"] == "video"
        }
    except (OSError, ValueError, pa.ArrowException) as error:
        raise damaged(folder, error) from error
    wanted = list(found if lengths is None else lengths)
    if found != wanted or any(count != sum(wanted) for count in (rows, *frames.values())):
        raise damaged(folder, f"{len(found)} episodes, {rows} rows, frames {frames}; {sum(wanted)} were written")


def _decoded(path: Path) -> int:
    with contextlib.closing(open_mp4(path)) as container:
        return sum(1 for _ in container.decode(video=0))


def _check_rows(folder: Path, info: dict[str, Any]) -> None:
    for pattern, total in (("data/*/*.parquet", "total_frames"), ("meta/episodes/*/*.parquet", "total_episodes")):
        rows = 0
        for path in folder.glob(pattern):
            try:
                rows += pq.read_metadata(path).num_rows
            except (OSError, pa.ArrowException) as error:
                raise damaged(folder, f"{path.relative_to(folder)}: {error}") from error
        if rows == 0 or rows != info[total]:
            raise damaged(folder, f"{rows} rows in {pattern}, but {total} = {info[total]}")
    for key, feature in info["features"].items():
        if feature["dtype"] == "video":
            paths = list((folder / "videos" / key).glob("*/*.mp4"))
            if not paths:
                raise damaged(folder, f"no videos of {key}")
            check_videos(folder, paths)


def check_videos(folder: Path, paths: Iterable[Path]) -> None:
    """Raises `DatasetError` for a video file of a dataset that is no MP4 file."""
    try:
        for path in paths:
            check_video(path)
    except UntrustedValueError as error:
        raise untrusted(folder, error) from error


def _check_features(folder: Path, info: dict[str, Any], num_points: int | None) -> None:
    found = {key: tuple(feature["shape"]) for key, feature in info["features"].items()}
    cloud = found.get(schema.POINT_CLOUD, ())
    points = num_points or (cloud[0] // 3 if cloud and cloud[0] % 3 == 0 else schema.DEFAULT_NUM_POINTS)
    expected = schema.dataset_features(points)
    for key in (schema.POINT_CLOUD, schema.STATE, schema.ACTION):
        wanted = tuple(expected[key]["shape"])
        if found.get(key) != wanted:
            raise DatasetError(
                f"Column {key} does not fit.",
                got=f"shape {found.get(key, 'missing')} in {folder}",
                allowed=f"shape {wanted}",
                hint=f"adamanip collect DIR --num-points {points}, or another dataset",
            )
