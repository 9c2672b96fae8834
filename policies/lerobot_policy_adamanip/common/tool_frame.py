"""Poses and points as the tool sees them: a motion is the same numbers wherever the object stands.

A pose of the contract is position [m], rotation 6D and gripper (10); a *motion* is a pose seen from another one:
position in that tool's frame [m], rotation vector in it [rad], gripper (7).
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
"""What counts as one in each number of a motion [m, m, m, rad, rad, rad, -]: a typical motion in contact."""


@functools.cache
def _kept(values: tuple[float, ...], device: torch.device, dtype: torch.dtype) -> Tensor:
    # An ordinary tensor, though it be asked for first where nothing is ever differentiated.
    with torch.inference_mode(mode=False):
        return torch.tensor(values, device=device, dtype=dtype)


def constant(values: tuple[float, ...], like: Tensor) -> Tensor:
    """Returns constants where a tensor is, in its dtype: made once, since a copy to a GPU waits for it."""
    return _kept(values, like.device, like.dtype)


def _whole(function: Callable[[Tensor, Tensor], Tensor]) -> Callable[[Tensor, Tensor], Tensor]:
    """Without autocast: in half precision a position is known to centimetres."""

    @functools.wraps(function)
    def in_float32(first: Tensor, second: Tensor) -> Tensor:
        with torch.autocast(first.device.type, enabled=False):
            return function(first.float(), second.float())

    return in_float32


@_whole
def motion_between(pose: Tensor, tool: Tensor) -> Tensor:
    """Poses (..., 10) as seen from tool poses (..., 10), broadcast -> motions (..., 7)."""
    frame = matrix_from_6d(tool[..., ROTATION_DIMS])
    moved = (pose[..., POSITION_DIMS] - tool[..., POSITION_DIMS])[..., None, :] @ frame
    turned = frame.transpose(-1, -2) @ matrix_from_6d(pose[..., ROTATION_DIMS])
    gripper = pose[..., GRIPPER_DIM : GRIPPER_DIM + 1].expand(*turned.shape[:-2], 1)
    return torch.cat([moved.squeeze(-2), rotation_vector(turned), gripper], dim=-1)


@_whole
def pose_after(motion: Tensor, tool: Tensor) -> Tensor:
    """The inverse of `motion_between`: motions (..., 7) from tool poses (..., 10) -> poses (..., 10)."""
    frame = matrix_from_6d(tool[..., ROTATION_DIMS])
    position = tool[..., POSITION_DIMS] + (frame @ motion[..., :3, None]).squeeze(-1)
    rotation = frame @ matrix_from_rotation_vector(motion[..., 3:6])
    return torch.cat([position, rotation[..., :2, :].flatten(-2), motion[..., 6:7]], dim=-1)


def reverse(motion: Tensor) -> Tensor:
    """Returns the motions (..., 7) that lead back, with the same gripper."""
    turn = matrix_from_rotation_vector(motion[..., 3:6])
    back = -(turn.transpose(-1, -2) @ motion[..., :3, None]).squeeze(-1)
    return torch.cat([back, -motion[..., 3:6], motion[..., 6:]], dim=-1)


def mirrored_poses(poses: Tensor) -> Tensor:
    """Returns poses (..., 10) of the same arm behind a mirror, in the vertical plane y = 0 of the base.

    The hand is its own mirror image, left finger for right one: across its y axis, along which the fingers move.
    """
    return poses * constant((1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0), poses)


def mirrored_motions(motions: Tensor) -> Tensor:
    """Returns motions (..., 7) as `motion_between` sees them between mirrored poses."""
    return motions * constant((1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0), motions)


def fingers_swapped(pose: Tensor) -> Tensor:
    """Returns poses (..., 10) after half a turn about the approach: two fingers hold alike either way."""
    return pose * constant((1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0, 1.0), pose)


@_whole
def points_seen(cloud: Tensor, tool: Tensor) -> Tensor:
    """Points (..., N, 3) [m, base frame] in the frame of tool poses (..., 10) -> (..., N, 3) [m]."""
    frame = matrix_from_6d(tool[..., ROTATION_DIMS])
    return (cloud - tool[..., None, POSITION_DIMS]) @ frame


def point_features(points: Tensor, unit: float, sharp: float) -> Tensor:
    """Tells points (..., 3) [m] by where they are, in ``unit`` [m], and by direction, sharp within ``sharp`` [m]: 6."""
    return torch.cat([points / unit, points / (points.norm(dim=-1, keepdim=True) + sharp)], dim=-1)


def upwards(tool: Tensor) -> Tensor:
    """The vertical as tool poses (..., 10) see it -> (..., 3): what a tool's frame alone does not tell."""
    return matrix_from_6d(tool[..., ROTATION_DIMS])[..., 2, :]
