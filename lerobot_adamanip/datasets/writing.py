"""Create a LeRobotDataset with this project's columns, and add columns to its episodes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.datasets.encoding import ENCODER_THREADS, quieten, video_encoder
from lerobot_adamanip.datasets.episode import to_json
from lerobot_adamanip.util import files
from lerobot_adamanip.util.json_fields import parse

_OPTIONS: dict[str, Any] = {
    "robot_type": "panda",
    "encoder_threads": ENCODER_THREADS,
    "video_backend": "pyav",
    "video_files_size_in_mb": 25,
}
"""LeRobot's options. Video files are small, because LeRobot copies a whole file to append an episode."""


def create_dataset(
    root: Path,
    repo_id: str,
    *,
    features: dict[str, dict[str, Any]],
    fps: int = schema.FPS,
    intrinsics: list[list[float]] | None = None,
    workspace: Workspace | None = None,
    depth_camera: str = FRONT,
) -> Any:
    """Returns an empty LeRobotDataset with the contract's columns.

    Args:
        root: a folder that does not exist.
        repo_id: repository id for LeRobot.
        features: columns of the dataset, see `schema.dataset_features`.
        fps: rows per second.
        intrinsics: (3, 3) of the front camera at that size [px], if known.
        workspace: box of the clouds, if no manifest has it and it is not the default.
        depth_camera: key of the camera whose depth becomes the clouds; `FRONT` is not stored.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    quieten()
    if schema.POINT_CLOUD in features:
        info = {"unit": "m", "frame": "robot_base", **workspace_info(workspace)}
        features[schema.POINT_CLOUD]["info"] = info if depth_camera == FRONT else {**info, "camera": depth_camera}
    if schema.FRONT_IMAGE in features:
        features[schema.FRONT_IMAGE]["info"] = {"intrinsics": intrinsics, "cameras": "meta/cameras.json"}
    return LeRobotDataset.create(
        repo_id=repo_id,
        fps=fps,
        features=features,
        root=root,
        **_OPTIONS,
        rgb_encoder=video_encoder(),
    )


def workspace_info(workspace: Workspace | None) -> dict[str, Any]:
    """Returns the entry for a cloud column's description that holds the workspace."""
    if workspace is None:
        return {}
    return {"workspace": {"lower": list(workspace.lower), "upper": list(workspace.upper)}}


def add_episode_columns(root: Path, columns: Mapping[str, list[Any]] | pa.Table) -> None:
    """Adds columns, one value per episode, to a finalised dataset: ``ds.meta.episodes[i][name]``."""
    added = columns if isinstance(columns, pa.Table) else pa.table(columns)
    for path in sorted((root / "meta" / "episodes").glob("*/*.parquet")):
        # LeRobot's tools write statistics of each coordinate of a cloud, which are most of the file.
        names = [name for name in pq.read_schema(path).names if not name.startswith(f"stats/{schema.POINT_CLOUD}/")]
        table = pq.read_table(path, columns=names)
        values = added.take(table["episode_index"])
        for name in values.column_names:
            if name not in table.column_names:
                table = table.append_column(name, values[name])
        repeated = [name for name in table.column_names if not name.startswith("stats/")]
        # Hugging Face's schema note lists the old columns; without it the reader uses the types of the file.
        plain, sink = table.replace_schema_metadata(None), pa.BufferOutputStream()
        pq.write_table(plain, sink, compression="zstd", use_dictionary=repeated)
        files.write_atomically(path, sink.getvalue().to_pybytes())


def camera_records(episodes: pa.Table) -> list[dict[str, Any]]:
    """Returns each episode's camera parameters; empty if those of any episode are unknown."""
    texts = episodes["camera"].to_pylist() if "camera" in episodes.column_names else []
    try:
        cameras = [parse(text) for text in texts]
    except (TypeError, ValueError):
        return []
    return cameras if all(isinstance(each, dict) for each in cameras) else []


def cameras_json(cameras: list[dict[str, Any]]) -> bytes:
    """Returns ``meta/cameras.json``: constant parameters, and names of those that vary between episodes."""
    fixed = {key: value for key, value in cameras[0].items() if all(camera.get(key) == value for camera in cameras)}
    content = {
        "front": {
            "constant": fixed,
            "per_episode": sorted(set(cameras[0]) - set(fixed)),
            "where": "column `camera` of meta/episodes holds every episode's parameters as JSON",
        }
    }
    return (to_json(content, indent=2) + "\n").encode()
