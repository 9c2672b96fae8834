"""Poses and points in the tool's frame, in which a motion does not depend on the object's pose.

A pose of the contract is position [m], rotation 6D and gripper (10). A *motion* is a pose in another tool's frame:
position [m], rotation vector [rad], gripper (7).
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch
from torch import Tensor

from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.common.torch_rotations import matrix_from_6d, matrix_from_rotation_vector, rotation_vector

MOTION_DIM = 7
MOTION_UNITS = (0.05, 0.05, 0.05, 0.5, 0.5, 0.5, 1.0)
"""Units of a motion [m, m, m, rad, rad, rad, -]: a typical motion in contact."""


@functools.cache
def _cached(values: tuple[float, ...], device: torch.device, dtype: torch.dtype) -> Tensor:
    # A normal tensor, even if first used in inference mode.
    with torch.inference_mode(mode=False):
        return torch.tensor(values, device=device, dtype=dtype)


def constant(values: tuple[float, ...], like: Tensor) -> Tensor:
    """Returns constants with a tensor's device and dtype. Cached, because a copy to a GPU would synchronise."""
    return _cached(values, like.device, like.dtype)


def _in_float32(function: Callable[[Tensor, Tensor], Tensor]) -> Callable[[Tensor, Tensor], Tensor]:
    """Disables autocast, since in half precision a position has an error of centimetres."""

    @functools.wraps(function)
    def wrapped(first: Tensor, second: Tensor) -> Tensor:
        with torch.autocast(first.device.type, enabled=False):
            return function(first.float(), second.float())

    return wrapped


@_in_float32
def motion_between(pose: Tensor, tool: Tensor) -> Tensor:
    """Returns the motions (..., 7) to poses (..., 10) in the frames of tool poses (..., 10), broadcast."""
    shift, turn = _seen_from(tool, pose)
    gripper = pose[..., GRIPPER_DIM : GRIPPER_DIM + 1].expand(*turn.shape[:-2], 1)
    return torch.cat([shift, rotation_vector(turn), gripper], dim=-1)


@_in_float32
def pose_after(motion: Tensor, tool: Tensor) -> Tensor:
    """Inverts `motion_between`: motions (..., 7) from tool poses (..., 10) -> poses (..., 10)."""
    turn = matrix_from_rotation_vector(motion[..., 3:6])
    return _seen_from_base(tool, motion[..., :3], turn, motion[..., 6:7])


@_in_float32
def relative_poses(pose: Tensor, tool: Tensor) -> Tensor:
    """Returns poses (..., 10) in the frames of tool poses (..., 10), broadcast; the gripper stays."""
    shift, turn = _seen_from(tool, pose)
    return torch.cat([shift, turn[..., :2, :].flatten(-2), pose[..., GRIPPER_DIM:]], dim=-1)


@_in_float32
def absolute_poses(relative: Tensor, tool: Tensor) -> Tensor:
    """Inverts `relative_poses`."""
    turn = matrix_from_6d(relative[..., ROTATION_DIMS])
    return _seen_from_base(tool, relative[..., POSITION_DIMS], turn, relative[..., GRIPPER_DIM:])


def _seen_from(tool: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
    """Returns positions (..., 3) and rotation matrices (..., 3, 3) of poses (..., 10) in the frames of tools."""
    frame = matrix_from_6d(tool[..., ROTATION_DIMS])
    shift = (pose[..., POSITION_DIMS] - tool[..., POSITION_DIMS])[..., None, :] @ frame
    return shift.squeeze(-2), frame.transpose(-1, -2) @ matrix_from_6d(pose[..., ROTATION_DIMS])


def _seen_from_base(tool: Tensor, shift: Tensor, turn: Tensor, gripper: Tensor) -> Tensor:
    """Returns poses (..., 10) from positions, rotation matrices and grippers seen from tools."""
    frame = matrix_from_6d(tool[..., ROTATION_DIMS])
    position = tool[..., POSITION_DIMS] + (frame @ shift[..., None]).squeeze(-1)
    return torch.cat([position, (frame @ turn)[..., :2, :].flatten(-2), gripper], dim=-1)


def reverse(motion: Tensor) -> Tensor:
    """Returns the reverse motions (..., 7), with the same gripper."""
    turn = matrix_from_rotation_vector(motion[..., 3:6])
    back = -(turn.transpose(-1, -2) @ motion[..., :3, None]).squeeze(-1)
    return torch.cat([back, -motion[..., 3:6], motion[..., 6:]], dim=-1)


def mirrored_poses(poses: Tensor) -> Tensor:
    """Mirrors poses (..., 10) at the base's vertical plane y = 0; the fingers, along the hand's y, change places."""
    return poses * constant((1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0), poses)


def mirrored_motions(motions: Tensor) -> Tensor:
    """Returns the motions (..., 7) between mirrored poses."""
    return motions * constant((1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0), motions)


def fingers_swapped(pose: Tensor) -> Tensor:
    """Returns poses (..., 10) rotated by pi about the approach: an equivalent grasp."""
    return pose * constant((1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0, 1.0), pose)


@_in_float32
def points_seen(cloud: Tensor, tool: Tensor) -> Tensor:
    """Transforms points (..., N, 3) [m, base frame] to the frame of tool poses (..., 10)."""
    frame = matrix_from_6d(tool[..., ROTATION_DIMS])
    return (cloud - tool[..., None, POSITION_DIMS]) @ frame


def point_features(points: Tensor, unit: float, scale: float) -> Tensor:
    """Returns features (..., 6) of points (..., 3) [m]: position / ``unit``, direction fading below ``scale`` [m]."""
    return torch.cat([points / unit, points / (points.norm(dim=-1, keepdim=True) + scale)], dim=-1)


def upwards(tool: Tensor) -> Tensor:
    """Returns the upward direction (..., 3) in the frame of tool poses (..., 10)."""
    return matrix_from_6d(tool[..., ROTATION_DIMS])[..., 2, :]
