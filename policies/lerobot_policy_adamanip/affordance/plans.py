"""Contacts and key frames: grasps as numbers relative to a place in the cloud, plans, and what is left of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import torch
from torch import Tensor

from lerobot_adamanip.contract.keyframes import EMPTY_HAND, OPEN_HAND, PRE_GRASP
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.common.tool_frame import pose_after
from lerobot_policy_adamanip.common.torch_rotations import orthonormal_6d

GRASP_DIM = 10
GRASP_GROUPS = (6, 3, 1)
"""Of its numbers: rotation 6D, offset, opening to approach with."""
OFFSET_UNIT = 0.05
"""A tool's place is given relative to a place in the cloud in this unit [m]: it is inside a handle, the place on it."""
ON_PART = 0.03
"""Points within this distance of a grasp are where to take hold; those beyond are not [m]."""


def encode_grasp(grasp: Tensor, place: Tensor) -> Tensor:
    """Returns grasps (..., 10) relative to places (..., 3) [m]: rotation 6D, offset, opening to approach with (10)."""
    offset = (grasp[..., POSITION_DIMS] - place) / OFFSET_UNIT
    return torch.cat([grasp[..., ROTATION_DIMS], offset, grasp[..., GRIPPER_DIM:]], dim=-1)


def decode_grasp(code: Tensor, place: Tensor) -> Tensor:
    """The inverse of `encode_grasp`: any ten numbers become a pose (..., 10), its opening 0 or 1."""
    position = place + OFFSET_UNIT * code[..., 6:9]
    return torch.cat([position, orthonormal_6d(code[..., :6]), code[..., 9:10].round().clamp(0, 1)], dim=-1)


def with_gripper(pose: Tensor, opening: float) -> Tensor:
    """Returns poses (..., 10) with another opening, 0 closed ... 1 open."""
    return torch.cat([pose[..., :GRIPPER_DIM], torch.full_like(pose[..., GRIPPER_DIM:], opening)], dim=-1)


def backed_off(pose: Tensor) -> Tensor:
    """Returns poses (..., 10) a pre-grasp's distance back along their approach, the tool's z axis."""
    back = pose.new_zeros(*pose.shape[:-1], 7)
    back[..., 2], back[..., 6] = -PRE_GRASP, pose[..., GRIPPER_DIM]
    return pose_after(back, pose)


def approach(grasp: Tensor) -> Tensor:
    """Returns the key frames (..., 3, 10) that take hold at grasps (..., 10): pre-grasp, grasp, fingers closed.

    A grasp that is approached with a closed hand is a push: its third key frame changes nothing.
    """
    return torch.stack([backed_off(grasp), grasp, with_gripper(grasp, 0.0)], dim=-2)


def let_go(pose: Tensor) -> Tensor:
    """Returns the key frames (..., 2, 10) that leave a part: fingers opened in place, and back along the approach."""
    opened = with_gripper(pose, 1.0)
    return torch.stack([opened, backed_off(opened)], dim=-2)


def holds_something(pose: Tensor) -> bool:
    """Returns whether something is between the fingers of a tool (10,), by the opening that it feels."""
    return EMPTY_HAND <= float(pose[GRIPPER_DIM]) <= OPEN_HAND


def taking_hold(pose: Tensor, grasp: Tensor, pushed_to: Tensor) -> Tensor:
    """Returns the key frames (T, 10) from where a tool is to a contact: a part grasped, or pushed.

    Args:
        pose: (10,) of the tool, its gripper the opening felt: a hand that is not open lets go first.
        grasp: (10,) pose of contact, its gripper the opening to approach with.
        pushed_to: (10,) where a part is pushed that is approached with a closed hand: nothing holds it there, so the
            contact is a motion at once.
    """
    way = approach(grasp)
    if float(grasp[GRIPPER_DIM]) < OPEN_HAND:
        way = torch.cat([way[:2], pushed_to[None]])
    return way if float(pose[GRIPPER_DIM]) > OPEN_HAND else torch.cat([let_go(pose), way])


def stacked(plans: Sequence[Tensor]) -> Tensor:
    """Returns plans (T, 10) of any lengths as one tensor (B, T, 10), the last key frame of shorter ones repeated."""
    longest = max(len(plan) for plan in plans)
    return torch.stack([torch.cat([plan, plan[-1:].expand(longest - len(plan), -1)]) for plan in plans])


class PlanQueue:
    """What is left of the plans of a batch of episodes, one each; they need not be equally long."""

    def __init__(self) -> None:
        self._rows: list[deque[Tensor]] = []

    def clear(self) -> None:
        """Forgets all plans."""
        self._rows = []

    def finished(self, batch_size: int) -> list[int]:
        """Returns the episodes, of so many, for which nothing is left."""
        self._rows += [deque() for _ in range(batch_size - len(self._rows))]
        return [row for row, left in enumerate(self._rows) if not left]

    def append(self, row: int, key_frames: Tensor) -> None:
        """Adds key frames (T, 10) to an episode's plan."""
        self._rows[row].extend(key_frames.unbind(0))

    def pop(self) -> Tensor:
        """Returns the next key frame of each episode (B, 10)."""
        return torch.stack([left.popleft() for left in self._rows])
