"""Names of the robot's features and of the files in a dense recording.

LeRobot's recorder puts all scalars into one ``observation.state``, in this order. Rollouts keep only names that end in
``.pos`` or ``.vel``, the policy's state. No other name may have these endings.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.contract.schema import ACTION, EFFORT_NAMES, OUTCOME, POINT_CLOUD, POSE_NAMES, STATE, STATE_NAMES

SENT_NAMES = tuple(f"sent.{name.removesuffix('.pos')}" for name in POSE_NAMES)
"""Names of the last accepted target. LeRobot stores the teleoperator's action, which the filter may have clipped."""
OUTCOME_NAME = "arm.outcome"
"""`keyframes.Outcome` of the latest key frame; -1 before the first and during streaming."""
STAMP_NAME = "arm.stamp"
"""Measurement time of the state [s since connection]. LeRobot's rows have only the loop's nominal time."""
LABEL_NAME = "label.success"
"""1 after the operator pressed the success key or the twin's task is done; 0 before."""
SCALAR_NAMES = (*STATE_NAMES, *EFFORT_NAMES, *SENT_NAMES, OUTCOME_NAME, STAMP_NAME, LABEL_NAME)
UNLABELLED = -1
"""Phase and trial of human demonstrations."""
FRONT_CAMERA = "front"
"""Key of the camera whose depth becomes the point cloud."""
DEPTH_SUFFIX = "_depth"
"""Suffix of a camera's depth image: uint16 [mm], 0 for invalid pixels."""

INTERVENTION = "intervention"
"""Column of recorded rollouts: whether a person or an expert had taken over."""
KEY_FRAME_COLUMNS = frozenset((POINT_CLOUD, OUTCOME))
"""Columns that datasets of key frames have and recordings of ticks do not."""

CALIBRATIONS = "meta/calibrations.json"
"""Calibration file of a recording."""
SAFETY = "meta/safety.json"
"""`SafetyLimits` of a recording."""


def names_of(feature: Mapping[str, Any] | None) -> list[str]:
    """Returns the names of a column's numbers in order. LeRobot stores them as a list or in groups."""
    names = (feature or {}).get("names")
    return [name for group in names.values() for name in group] if isinstance(names, Mapping) else list(names or ())


def is_dense(features: Mapping[str, Any]) -> bool:
    """Returns whether the features are those of a dense recording of our robots, not of key frames.

    `lerobot-record` keeps all scalars; `lerobot-rollout` keeps the 24 that a policy reads.
    """
    names = names_of(features.get(STATE))
    ours = set(SCALAR_NAMES) <= set(names) or names == list(STATE_NAMES)
    ours = ours and set(POSE_NAMES) <= set(names_of(features.get(ACTION)))
    return ours and not KEY_FRAME_COLUMNS & set(features)
