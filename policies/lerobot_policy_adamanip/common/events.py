"""What was tried and what came of it, as numbers: each command together with what the arm did of it."""

from __future__ import annotations

import torch
from torch import Tensor

from lerobot_policy_adamanip.common.tool_frame import MOTION_DIM, MOTION_UNITS, constant, motion_between

UNDONE_UNITS = (0.01, 0.01, 0.01, 0.2, 0.2, 0.2, 1.0)
"""What counts as one in what is left of a motion [m, m, m, rad, rad, rad, -]: so far off is an arm that is stopped."""
EVENT_RANGE = 3.0
EVENT_DIM = 2 * MOTION_DIM + 2


def events(commands: Tensor, poses: Tensor, valid: Tensor, *, feedback: bool = True) -> Tensor:
    """Returns what happened, one row per past key frame, seen from the tool as it stood then.

    Args:
        commands: (B, H, 10) poses commanded, oldest first.
        poses: (B, H + 1, 10) tool poses before each command, and the present one.
        valid: (B, H) bool; what is not valid (before the start) leaves no trace.
        feedback: whether what came of commands is told; else the numbers of it are zero.

    Returns:
        (B, H, 16): motion commanded, motion left undone (both in units of their own), gripper reached, validity.
    """
    commanded, undone = motion_between(commands, torch.stack([poses[:, :-1], poses[:, 1:]])).unbind()
    undone = torch.cat([undone[..., :6], undone[..., 6:] - poses[:, 1:, 9:10]], dim=-1)
    came_of_it = torch.cat([undone / constant(UNDONE_UNITS, undone), poses[:, 1:, 9:10]], dim=-1)
    told = torch.cat(
        [
            commanded / constant(MOTION_UNITS, commanded),
            came_of_it if feedback else torch.zeros_like(came_of_it),
            torch.ones_like(commanded[..., :1]),
        ],
        dim=-1,
    )
    return told.clamp(-EVENT_RANGE, EVENT_RANGE).masked_fill(~valid[..., None], 0.0)
