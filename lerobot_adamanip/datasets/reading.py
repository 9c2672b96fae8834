"""Open a dataset; raise one clear error if it is missing, half written, or has another layout."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, manifest_path
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, is_dense
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import parse, read

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
"""LeRobot's templates. Datasets with other paths in their metadata are refused: those could point anywhere."""
MAX_STATISTICS_BYTES = 100_000_000
JSON_COLUMNS = ("hidden_state", "hidden_overrides", "start", "camera", "versions", "failures", "episode_record")
"""Columns of episodes that hold JSON."""
_KEY = re.compile(r"[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*")
_DTYPE = re.compile(r"[a-z0-9]{1,16}")


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
    if not folder.is_dir():
        raise missing_dataset(folder)
    try:
        info = read_info(folder)
        read(folder / "meta" / "stats.json", max_bytes=MAX_STATISTICS_BYTES)
    except (OSError, ValueError) as error:
        raise _half_written(f"{folder}: {error}") from error
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


def missing_dataset(folder: Path) -> DatasetError:
    """Returns the error for a folder without a dataset; mentions an unfinished collection beside it."""
    partial = CollectionPaths(folder.resolve())
    if partial.partial.is_dir():
        done = len(list(partial.episodes.glob("*.safetensors")))
        return DatasetError(
            "This dataset is not finished.",
            got=f"{done} episodes in {partial.partial}",
            allowed=f"a complete dataset at {folder}",
            hint="the same `adamanip collect` command; it resumes",
        )
    return DatasetError(
        "There is no dataset.",
        got=folder,
        allowed="a folder that `adamanip collect` wrote",
        hint=f"adamanip collect {as_typed(folder)} --category safe",
    )


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


def _half_written(what: object) -> DatasetError:
    return DatasetError(
        "This dataset is half written or damaged.",
        got=what,
        allowed="complete Parquet, JSON and video files",
        hint="collect it again: delete the folder and run `adamanip collect`",
    )


def read_info(folder: Path) -> dict[str, Any]:
    """Returns ``meta/info.json`` after checking its columns and paths.

    Raises:
        OSError: it does not exist.
        ValueError: it is not JSON, or has invalid values.
    """
    info: dict[str, Any] = read(folder / "meta" / "info.json")
    try:
        for total in ("total_frames", "total_episodes", "fps"):
            if not isinstance(info[total], int) or isinstance(info[total], bool):
                raise ValueError(f"{total} is no whole number")
        for name, template in (("data_path", DATA_PATH), ("video_path", VIDEO_PATH)):
            if info.get(name) not in (template, None):
                raise ValueError(f"{name} is not LeRobot's: {str(info[name])[:100]!r}")
        for key, feature in info["features"].items():
            _check_feature(key, feature)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"it lacks or garbles {error}") from error
    return info


def _check_feature(key: str, feature: dict[str, Any]) -> None:
    """Raises ValueError for an invalid column; video names are parts of paths."""
    sizes = feature["shape"]
    sound = all(isinstance(size, int) and 0 < size <= 1_000_000 for size in sizes) and len(sizes) <= 4
    if not _KEY.fullmatch(key) or not sound or not _DTYPE.fullmatch(feature["dtype"]):
        raise ValueError(f"column {key[:100]!r} cannot be")


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
        raise _half_written(f"{folder}: {error}") from error
    wanted = list(found if lengths is None else lengths)
    if found != wanted or any(count != sum(wanted) for count in (rows, *frames.values())):
        raise _half_written(
            f"{folder}: {len(found)} episodes, {rows} rows, frames {frames}; {sum(wanted)} were written"
        )


def _decoded(path: Path) -> int:
    import av

    with contextlib.closing(av.open(str(path))) as container:
        return sum(1 for _ in container.decode(video=0))


def _check_rows(folder: Path, info: dict[str, Any]) -> None:
    for pattern, total in (("data/*/*.parquet", "total_frames"), ("meta/episodes/*/*.parquet", "total_episodes")):
        rows = 0
        for path in folder.glob(pattern):
            try:
                rows += pq.read_metadata(path).num_rows
            except (OSError, pa.ArrowException) as error:
                raise _half_written(f"{path}: {error}") from error
        if rows == 0 or rows != info[total]:
            raise _half_written(f"{folder}: {rows} rows in {pattern}, but {total} = {info[total]}")
    for key, feature in info["features"].items():
        if feature["dtype"] == "video" and not any((folder / "videos" / key).glob("*/*.mp4")):
            raise _half_written(f"{folder}: no videos of {key}")


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
                hint=f"adamanip collect --num-points {points}, or another dataset",
            )
