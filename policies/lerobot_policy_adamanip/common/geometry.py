"""Rotations, and poses and points in the tool's frame, batched and differentiable.

In the tool's frame a motion does not depend on the object's pose. A pose of the contract is position [m], rotation 6D
(a matrix' first two rows) and gripper (10). A *motion* is a pose in another tool's frame: position [m], rotation vector
[rad], gripper (7).
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_adamanip.contract import memory
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS

MOTION_DIM = 7
MOTION_UNITS = (*memory.MOTION_UNITS, 1.0)
"""Units of a motion [m, m, m, rad, rad, rad, -]: a typical motion in contact."""
SMALL = 1e-6
"""Sine below which sine and angle are equal."""


# Rotations ----------------------------------------------------------------------------------------------------------


def orthonormal_6d(rotation_6d: Tensor) -> Tensor:
    """Returns a rotation's first two rows by Gram-Schmidt. (..., 6) -> (..., 6).

    Zero or parallel rows are replaced by unit axes, as in `contract.rotations`.
    """
    first, second = rotation_6d[..., :3], rotation_6d[..., 3:]
    axes = torch.eye(3, dtype=rotation_6d.dtype, device=rotation_6d.device)
    first = _unit(first, axes[0].expand_as(first))
    helper = torch.where(first[..., :1].abs() < 0.9, axes[0], axes[1])
    spare = _unit(torch.linalg.cross(first, helper), axes[1].expand_as(first))
    second = _unit(second - (first * second).sum(-1, keepdim=True) * first, spare)
    return torch.cat([first, second], dim=-1)


def _unit(vector: Tensor, fallback: Tensor) -> Tensor:
    norm = vector.norm(dim=-1, keepdim=True)
    return torch.where(norm > 1e-6, vector / norm.clamp(min=1e-6), fallback)


def matrix_from_6d(rotation_6d: Tensor) -> Tensor:
    """Converts rotation 6D (..., 6) to rotation matrices (..., 3, 3)."""
    rows = orthonormal_6d(rotation_6d)
    first, second = rows[..., :3], rows[..., 3:]
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-2)


def angle_between(first_6d: Tensor, second_6d: Tensor) -> Tensor:
    """Returns the angle [rad] between two rotations 6D. (..., 6), (..., 6) -> (...); its gradient is finite."""
    first, second = matrix_from_6d(first_6d), matrix_from_6d(second_6d)
    cosine = ((first * second).sum(dim=(-2, -1)) - 1) / 2
    return cosine.clamp(-1 + SMALL, 1 - SMALL).acos()


def rotation_vector(matrix: Tensor) -> Tensor:
    """Converts rotation matrices (..., 3, 3) to axis times angle (..., 3) [rad], with an angle of at most pi.

    Uses the quaternion, from its largest component, which is accurate near pi too.
    """
    m = matrix
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    diagonal = torch.stack([trace, m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], dim=-1)
    # Four times the products of the quaternion's (w, x, y, z) with each of its components.
    square = 1 - trace[..., None] + 2 * diagonal
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 2, 0] + m[..., 0, 2], m[..., 2, 1] + m[..., 1, 2]
    rows = (
        *(1 + trace, wx, wy, wz),
        *(wx, square[..., 1], xy, xz),
        *(wy, xy, square[..., 2], yz),
        *(wz, xz, yz, square[..., 3]),
    )
    products = torch.stack(rows, dim=-1).reshape(*trace.shape, 4, 4)
    largest = diagonal.argmax(dim=-1)[..., None, None].expand(*diagonal.shape[:-1], 1, 4)
    quaternion = products.gather(-2, largest).squeeze(-2)
    quaternion = quaternion / quaternion.norm(dim=-1, keepdim=True)
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = quaternion[..., 1:].norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, quaternion[..., :1])
    return quaternion[..., 1:] * torch.where(sine > SMALL, angle / sine.clamp(min=SMALL), 2.0)


def matrix_from_rotation_vector(vector: Tensor) -> Tensor:
    """Converts axis times angle (..., 3) [rad] to rotation matrices (..., 3, 3)."""
    x, y, z = vector.unbind(dim=-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).reshape(*x.shape, 3, 3)
    # Rodrigues' formula: sin(a) / a and (1 - cos(a)) / a^2 by sinc, which is defined at zero.
    turns = vector.norm(dim=-1)[..., None, None] / torch.pi
    same = torch.eye(3, dtype=vector.dtype, device=vector.device)
    return same + torch.sinc(turns) * cross + 0.5 * torch.sinc(turns / 2).square() * (cross @ cross)


# Poses and points in the tool's frame -------------------------------------------------------------------------------


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


def with_gripper(pose: Tensor, opening: float) -> Tensor:
    """Returns poses (..., 10) with the given opening, 0 closed ... 1 open."""
    return torch.cat([pose[..., :GRIPPER_DIM], torch.full_like(pose[..., GRIPPER_DIM:], opening)], dim=-1)


def backed_off(pose: Tensor, distance: float) -> Tensor:
    """Returns poses (..., 10) moved back along their approach, the tool's z axis, by a distance [m]."""
    back = pose.new_zeros(*pose.shape[:-1], 7)
    back[..., 2], back[..., 6] = -distance, pose[..., GRIPPER_DIM]
    return pose_after(back, pose)


def valid_pose(pose: Tensor) -> Tensor:
    """Returns poses (..., 10) from any ten numbers: an orthonormal rotation, a gripper in [0, 1]."""
    rotation, gripper = orthonormal_6d(pose[..., ROTATION_DIMS]), pose[..., GRIPPER_DIM:].clamp(0, 1)
    return torch.cat([pose[..., POSITION_DIMS], rotation, gripper], dim=-1)


def mirrored_poses(poses: Tensor) -> Tensor:
    """Mirrors poses (..., 10) at the base's vertical plane y = 0; the fingers, along the hand's y, change places."""
    return poses * constant((1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0), poses)


def mirrored_motions(motions: Tensor) -> Tensor:
    """Returns the motions (..., 7) between mirrored poses."""
    return motions * constant((1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0), motions)


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


# Grasps: approaches with two fingers ----------------------------------------------------------------------------------


@_in_float32
def grasp_correction(goal: Tensor, proposed: Tensor) -> Tensor:
    """Returns corrections from proposed poses to goals (B, 10): translation, tilt of the approach, turn about it.

    A grasp with swapped fingers is equivalent. So the turn is encoded as cosine and sine of its doubled angle, equal
    for both grasps and continuous. A plain angle would be learnt as the mean of a quarter turn to either side.
    """
    motion = motion_between(goal, proposed)
    turned = matrix_from_rotation_vector(motion[:, 3:6])
    approach = turned[:, :, 2]
    across = approach[:, :2].norm(dim=-1, keepdim=True)
    angle = torch.atan2(across, approach[:, 2:])
    tilt = approach[:, [1, 0]] * constant((-1.0, 1.0), goal) * angle / across.clamp(min=SMALL)
    left = matrix_from_rotation_vector(F.pad(tilt, (0, 1))).transpose(1, 2) @ turned
    twice = 2 * torch.atan2(left[:, 1, :1], left[:, 0, :1])
    return torch.cat([motion[:, :3], tilt, twice.cos(), twice.sin()], dim=-1)


def corrected_grasp(pose: Tensor, correction: Tensor) -> Tensor:
    """Inverts `grasp_correction`: poses (B, 10) and corrections (B, 7) -> poses (B, 10), turned the shorter way."""
    way, twice = correction[:, :5], correction[:, 5:]
    turn = torch.atan2(twice[:, 1:], twice[:, :1]) / 2
    gripper = pose[:, 9:10]
    tilted = pose_after(torch.cat([F.pad(way, (0, 1)), gripper], dim=-1), pose)
    return pose_after(torch.cat([F.pad(turn, (5, 0)), gripper], dim=-1), tilted)
