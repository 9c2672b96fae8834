"""Columns of simulated datasets at control rate: their contract, and the kinds of their action and state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import CAMERAS, image_column
from lerobot_adamanip.contract.control import ACTION_NAMES, STATES
from lerobot_adamanip.hardware.features import ARM

Features = Mapping[str, Mapping[str, Any]]


def is_dense_collection(features: Features) -> bool:
    """Returns whether a dataset was collected at control rate. A robot's recording has a column of its arm as well."""
    return schema.KEY_FRAME in features and ARM not in features


def kind_by_size(features: Features, key: str) -> str:
    """Returns the kind of ``action`` or ``observation.state`` by its size; the first kind for an unknown size."""
    kinds: Mapping[str, tuple[str, ...]] = ACTION_NAMES if key == schema.ACTION else STATES
    size = tuple(features.get(key, {}).get("shape", ()))
    return next((kind for kind, names in kinds.items() if (len(names),) == size), next(iter(kinds)))


def dense_contract(features: Features) -> dict[str, dict[str, Any]]:
    """Returns the features that a simulated dataset at control rate must have, by its sizes."""
    cloud = tuple(features.get(schema.POINT_CLOUD, {}).get("shape", ()))
    cameras = [name for name in CAMERAS if image_column(name) in features]
    size = features[image_column(cameras[0])]["shape"][0] if cameras else schema.IMAGE_SIZE
    return schema.dense_features(
        ACTION_NAMES[kind_by_size(features, schema.ACTION)],
        STATES[kind_by_size(features, schema.STATE)],
        image_size=size,
        cameras=cameras,
        num_points=max(1, cloud[0] // 3) if cloud else None,
        has_effort=schema.EFFORT in features,
    )
