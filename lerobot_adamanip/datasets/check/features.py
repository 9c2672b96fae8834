"""Check columns against the contract, `lerobot_adamanip.contract.schema`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import CAMERAS, image_column, is_image_column
from lerobot_adamanip.contract.memory import MEMORY, memory_feature
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.dense import dense_contract, is_dense_collection
from lerobot_adamanip.datasets.output_folder import INFO
from lerobot_adamanip.hardware.features import is_dense, names_of

OF_LEROBOT: Mapping[str, str] = {
    "timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64",
}  # fmt: skip
"""Columns that LeRobot adds to every dataset, and their dtypes."""
REQUIRED = (schema.POINT_CLOUD, schema.STATE, schema.ACTION)
"""Columns of every dataset of key frames. A robot's may lack the other columns; a collection has all."""


def check_features(features: Mapping[str, Mapping[str, Any]], report: Report, *, collected: bool) -> None:
    """Reports columns that are missing or differ from the contract; ``collected`` datasets must have all columns."""
    if is_dense(features):
        _check_dense(features, report)
        return
    contract = contract_of(features)
    for key, expected in contract.items():
        feature = features.get(key)
        if feature is None:
            if collected or key in (*REQUIRED, *OF_LEROBOT):
                report.add("schema", f"no column {key}", INFO)
            continue
        for name in ("dtype", "shape", "names"):
            actual, right = _plain(feature.get(name)), _plain(expected.get(name))
            as_pictures = name == "dtype" and right == "video" and actual == "image"
            if actual != right and not as_pictures and not (name == "names" and right is None):
                report.add("schema", f"{key}: {name} {actual!r:.80}, not {right!r:.80}", INFO)
    for key in features:
        if key.startswith("observation.") and key not in contract and not is_image_column(key):
            report.add("schema", f"{key} is not in the contract; every policy would use it as an input", INFO)


def _check_dense(features: Mapping[str, Mapping[str, Any]], report: Report) -> None:
    """Checks a robot's recording: the number of its names, and LeRobot's columns."""
    for key in (schema.STATE, schema.ACTION):
        if list(features[key]["shape"]) != [len(names_of(features[key]))]:
            report.add("schema", f"{key}: shape {features[key]['shape']!r:.80}, not that of its names", INFO)
    for key, dtype in OF_LEROBOT.items():
        if (features.get(key) or {}).get("dtype") != dtype:
            report.add("schema", f"no column {key} of {dtype}", INFO)


def contract_of(features: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Returns the contract for this dataset's number of points and image size."""
    of_lerobot = {key: {"dtype": dtype, "shape": (1,)} for key, dtype in OF_LEROBOT.items()}
    if MEMORY in features:
        of_lerobot |= {MEMORY: memory_feature()}
    if is_dense_collection(features):
        return {**dense_contract(features), **of_lerobot}
    cloud = list(features.get(schema.POINT_CLOUD, {}).get("shape", ()))
    points = max(1, cloud[0] // 3) if cloud else schema.DEFAULT_NUM_POINTS
    cameras = [name for name in CAMERAS if image_column(name) in features]
    image = list(features[image_column(cameras[0])].get("shape", ())) if cameras else []
    size = image[0] if image else schema.IMAGE_SIZE
    own = schema.dataset_features(points, size, cameras=cameras)
    return {**own, **of_lerobot}


def _plain(value: object) -> object:
    """Converts tuples, and grouped names as in LeRobot's robots, to lists."""
    if isinstance(value, Mapping):
        return [name for group in value.values() for name in group]
    return list(value) if isinstance(value, tuple) else value
