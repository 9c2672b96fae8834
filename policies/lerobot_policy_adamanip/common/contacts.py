"""Contact events: past key frames that sent a closed hand somewhere. The memory reads no others.

A memory of all key frames becomes a phase clock, which says what comes next instead of the cloud (causal confusion).
Approaches, grasps and releases therefore leave no trace in the memory. Rules beside it, which are not learnt: a failed
motion is not repeated until something has moved, and no step is undone before anything was tried.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.keyframes import EMPTY_HAND, OPEN_HAND
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_adamanip.episode.contact_labels import CLOSED, FAR_ENOUGH_ANGLE, FAR_ENOUGH_DISTANCE
from lerobot_policy_adamanip.common.events import EVENT_DIM
from lerobot_policy_adamanip.common.tool_frame import MOTION_UNITS, constant, motion_between, pose_after
from lerobot_policy_adamanip.common.torch_rotations import matrix_from_6d

SAME_PLACE_M, SAME_DIRECTION = 0.06, 0.5
"""Motions are the same if their tools start this near [m], and their directions have at least this cosine."""
SAME_GOAL_M, SAME_GOAL_RAD = 0.03, 0.5
"""Goals are the same if they are this near [m, rad]; demonstrated approaches are further apart."""


def contact_events(commands: Tensor, poses: Tensor, valid: Tensor) -> Tensor:
    """Returns which key frames are contact events (B, H): the hand is closed before and after, and sent far enough.

    A closed hand that is empty can only push, so only its motion forward counts.

    Args:
        commands: (B, H, 10) commanded poses, oldest first.
        poses: (B, H + 1, 10) measured tool poses before each command, and the present one.
        valid: (B, H) bool, false before the episode's start.
    """
    motion = motion_between(commands, poses[:, :-1])
    shift, turn = motion[..., :3].norm(dim=-1), motion[..., 3:6].norm(dim=-1)
    opening = poses[:, :-1, GRIPPER_DIM]
    holds = (opening >= EMPTY_HAND) & (opening <= OPEN_HAND)
    moves = holds & ((shift > FAR_ENOUGH_DISTANCE) | (turn > FAR_ENOUGH_ANGLE)) | (motion[..., 2] > FAR_ENOUGH_DISTANCE)
    closed = commands[..., GRIPPER_DIM] < CLOSED
    result: Tensor = valid & moves & closed & F.pad(closed[:, :-1], (1, 0))
    return result


class ContactMemory(nn.Module):
    """GRU over the contact events; other key frames leave its state unchanged."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.embedding = nn.Sequential(nn.Linear(EVENT_DIM, dim), nn.ReLU())
        # A cell: on a GPU `nn.GRU` keeps its weights in one storage, which safetensors refuses to save.
        self.cell = nn.GRUCell(dim, dim)

    def forward(self, happened: Tensor, contact: Tensor) -> Tensor:
        """`events` (B, H, 16), `contact_events` (B, H) -> (B, dim); zero without a contact event."""
        embedded = self.embedding(happened)
        state = torch.zeros_like(embedded[:, 0])
        for step in range(contact.shape[1]):
            state = torch.where(contact[:, step, None], self.cell(embedded[:, step], state), state)
        return state


def repeats_failure(
    commands: Tensor, poses: Tensor, valid: Tensor, contact: Tensor, motions: Tensor, *, failed_below: float
) -> tuple[Tensor, Tensor]:
    """Returns which motions (B, K, 7) from the present pose would repeat a failed contact event, twice (B, K) bool.

    An event failed if less than ``failed_below`` of its motion was done, or if the hand lost its grip. The first result
    is about failures since something has moved, the second about those of the present grip: since the hand was open,
    too. Motions are compared in the base frame, whichever way a part is held. ``contact`` comes from `contact_events`,
    whose arguments the others are.
    """
    tool, reached = poses[:, :-1], poses[:, 1:]
    sent, undone = (_scaled(motion_between(commands, start)) for start in (tool, reached))
    lost = (tool[..., GRIPPER_DIM] >= EMPTY_HAND) & (reached[..., GRIPPER_DIM] < EMPTY_HAND)
    failed = contact & (lost | (undone.norm(dim=-1) > (1 - failed_below) * sent.norm(dim=-1)))
    near = (tool[..., POSITION_DIMS] - poses[:, -1:, POSITION_DIMS]).norm(dim=-1) < SAME_PLACE_M
    past, ahead = _in_base(sent, tool), _in_base(_scaled(motions), poses[:, -1:])
    same = F.cosine_similarity(past[:, :, None], ahead[:, None], dim=-1) > SAME_DIRECTION
    since_moved = failed & near & ~_before(contact & ~failed)
    this_grip = since_moved & ~_before(valid & (commands[..., GRIPPER_DIM] >= CLOSED))
    closed = motions[..., -1] < CLOSED
    return (since_moved[..., None] & same).any(dim=1) & closed, (this_grip[..., None] & same).any(dim=1) & closed


def goes_back(commands: Tensor, poses: Tensor, valid: Tensor, contact: Tensor, motions: Tensor) -> Tensor:
    """Returns which motions (B, K, 7) undo a step before anything was tried, (B, K) bool.

    An open hand goes to where it was sent since it last closed: it wavers, or tries a way again that is blocked. A
    closed one lets go what it holds, without a contact event. Arguments are as in `repeats_failure`.
    """
    opens, was_open = commands[..., GRIPPER_DIM] >= CLOSED, poses[..., GRIPPER_DIM] > OPEN_HAND
    went = valid & opens & was_open[:, :-1] & ~_before(valid & ~opens)
    goals = pose_after(motions, poses[:, -1:])
    places = _places(torch.cat([commands, poses, goals], dim=1))
    steps = commands.shape[1]
    sent, felt, ends = places[:, :steps], places[:, steps : 2 * steps + 1], places[:, 2 * steps + 1 :]
    arrived, here = _same(sent, felt[:, 1:]), _same(felt[:, :-1], felt[:, -1:])
    same = _same(sent[:, :, None], ends[:, None]) & (went & (arrived | here))[..., None]
    holds = (poses[:, -1:, GRIPPER_DIM] >= EMPTY_HAND) & ~was_open[:, -1:] & valid[:, -1:] & ~opens[:, -1:]
    tried = (contact & ~_before(valid & opens)).any(dim=1, keepdim=True)
    wavers = same.any(dim=1) & was_open[:, -1:]
    result: Tensor = (wavers | holds & ~tried) & (motions[..., -1] >= CLOSED)
    return result


def is_blocked(commands: Tensor, poses: Tensor, valid: Tensor, *, failed_below: float) -> Tensor:
    """Returns whether the way of an open hand is blocked (B,): it did less than ``failed_below`` of its last motion.

    A retreat, which is the way out, does not count. Arguments are as in `repeats_failure`.
    """
    last, start, end = commands[:, -1], poses[:, -2], poses[:, -1]
    sent, undone = (last[:, POSITION_DIMS] - each[:, POSITION_DIMS] for each in (start, end))
    far = sent.norm(dim=-1).clamp(min=FAR_ENOUGH_DISTANCE)
    ahead = (sent * matrix_from_6d(start[:, ROTATION_DIMS])[..., 2]).sum(dim=-1)
    is_open = (last[:, GRIPPER_DIM] >= CLOSED) & (start[:, GRIPPER_DIM] > OPEN_HAND)
    result: Tensor = valid[:, -1] & is_open & (ahead > -far / 2) & (undone.norm(dim=-1) > (1 - failed_below) * far)
    return result


def _places(poses: Tensor) -> Tensor:
    """Returns position and rotation matrix (..., 12) of poses (..., 10), for `_same`."""
    return torch.cat([poses[..., POSITION_DIMS], matrix_from_6d(poses[..., ROTATION_DIMS]).flatten(-2)], dim=-1)


def _same(first: Tensor, second: Tensor) -> Tensor:
    """Returns whether `_places` (..., 12) are the same but for centimetres, (...), broadcast."""
    near = (first[..., :3] - second[..., :3]).square().sum(dim=-1) < SAME_GOAL_M**2
    trace = (first[..., 3:] * second[..., 3:]).sum(dim=-1)
    result: Tensor = near & (trace > 1 + 2 * math.cos(SAME_GOAL_RAD))
    return result


def _before(event: Tensor) -> Tensor:
    """Returns which steps (B, H) have an event (B, H) at or after them."""
    return event.flip(1).cumsum(dim=1).flip(1) > 0


def _scaled(motion: Tensor) -> Tensor:
    """Returns translation and rotation (..., 6) of motions (..., 7) in `MOTION_UNITS`."""
    return motion[..., :6] / constant(MOTION_UNITS, motion)[:6]


def _in_base(scaled: Tensor, tool: Tensor) -> Tensor:
    """Rotates translations and rotation vectors (B, K, 6) from the frames of tools (B, 1 or K, 10) to the base's."""
    frame = matrix_from_6d(tool[..., ROTATION_DIMS]).transpose(-1, -2)
    parts = (scaled[..., :3], scaled[..., 3:])
    return torch.cat([(part[..., None, :] @ frame).squeeze(-2) for part in parts], dim=-1)
