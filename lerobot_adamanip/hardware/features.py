"""Names of the robot's features, and of the files of a dense recording.

LeRobot's recorder puts all scalars into one ``observation.state``, in this order. Roll-outs keep only those that end in
``.pos`` or ``.vel``, the contract's state: nothing else may end so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.contract.schema import ACTION, EFFORT_NAMES, OUTCOME, POINT_CLOUD, POSE_NAMES, STATE, STATE_NAMES

SENT_NAMES = tuple(f"sent.{name.removesuffix('.pos')}" for name in POSE_NAMES)
"""The last accepted target: LeRobot stores the teleoperator's action, which may have been clipped."""
OUTCOME_NAME = "arm.outcome"
"""`keyframes.Outcome` of the latest key frame; -1 for none, and while the arm is streamed to."""
STAMP_NAME = "arm.stamp"
"""When the state was measured [s since the robot connected]: rows of LeRobot carry the loop's nominal time only."""
LABEL_NAME = "label.success"
"""1 once the operator has pressed the key for success, or the twin's task is done; 0 before."""
SCALAR_NAMES = (*STATE_NAMES, *EFFORT_NAMES, *SENT_NAMES, OUTCOME_NAME, STAMP_NAME, LABEL_NAME)
UNLABELLED = -1
"""Phase and trial of demonstrations by people."""
FRONT_CAMERA = "front"
"""Key of the camera whose depth becomes the cloud."""
DEPTH_SUFFIX = "_depth"
"""A camera's depth is a second image under its key and this: uint16, millimetres, 0 where nothing was seen."""

CALIBRATIONS = "meta/calibrations.json"
"""Calibration file of a recording."""
SAFETY = "meta/safety.json"
"""`SafetyLimits` of a recording."""


def names_of(feature: Mapping[str, Any] | None) -> list[str]:
    """Returns the names of a column's numbers, in order; LeRobot keeps them as a list, or in groups."""
    names = (feature or {}).get("names")
    return [name for group in names.values() for name in group] if isinstance(names, Mapping) else list(names or ())


def is_dense(features: Mapping[str, Any]) -> bool:
    """Whether a dataset's features are those of a dense recording of our robots, and not of key frames.

    `lerobot-record` keeps all scalars; `lerobot-rollout` keeps those that a policy is shown, the contract's 24.
    """
    names = names_of(features.get(STATE))
    ours = set(SCALAR_NAMES) <= set(names) or names == list(STATE_NAMES)
    ours = ours and set(POSE_NAMES) <= set(names_of(features.get(ACTION)))
    return ours and not {POINT_CLOUD, OUTCOME} & set(features)
