"""Converts the arm's readings and targets to and from the states and actions of policies, see `contract.control`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, EE_POSE, FULL, STATES
from lerobot_adamanip.contract.dense_codec import delta_action, pose_of_delta, pose_state
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector
from lerobot_adamanip.contract.schema import ACTION_DIM, POSE_NAMES
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.util.errors import ConfigurationError

ARM_ACTIONS = (EE_DELTA, EE_POSE)
"""Kinds of action that an arm executes. Its safety filter limits tool poses, so joint positions are refused."""


def state_of(kind: str, reading: ArmReading) -> NDArray[np.float32]:
    """Returns the state of a kind, (8,) or (24,), see `STATES`."""
    if kind != FULL:
        return pose_state(reading.tcp_in_base, reading.gripper)
    pose = pose_vector(reading.tcp_in_base, reading.gripper)
    return np.concatenate([pose, reading.qpos, reading.qvel]).astype(np.float32)


def encode_action(kind: str, target: Target, reading: ArmReading) -> dict[str, float]:
    """Returns the action by name that leads from a reading to a target (10,). Inverse of `decode_action`."""
    values = delta_action(*pose_from_vector(target), reading.tcp_in_base) if kind == EE_DELTA else target
    return dict(zip(ACTION_NAMES[kind], values.tolist(), strict=True))


def decode_action(action: Mapping[str, Any], reading: ArmReading, kind: str = EE_POSE) -> Target:
    """Returns the target (10,) of an action by name.

    The names tell the kind, so a replay needs no option, and a pose is accepted beside every kind. A delta that is not
    finite gives a target of NaN, which the safety filter refuses.

    Args:
        action: name -> number.
        reading: the reading that the action was computed from.
        kind: expected kind, for the error.

    Raises:
        ConfigurationError: the action has all names of no kind.
    """
    complete = [own for own in ARM_ACTIONS if set(ACTION_NAMES[own]) <= set(action)]
    if not complete:
        missing = [name for name in ACTION_NAMES[kind] if name not in action]
        allowed = ", ".join(ACTION_NAMES[kind])
        raise ConfigurationError("An action lacks names.", got=f"no {', '.join(missing)}", allowed=allowed)
    with np.errstate(over="ignore"):
        values = np.array([float(action[name]) for name in ACTION_NAMES[complete[0]]], np.float32)
    if complete[0] != EE_DELTA:
        return values
    if not np.isfinite(values).all():
        return np.full(ACTION_DIM, np.nan, np.float32)  # clipping would make a full step of infinity
    return pose_of_delta(values, reading.tcp_in_base)


def named_state(kind: str, reading: ArmReading) -> dict[str, float]:
    """Returns the state of a kind by name, and the tool pose: LeRobot moves the arm back to its first pose with it."""
    pose = dict(zip(POSE_NAMES, pose_vector(reading.tcp_in_base, reading.gripper).tolist(), strict=True))
    return {**dict(zip(STATES[kind], state_of(kind, reading).tolist(), strict=True)), **pose}
