"""Strokes: dense steps, merged into stretches that the memory of contact events reads like key frames.

A stroke goes on while the closed hand pushes in one direction, or while it does not push. It ends when the commanded
gripper opens or closes. A hand pushes in a step as in a contact event, see `Past.contact`: it is closed, and its
command is ahead of the measured pose. In contact, this lag is the strain. Neither labels nor effort are used.

Whether a step starts a stroke depends on this step, its result and the step before, so strokes are the same in training
and at run time.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_adamanip.episode.felt_tries import SAME_DIRECTION
from lerobot_policy_adamanip.common.contacts import Past
from lerobot_policy_adamanip.common.geometry import MOTION_UNITS, constant


def starts_stroke(commands: Tensor, poses: Tensor) -> Tensor:
    """Returns which steps (B, T) of episodes start a stroke.

    Args:
        commands: (B, T, 10) commanded poses, from the episode's first step on.
        poses: (B, T + 1, 10) measured tool poses before each command, and the present one.
    """
    valid = torch.ones(commands.shape[:2], dtype=torch.bool, device=commands.device)
    steps = Past(commands, poses, valid, is_dense=True)
    motion = steps.motions[0][..., :6] / constant(MOTION_UNITS, commands)[:6]
    is_same = F.cosine_similarity(motion[:, 1:], motion[:, :-1], dim=-1) > SAME_DIRECTION
    pushes, opens = steps.contact, steps.opens
    changes = (pushes[:, 1:] != pushes[:, :-1]) | (opens[:, 1:] != opens[:, :-1]) | (pushes[:, 1:] & ~is_same)
    return F.pad(changes, (1, 0), value=True)


def stroke_bounds(numbers: Tensor, latest: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Returns numbers, first and last steps, each (B, count), of the ``latest`` strokes (B,) and those before them.

    ``numbers`` (T,) or (B, T), which do not fall, are the strokes' numbers of steps.
    """
    wanted = latest[:, None] - torch.arange(count - 1, -1, -1, device=latest.device)
    numbers = numbers.contiguous()
    first = torch.searchsorted(numbers, wanted)
    return wanted, first, torch.searchsorted(numbers, wanted, right=True) - 1


def merged(commands: Tensor, states: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Merges the steps of an episode, T of them or none, into the latest ``count`` strokes.

    Args:
        commands: (B, T, 10) poses that were sent.
        states: (B, T + 1, D) states before each, and the present one; they begin with poses.
        count: number of strokes.

    Returns:
        Last commands (B, count, 10), states before the strokes and the present one (B, count + 1, D), and validity
        (B, count), false where there were fewer.
    """
    pose = commands.shape[-1]
    if commands.shape[1] == 0:
        none = torch.zeros(len(commands), count, dtype=torch.bool, device=commands.device)
        return commands.new_zeros(len(commands), count, pose), states.expand(-1, count + 1, -1), none
    numbers = starts_stroke(commands, states[..., :pose]).cumsum(dim=1) - 1
    number, first, last = stroke_bounds(numbers, numbers[:, -1], count)
    valid = number >= 0
    ends = commands.gather(1, last.clamp(min=0)[..., None].expand(-1, -1, pose))
    starts = states.gather(1, first[..., None].expand(-1, -1, states.shape[-1]))
    return ends * valid[..., None], torch.cat([starts, states[:, -1:]], dim=1), valid
