"""Columns of a robot's recording, and the files next to it.

A recording has the columns of simulated demonstrations at control rate, `schema.dense_features`. What else the recorder
knows, among it a clock, is in the column `ARM`, which no policy reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.contract.control import ACTION_NAMES, STATES
from lerobot_adamanip.contract.memory import MEMORY, MEMORY_NAMES, memory_feature
from lerobot_adamanip.contract.schema import (
    ACTION,
    EFFORT_NAMES,
    KEY_FRAME,
    OUTCOME,
    POINT_CLOUD,
    POSE_NAMES,
    STATE,
    STATE_NAMES,
    dense_features,
)

ARM = "complementary_info.arm"
"""Column with the arm's reading of each row, see `ARM_NAMES`."""
SENT_NAMES = tuple(f"sent.{name.removesuffix('.pos')}" for name in POSE_NAMES)
"""Names of the last accepted target. LeRobot stores the teleoperator's action, which the filter may have clipped."""
OUTCOME_NAME = "arm.outcome"
"""`keyframes.Outcome` of the latest key frame; -1 before the first and during streaming."""
STAMP_NAME = "arm.stamp"
"""Measurement time of the state [s since connection]. LeRobot's rows have only the loop's nominal time."""
FRONT_CAMERA = "front"
"""Key of the camera whose depth becomes the point cloud."""
CAMERA_NAMES = tuple(f"{FRONT_CAMERA}_camera.{name.removesuffix('.pos')}" for name in POSE_NAMES[:9])
"""Names of the front depth imager's pose, in the base or tool frame as in its calibration; zeros without one. It may
change between episodes: a simulated camera stands elsewhere in each scene, a real one is calibrated again."""
ARM_NAMES = (*STATE_NAMES, *EFFORT_NAMES, *SENT_NAMES, OUTCOME_NAME, STAMP_NAME, *CAMERA_NAMES)
UNLABELLED = -1
"""Phase and trial of human demonstrations."""
DEPTH_SUFFIX = "_depth"
"""Suffix of a camera's depth image: uint16 [mm], 0 for invalid pixels."""

INTERVENTION = "intervention"
"""Column of recorded rollouts: whether a person or an expert had taken over."""
KEY_FRAME_COLUMNS = frozenset((POINT_CLOUD, OUTCOME))
"""Columns of datasets of key frames. Data at control rate may have them too, beside `schema.KEY_FRAME`."""

CALIBRATIONS = "meta/calibrations.json"
"""Calibration file of a recording."""
SAFETY = "meta/safety.json"
"""`SafetyLimits` of a recording."""


def names_of(feature: Mapping[str, Any] | None) -> list[str]:
    """Returns the names of a column's numbers in order. LeRobot stores them as a list or in groups."""
    names = (feature or {}).get("names")
    return [name for group in names.values() for name in group] if isinstance(names, Mapping) else list(names or ())


def recorded_kind(feature: Mapping[str, Any] | None, kinds: Mapping[str, tuple[str, ...]]) -> str | None:
    """Returns the kind whose names a column has, of `STATES` or `ACTION_NAMES`; None if it has other names."""
    names = tuple(names_of(feature))
    return next((kind for kind, own in kinds.items() if own == names), None)


def split_memory(features: Mapping[str, Any]) -> dict[str, Any]:
    """Returns features with the memory in a column of its own: LeRobot puts all numbers of a robot into the state."""
    names = names_of(features.get(STATE))
    if not set(MEMORY_NAMES) <= set(names):
        return dict(features)
    own = [name for name in names if name not in MEMORY_NAMES]
    state = {**features[STATE], "shape": (len(own),), "names": own}
    return {**features, STATE: state, MEMORY: memory_feature()}


def recorded_features(features: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the features of a recording: LeRobot's for a robot, the labels of simulated demonstrations, and `ARM`."""
    action, state = (names_of(features[key]) for key in (ACTION, STATE))
    labels = dense_features(action, state, cameras=())
    arm = {"dtype": "float32", "shape": (len(ARM_NAMES),), "names": list(ARM_NAMES)}
    return {**labels, **features, ARM: arm}


def is_dense(features: Mapping[str, Any]) -> bool:
    """Returns whether the features are those of a recording of our robots, complete or as LeRobot makes them.

    Simulated demonstrations are no recordings: they have labels, but not the column `ARM`.
    """
    if ARM in features:
        return True
    if (KEY_FRAME_COLUMNS | {KEY_FRAME}) & set(features):
        return False
    has_kinds = recorded_kind(features.get(STATE), STATES) and recorded_kind(features.get(ACTION), ACTION_NAMES)
    return bool(has_kinds)
