"""Conversion of tool poses to and from the actions and states of dense control, see `contract.control`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.contract.control import DELTA_POSITION, DELTA_ROTATION, FINGER_TRAVEL
from lerobot_adamanip.contract.rotations import (
    matrix_from_rotation_vector,
    pose_vector,
    quaternion_from_matrix,
    rotation_vector_from_matrix,
)

Array = NDArray[np.float64]

REFERENCE = np.array([-0.555, 0.708, 0.285, 0.332])
"""Quaternion (w, x, y, z) amid the tool's rotations: those of the experts in the nine categories stay within
140 degrees of it. The usual rotation vectors jump in the middle of them, where a tool points straight down."""


def continuous_rotation_vector(rotation: Array) -> Array:
    """Returns the rotation vector (3,) of a rotation matrix (3, 3) that is continuous around `REFERENCE`.

    Its length may exceed pi; the usual one has at most pi.
    """
    quaternion = quaternion_from_matrix(rotation)
    quaternion = quaternion if quaternion @ REFERENCE >= 0 else -quaternion
    size = float(np.linalg.norm(quaternion[1:]))
    angle = 2.0 * np.arctan2(size, quaternion[0])
    return np.asarray(quaternion[1:] * (angle / size if size > 1e-9 else 2.0), np.float64)


def pose_state(tcp_in_base: Array, gripper: float) -> NDArray[np.float32]:
    """Returns the state ``pose`` (8,) of a measured tool pose (4, 4) and gripper opening."""
    fingers = np.full(2, gripper * FINGER_TRAVEL)
    return np.array([*tcp_in_base[:3, 3], *continuous_rotation_vector(tcp_in_base[:3, :3]), *fingers], np.float32)


def delta_action(target: Array, gripper: float, tcp_in_base: Array) -> NDArray[np.float32]:
    """Returns the action ``ee_delta`` (7,) from a measured tool pose to a target (4, 4); clipped to the limits.

    A motion beyond the limits keeps its direction: translation and rotation are shortened by the same share.
    """
    shift = (target[:3, 3] - tcp_in_base[:3, 3]) / DELTA_POSITION
    turn = rotation_vector_from_matrix(target[:3, :3] @ tcp_in_base[:3, :3].T) / DELTA_ROTATION
    motion = np.concatenate([shift, turn])
    motion /= max(1.0, float(np.abs(motion).max()))
    return np.array([*motion, 2.0 * gripper - 1.0], np.float32)


def pose_of_delta(action: ArrayLike, tcp_in_base: Array) -> NDArray[np.float32]:
    """Returns the pose action (10,) of an ``ee_delta`` action (7,) at a measured tool pose (4, 4)."""
    values = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
    target = tcp_in_base.copy()
    target[:3, 3] += DELTA_POSITION * values[:3]
    target[:3, :3] = matrix_from_rotation_vector(DELTA_ROTATION * values[3:6]) @ tcp_in_base[:3, :3]
    return pose_vector(target, 0.5 * (float(values[6]) + 1.0))
