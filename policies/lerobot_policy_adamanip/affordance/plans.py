"""Grasps relative to a place in the cloud, and plans: sequences of key frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import torch
from torch import Tensor

from lerobot_adamanip.contract.keyframes import EMPTY_HAND, OPEN_HAND, PRE_GRASP
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.common.geometry import backed_off, orthonormal_6d, with_gripper

GRASP_DIM = 10
GRASP_GROUPS = (6, 3, 1)
"""Sizes of rotation 6D, offset, and gripper opening of the approach."""
OFFSET_UNIT = 0.05
"""Unit of a grasp's offset from a place in the cloud [m]: the tool is inside a handle, the place on it."""
PART_RADIUS_M = 0.03
"""Points within this distance of a grasp are on the part."""


def encode_grasp(grasp: Tensor, place: Tensor) -> Tensor:
    """Returns grasps (..., 10) relative to places (..., 3) [m]: rotation 6D, offset, gripper opening (10)."""
    offset = (grasp[..., POSITION_DIMS] - place) / OFFSET_UNIT
    return torch.cat([grasp[..., ROTATION_DIMS], offset, grasp[..., GRIPPER_DIM:]], dim=-1)


def decode_grasp(code: Tensor, place: Tensor) -> Tensor:
    """Inverts `encode_grasp`: any ten numbers become a pose (..., 10) with opening 0 or 1."""
    position = place + OFFSET_UNIT * code[..., 6:9]
    return torch.cat([position, orthonormal_6d(code[..., :6]), code[..., 9:10].round().clamp(0, 1)], dim=-1)


def approach(grasp: Tensor) -> Tensor:
    """Returns the key frames (..., 3, 10) of grasps (..., 10): pre-grasp, grasp, fingers closed."""
    return torch.stack([backed_off(grasp, PRE_GRASP), grasp, with_gripper(grasp, 0.0)], dim=-2)


def let_go(pose: Tensor) -> Tensor:
    """Returns the key frames (..., 2, 10) that release a part: open in place, then back along the approach."""
    opened = with_gripper(pose, 1.0)
    return torch.stack([opened, backed_off(opened, PRE_GRASP)], dim=-2)


def holds_something(pose: Tensor) -> bool:
    """Returns whether something is between the fingers of a tool (10,), by its measured opening."""
    return EMPTY_HAND <= float(pose[GRIPPER_DIM]) <= OPEN_HAND


def taking_hold(pose: Tensor, grasp: Tensor, pushed_to: Tensor) -> Tensor:
    """Returns the key frames (T, 10) from a tool's pose to a grasp or a push.

    Args:
        pose: (10,) of the tool with the measured opening; a hand that is not open releases first.
        grasp: (10,) pose of contact; its gripper is the opening during the approach.
        pushed_to: (10,) goal of a push, for an approach with a closed hand.
    """
    plan = approach(grasp)
    if float(grasp[GRIPPER_DIM]) < OPEN_HAND:
        plan = torch.cat([plan[:2], pushed_to[None]])
    return plan if float(pose[GRIPPER_DIM]) > OPEN_HAND else torch.cat([let_go(pose), plan])


def stacked(plans: Sequence[Tensor]) -> Tensor:
    """Stacks plans (T, 10) as (B, T, 10); shorter ones repeat their last key frame."""
    longest = max(len(plan) for plan in plans)
    return torch.stack([torch.cat([plan, plan[-1:].expand(longest - len(plan), -1)]) for plan in plans])


class PlanQueue:
    """Remaining key frames of a batch of episodes, one plan of any length each."""

    def __init__(self) -> None:
        self._rows: list[deque[Tensor]] = []

    def clear(self) -> None:
        """Drops all plans."""
        self._rows = []

    def finished(self, batch_size: int) -> list[int]:
        """Returns the episodes of a batch whose plans are empty."""
        self._rows += [deque() for _ in range(batch_size - len(self._rows))]
        return [row for row, left in enumerate(self._rows) if not left]

    def append(self, row: int, key_frames: Tensor) -> None:
        """Adds key frames (T, 10) to an episode's plan."""
        self._rows[row].extend(key_frames.unbind(0))

    def pop(self) -> Tensor:
        """Returns the next key frame of each episode (B, 10)."""
        return torch.stack([left.popleft() for left in self._rows])
