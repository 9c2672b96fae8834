"""Opening a demonstration dataset, with one clear error if it is not there, not whole, or of another layout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip import schema
from lerobot_adamanip.demos.collection import CollectionPaths
from lerobot_adamanip.errors import DatasetError


def load_check(root: str | Path, *, num_points: int | None = None) -> dict[str, Any]:
    """Checks a dataset without decoding it, and returns its ``meta/info.json``.

    Args:
        root: folder of a LeRobotDataset.
        num_points: points per cloud it has to have; any number if None.

    Raises:
        DatasetError: if it is missing, half written (no metadata, no Parquet footer, rows or videos missing), or lacks
            a column of the contract or has it in another shape.
    """
    folder = Path(root).absolute()
    if not folder.is_dir():
        raise _missing(folder)
    info = _info(folder)
    _check_rows(folder, info)
    _check_features(folder, info, num_points)
    return info


def open_dataset(root: str | Path, *, num_points: int | None = None, **options: Any) -> Any:
    """Returns a checked ``LeRobotDataset``. ``options`` are passed on (``episodes``, ``delta_timestamps``, ...)."""
    load_check(root, num_points=num_points)
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    folder = Path(root).absolute()
    return LeRobotDataset(f"local/{folder.name}", root=folder, **options)


def episode_table(root: str | Path) -> pa.Table:
    """Returns the per-episode columns of a dataset, without statistics, ordered by episode."""
    paths = sorted((Path(root) / "meta" / "episodes").glob("*/*.parquet"))
    tables = [pq.read_table(path) for path in paths]
    table = pa.concat_tables(tables).sort_by("episode_index")
    return table.select([name for name in table.column_names if not name.startswith("stats/")])


def _missing(folder: Path) -> DatasetError:
    partial = CollectionPaths(folder)
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
        hint=f"adamanip collect --category safe --root {folder.name}",
    )


def _half_written(what: object) -> DatasetError:
    return DatasetError(
        "This dataset is half written or damaged.",
        got=what,
        allowed="complete Parquet, JSON and video files",
        hint="collect it again: delete the folder and run `adamanip collect`",
    )


def _info(folder: Path) -> dict[str, Any]:
    try:
        info: dict[str, Any] = json.loads((folder / "meta" / "info.json").read_text())
        json.loads((folder / "meta" / "stats.json").read_text())
        _ = info["features"], info["total_frames"], info["total_episodes"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _half_written(f"{folder}: {error}") from error
    return info


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
    features = info["features"]
    found = {key: tuple(feature["shape"]) for key, feature in features.items()}
    cloud = found.get(schema.POINT_CLOUD, ())
    points = num_points or (cloud[0] if len(cloud) == 2 else schema.DEFAULT_NUM_POINTS)
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
