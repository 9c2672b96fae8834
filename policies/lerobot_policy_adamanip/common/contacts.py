"""Contact events: past key frames that sent a closed hand somewhere. The memory reads no others.

A memory of all key frames becomes a phase clock, which says what comes next instead of the cloud (causal confusion).
Approaches, grasps and releases therefore leave no trace in the memory. Rules beside it, which are not learnt: a failed
motion is not repeated until something has moved, and no step is undone before anything was tried.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.keyframes import CLOSED_HAND, EMPTY_HAND, OPEN_HAND
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.common.losses import surely_none
from lerobot_policy_adamanip.common.tool_frame import MOTION_DIM, MOTION_UNITS, constant, motion_between, pose_after
from lerobot_policy_adamanip.common.torch_rotations import matrix_from_6d

FAR_ENOUGH_DISTANCE, FAR_ENOUGH_ANGLE = 0.008, 0.1
"""Least commanded motion of a closed hand that is an event [m, rad]; a grip that settles moves less."""
SAME_PLACE_M, SAME_DIRECTION = 0.06, 0.5
"""Motions are the same if their tools start this near [m], and their directions have at least this cosine."""
SAME_GOAL_M, SAME_GOAL_RAD = 0.03, 0.5
"""Goals are the same if they are this near [m, rad]; demonstrated approaches are further apart."""


UNDONE_UNITS = (0.01, 0.01, 0.01, 0.2, 0.2, 0.2, 1.0)
"""Units of the undone part of a motion [m, m, m, rad, rad, rad, -]: typical of a stopped arm."""
EVENT_RANGE = 3.0
EVENT_DIM = 2 * MOTION_DIM + 2


@dataclass(frozen=True)
class Past:
    """The past H key frames: what was commanded, how far the arm followed, and what the rules make of it.

    Attributes:
        commands: (B, H, 10) commanded poses, oldest first.
        poses: (B, H + 1, 10) measured tool poses before each command, and the present one.
        valid: (B, H) bool, false before the episode's start.
    """

    commands: Tensor
    poses: Tensor
    valid: Tensor

    @cached_property
    def motions(self) -> tuple[Tensor, Tensor]:
        """Commanded motions (B, H, 7) in the frame of the tool before, and what is left of them in the one after."""
        ends = torch.stack([self.poses[:, :-1], self.poses[:, 1:]])
        return motion_between(self.commands, ends).unbind()  # type: ignore[return-value]

    @cached_property
    def contact(self) -> Tensor:
        """Which key frames are contact events (B, H): the hand is closed before and after, and sent far enough.

        A closed hand that is empty can only push, so only its motion forward counts.
        """
        motion = self.motions[0]
        shift, turn = motion[..., :3].norm(dim=-1), motion[..., 3:6].norm(dim=-1)
        opening = self.poses[:, :-1, GRIPPER_DIM]
        holds = (opening >= EMPTY_HAND) & (opening <= OPEN_HAND)
        far = (shift > FAR_ENOUGH_DISTANCE) | (turn > FAR_ENOUGH_ANGLE)
        moves = holds & far | (motion[..., 2] > FAR_ENOUGH_DISTANCE)
        closed = ~self.opens
        result: Tensor = self.valid & moves & closed & F.pad(closed[:, :-1], (1, 0))
        return result

    @cached_property
    def opens(self) -> Tensor:
        """Which commands open the hand or leave it open (B, H)."""
        return self.commands[..., GRIPPER_DIM] >= CLOSED_HAND

    def events(self, *, feedback: bool = True) -> Tensor:
        """Returns a row (B, H, 16) per key frame, zero where invalid; without ``feedback``, zero for the arm's result.

        A row is the commanded motion, the undone one (each in its units), the reached gripper opening, and validity.
        """
        commanded, undone = self.motions
        reached = self.poses[:, 1:, GRIPPER_DIM:]
        undone = torch.cat([undone[..., :6], undone[..., 6:] - reached], dim=-1)
        outcome = torch.cat([undone / constant(UNDONE_UNITS, undone), reached], dim=-1)
        outcome = outcome if feedback else torch.zeros_like(outcome)
        commanded = commanded / constant(MOTION_UNITS, commanded)
        rows = torch.cat([commanded, outcome, torch.ones_like(commanded[..., :1])], dim=-1)
        return rows.clamp(-EVENT_RANGE, EVENT_RANGE).masked_fill(~self.valid[..., None], 0.0)

    def repeats(self, motions: Tensor, failed_below: float) -> tuple[Tensor, Tensor]:
        """Returns which motions (B, K, 7) from the present pose would repeat a failed contact event, twice (B, K) bool.

        An event failed if less than ``failed_below`` of its motion was done, or if the hand lost its grip. The first
        result is about failures since something has moved, the second about those of the present grip: since the hand
        was open, too. Motions are compared in the base frame, whichever way a part is held.
        """
        tool, reached = self.poses[:, :-1], self.poses[:, 1:]
        sent, undone = (_scaled(motion) for motion in self.motions)
        lost = (tool[..., GRIPPER_DIM] >= EMPTY_HAND) & (reached[..., GRIPPER_DIM] < EMPTY_HAND)
        failed = self.contact & (lost | (undone.norm(dim=-1) > (1 - failed_below) * sent.norm(dim=-1)))
        near = (tool[..., POSITION_DIMS] - self.poses[:, -1:, POSITION_DIMS]).norm(dim=-1) < SAME_PLACE_M
        since_moved = failed & near & ~_before(self.contact & ~failed)
        closed = motions[..., -1] < CLOSED_HAND
        if surely_none(since_moved):
            return torch.zeros_like(closed), torch.zeros_like(closed)
        past, ahead = _in_base(sent, tool), _in_base(_scaled(motions), self.poses[:, -1:])
        same = F.cosine_similarity(past[:, :, None], ahead[:, None], dim=-1) > SAME_DIRECTION
        this_grip = since_moved & ~_before(self.valid & self.opens)
        return (since_moved[..., None] & same).any(dim=1) & closed, (this_grip[..., None] & same).any(dim=1) & closed

    def goes_back(self, motions: Tensor) -> Tensor:
        """Returns which motions (B, K, 7) undo a step before anything was tried, (B, K) bool.

        An open hand goes to where it was sent since it last closed: it wavers, or tries a way again that is blocked. A
        closed one lets go what it holds, without a contact event.
        """
        was_open = self.poses[..., GRIPPER_DIM] > OPEN_HAND
        went = self.valid & self.opens & was_open[:, :-1] & ~_before(self.valid & ~self.opens)
        holds = (self.poses[:, -1:, GRIPPER_DIM] >= EMPTY_HAND) & ~was_open[:, -1:] & self.valid[:, -1:]
        tried = (self.contact & ~_before(self.valid & self.opens)).any(dim=1, keepdim=True)
        undoes = holds & ~self.opens[:, -1:] & ~tried
        if not surely_none(went):
            undoes = undoes | self._sent_before(motions, went) & was_open[:, -1:]
        return undoes & (motions[..., -1] >= CLOSED_HAND)

    def _sent_before(self, motions: Tensor, went: Tensor) -> Tensor:
        """Returns which motions (B, K, 7) end where a step ``went`` (B, H) that arrived or began where the hand is."""
        steps, goals = self.commands.shape[1], pose_after(motions, self.poses[:, -1:])
        places = _places(torch.cat([self.commands, self.poses, goals], dim=1))
        sent, felt, ends = places[:, :steps], places[:, steps : 2 * steps + 1], places[:, 2 * steps + 1 :]
        arrived, here = _same(sent, felt[:, 1:]), _same(felt[:, :-1], felt[:, -1:])
        return (_same(sent[:, :, None], ends[:, None]) & (went & (arrived | here))[..., None]).any(dim=1)

    def is_blocked(self, failed_below: float) -> Tensor:
        """Returns whether an open hand's way is blocked (B,): it did less than ``failed_below`` of its last motion.

        A retreat, which is the way out, does not count.
        """
        last, start, end = self.commands[:, -1], self.poses[:, -2], self.poses[:, -1]
        sent, undone = (last[:, POSITION_DIMS] - each[:, POSITION_DIMS] for each in (start, end))
        far = sent.norm(dim=-1).clamp(min=FAR_ENOUGH_DISTANCE)
        ahead = (sent * matrix_from_6d(start[:, ROTATION_DIMS])[..., 2]).sum(dim=-1)
        is_open = self.opens[:, -1] & (start[:, GRIPPER_DIM] > OPEN_HAND)
        stopped = undone.norm(dim=-1) > (1 - failed_below) * far
        result: Tensor = self.valid[:, -1] & is_open & (ahead > -far / 2) & stopped
        return result


class ContactMemory(nn.Module):
    """GRU over the contact events; other key frames leave its state unchanged."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.embedding = nn.Sequential(nn.Linear(EVENT_DIM, dim), nn.ReLU())
        # A cell: on a GPU `nn.GRU` keeps its weights in one storage, which safetensors refuses to save.
        self.cell = nn.GRUCell(dim, dim)

    def forward(self, happened: Tensor, contact: Tensor) -> Tensor:
        """`Past.events` (B, H, 16), `Past.contact` (B, H) -> (B, dim); zero without a contact event."""
        embedded = self.embedding(happened)
        state = torch.zeros_like(embedded[:, 0])
        for step in range(contact.shape[1]):
            if surely_none(contact[:, step]):
                continue
            state = torch.where(contact[:, step, None], self.cell(embedded[:, step], state), state)
        return state


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
