"""Encoding of trajectories: a grasp at a place in the cloud, and key frames relative to the grasp."""

from __future__ import annotations

import torch
from torch import Tensor

from lerobot_adamanip.contract.schema import POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.affordance.plans import GRASP_DIM, approach, decode_grasp, encode_grasp
from lerobot_policy_adamanip.common.torch_rotations import matrix_from_6d

WAYPOINT_GROUPS = (3, 6)
"""Sizes of a key frame's position and rotation."""
WAYPOINT_DIM = sum(WAYPOINT_GROUPS)
WAYPOINT_UNIT = 0.15
"""Unit of positions relative to the grasp [m]."""


def trajectory_dim(waypoints: int) -> int:
    """Returns the size of a trajectory with this many key frames in contact."""
    return GRASP_DIM + WAYPOINT_DIM * waypoints


def encode_trajectory(grasp: Tensor, waypoints: Tensor, place: Tensor) -> Tensor:
    """Grasps (..., 10), poses in contact (..., K, 10), places (..., 3) [m] -> (..., 10 + 9 K).

    Each pose gives its position relative to the grasp along the base's axes, and its rotation 6D relative to the grasp
    (a factor on the right).
    """
    shift = (waypoints[..., POSITION_DIMS] - grasp[..., None, POSITION_DIMS]) / WAYPOINT_UNIT
    held = matrix_from_6d(grasp[..., ROTATION_DIMS])[..., None, :, :]
    turn = held.transpose(-1, -2) @ matrix_from_6d(waypoints[..., ROTATION_DIMS])
    relative = torch.cat([shift, turn[..., :2, :].flatten(-2)], dim=-1)
    return torch.cat([encode_grasp(grasp, place), relative.flatten(-2)], dim=-1)


def decode_trajectory(code: Tensor, place: Tensor) -> tuple[Tensor, Tensor]:
    """Inverts `encode_trajectory`: any numbers become poses, with closed fingers in contact."""
    grasp = decode_grasp(code[..., :GRASP_DIM], place)
    relative = code[..., GRASP_DIM:].reshape(*code.shape[:-1], -1, WAYPOINT_DIM)
    held = matrix_from_6d(grasp[..., ROTATION_DIMS])[..., None, :, :]
    position = grasp[..., None, POSITION_DIMS] + WAYPOINT_UNIT * relative[..., :3]
    rotation = held @ matrix_from_6d(relative[..., 3:])
    closed = torch.zeros_like(position[..., :1])
    return grasp, torch.cat([position, rotation[..., :2, :].flatten(-2), closed], dim=-1)


def key_frames(code: Tensor, place: Tensor) -> Tensor:
    """Returns the plan (..., 3 + K, 10) of a trajectory: pre-grasp, grasp, fingers closed, poses in contact."""
    grasp, waypoints = decode_trajectory(code, place)
    return torch.cat([approach(grasp), waypoints], dim=-2)
