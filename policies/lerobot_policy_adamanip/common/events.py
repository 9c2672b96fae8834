"""Features of past key frames: each command, and how far the arm followed it."""

from __future__ import annotations

import torch
from torch import Tensor

from lerobot_policy_adamanip.common.tool_frame import MOTION_DIM, MOTION_UNITS, constant, motion_between

UNDONE_UNITS = (0.01, 0.01, 0.01, 0.2, 0.2, 0.2, 1.0)
"""Units of the undone part of a motion [m, m, m, rad, rad, rad, -]: typical of a stopped arm."""
EVENT_RANGE = 3.0
EVENT_DIM = 2 * MOTION_DIM + 2


def events(commands: Tensor, poses: Tensor, valid: Tensor, *, feedback: bool = True) -> Tensor:
    """Returns one row per past key frame, in the frame of the tool at that time.

    Args:
        commands: (B, H, 10) commanded poses, oldest first.
        poses: (B, H + 1, 10) tool poses before each command, then the present one.
        valid: (B, H) bool; rows before the episode's start are invalid and become zero.
        feedback: if false, the numbers that describe the arm's result are zero.

    Returns:
        (B, H, 16): commanded motion, undone motion (each in its units), reached gripper opening, validity.
    """
    commanded, undone = motion_between(commands, torch.stack([poses[:, :-1], poses[:, 1:]])).unbind()
    undone = torch.cat([undone[..., :6], undone[..., 6:] - poses[:, 1:, 9:10]], dim=-1)
    outcome = torch.cat([undone / constant(UNDONE_UNITS, undone), poses[:, 1:, 9:10]], dim=-1)
    rows = torch.cat(
        [
            commanded / constant(MOTION_UNITS, commanded),
            outcome if feedback else torch.zeros_like(outcome),
            torch.ones_like(commanded[..., :1]),
        ],
        dim=-1,
    )
    return rows.clamp(-EVENT_RANGE, EVENT_RANGE).masked_fill(~valid[..., None], 0.0)
