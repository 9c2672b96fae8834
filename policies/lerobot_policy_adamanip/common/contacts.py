"""Contact events: past key frames that moved a closed hand, or closed it on nothing. The memory reads no others.

A memory of all key frames becomes a phase clock, which says what comes next instead of the cloud (causal confusion).
Approaches, grasps that hold something and releases therefore leave no trace in the memory. Two other kinds of memory
are there to compare it with, see `config.MEMORY_KINDS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.keyframes import CLOSED_HAND, EMPTY_HAND, OPEN_HAND
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.episode.felt_tries import FELT_SHARE, MIN_LAG_M, MIN_LAG_RAD, MIN_SHIFT_M, MIN_TURN_RAD, pushes
from lerobot_policy_adamanip.common.config import CODE
from lerobot_policy_adamanip.common.geometry import MOTION_DIM, MOTION_UNITS, constant, motion_between

UNDONE_UNITS = (0.01, 0.01, 0.01, 0.2, 0.2, 0.2, 1.0)
"""Units of the undone part of a motion [m, m, m, rad, rad, rad, -]: typical of a stopped arm."""
EVENT_RANGE = 3.0
EVENT_DIM = 2 * MOTION_DIM + 2
END = 2.0
"""Gripper opening, in a history, of the last command of an earlier episode; others are 0 to 1."""


def surely_none(mask: Tensor) -> bool:
    """Returns whether no element of a mask is true. False on a GPU, where the answer would synchronise."""
    return mask.device.type == "cpu" and not bool(mask.any())


@dataclass(frozen=True)
class Past:
    """The past H key frames, or steps at control rate: what was commanded, and how far the arm followed.

    Attributes:
        commands: (B, H, 10) commanded poses, oldest first; `END` as the opening of an earlier episode's last command.
        poses: (B, H + 1, 10) measured tool poses before each command, and the present one.
        valid: (B, H) bool, false before the episode's start.
        is_dense: whether these are steps or strokes at control rate.
    """

    commands: Tensor
    poses: Tensor
    valid: Tensor
    is_dense: bool = False

    @property
    def min_motion(self) -> tuple[float, float]:
        """Least commanded motion of an event [m, rad]."""
        return (MIN_LAG_M, MIN_LAG_RAD) if self.is_dense else (MIN_SHIFT_M, MIN_TURN_RAD)

    @cached_property
    def motions(self) -> tuple[Tensor, Tensor]:
        """Commanded motions, seen from the poses before; undone motions, seen from the poses after: (B, H, 7) each."""
        ends = torch.stack([self.poses[:, :-1], self.poses[:, 1:]])
        return motion_between(self.commands, ends).unbind()  # type: ignore[return-value]

    @cached_property
    def contact(self) -> Tensor:
        """Mask (B, H) of contact events: the hand is closed before and after, and pushes, see `felt_tries.pushes`."""
        motion = self.motions[0]
        shift, turn = motion[..., :3].norm(dim=-1), motion[..., 3:6].norm(dim=-1)
        opening = self.poses[:, :-1, GRIPPER_DIM]
        moves = pushes(shift, turn, motion[..., 2], opening, self.min_motion)
        closed = ~self.opens
        result: Tensor = self.valid & moves & closed & F.pad(closed[:, :-1], (1, 0))
        return result & ~self._settles if self.is_dense else result

    @property
    def _settles(self) -> Tensor:
        """Mask (B, H) of steps in which the hand still moves against its command, see `felt_tries`."""
        measured = motion_between(self.poses[:, 1:], self.poses[:, :-1])
        units = constant(MOTION_UNITS, measured)[:6]
        commanded, covered = self.motions[0][..., :6] / units, measured[..., :6] / units
        return (covered * commanded).sum(dim=-1) < -FELT_SHARE * (commanded * commanded).sum(dim=-1)

    @cached_property
    def missed(self) -> Tensor:
        """Mask (B, H) of key frames at which an open hand closed in place and holds nothing."""
        shift, opening = self.motions[0][..., :3].norm(dim=-1), self.poses[..., GRIPPER_DIM]
        was_open, is_empty = opening[:, :-1] > OPEN_HAND, opening[:, 1:] < EMPTY_HAND
        result: Tensor = self.valid & was_open & ~self.opens & is_empty & (shift < self.min_motion[0])
        return result

    @cached_property
    def ends(self) -> Tensor:
        """Mask (B, H) of the last commands of earlier episodes, whose result was not observed."""
        return self.valid & (self.commands[..., GRIPPER_DIM] >= END)

    @cached_property
    def opens(self) -> Tensor:
        """Mask (B, H) of commands that open the hand or leave it open."""
        return self.commands[..., GRIPPER_DIM] >= CLOSED_HAND

    def events(self, *, feedback: bool = True) -> Tensor:
        """Returns a row (B, H, 16) per key frame, zero where invalid; without ``feedback``, zero for the arm's result.

        A row is the commanded motion, the undone one (each in its units), the reached gripper opening, and validity.
        The last command of an earlier episode has no result: what was undone and reached are zero.
        """
        commanded, undone = self.motions
        reached = self.poses[:, 1:, GRIPPER_DIM:]
        undone = torch.cat([undone[..., :6], undone[..., 6:] - reached], dim=-1)
        outcome = torch.cat([undone / constant(UNDONE_UNITS, undone), reached], dim=-1)
        outcome = outcome.masked_fill(self.ends[..., None], 0.0) if feedback else torch.zeros_like(outcome)
        rows = torch.cat([commanded / constant(MOTION_UNITS, commanded), outcome], dim=-1)
        rows = torch.cat([rows, torch.ones_like(rows[..., :1])], dim=-1)
        return rows.clamp(-EVENT_RANGE, EVENT_RANGE).masked_fill(~self.valid[..., None], 0.0)


class ContactMemory(nn.Module):
    """GRU over the key frames that it reads; others leave its state unchanged."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.embedding = nn.Sequential(nn.Linear(EVENT_DIM, dim), nn.ReLU())
        # A cell: on a GPU `nn.GRU` keeps its weights in one storage, which safetensors refuses to save.
        self.cell = nn.GRUCell(dim, dim)

    def forward(self, happened: Tensor, read: Tensor) -> Tensor:
        """`Past.events` (B, H, 16), mask (B, H) of those to read -> (B, dim); zero if there are none."""
        embedded = self.embedding(happened)
        state = torch.zeros_like(embedded[:, 0])
        for step in range(read.shape[1]):
            if surely_none(read[:, step]):
                continue
            state = torch.where(read[:, step, None], self.cell(embedded[:, step], state), state)
        return state


class MotionCode(ContactMemory):
    """Code of the past motions, trained to reconstruct them and by nothing else (CAMP, arXiv 2606.21188).

    CAMP trains an LSTM over states and actions before the policy. Here a GRU learns in the same training, and no
    gradient of the policy reaches it.
    """

    def __init__(self, dim: int, length: int) -> None:
        super().__init__(dim)
        self.decoder = nn.Sequential(nn.Linear(dim, 128), nn.ReLU(), nn.Linear(128, length * MOTION_DIM))

    def forward(self, happened: Tensor, read: Tensor) -> Tensor:
        """See `ContactMemory.forward`; without a gradient."""
        return super().forward(happened, read).detach()

    def loss(self, happened: Tensor, read: Tensor) -> Tensor:
        """Returns the error (B,) of the reconstructed commanded motions of `Past.events` (B, H, 16)."""
        decoded = self.decoder(super().forward(happened, read)).reshape(*happened.shape[:2], MOTION_DIM)
        error = F.smooth_l1_loss(decoded, happened[..., :MOTION_DIM], reduction="none").mean(dim=-1)
        return (error * read).sum(dim=1) / read.sum(dim=1).clamp(min=1)


def make_memory(kind: str, dim: int, length: int) -> ContactMemory:
    """Returns a memory of one of the `config.MEMORY_KINDS` over ``length`` past key frames."""
    return MotionCode(dim, length) if kind == CODE else ContactMemory(dim)


class ChoiceMemory(nn.Module):
    """Logits of choices from a memory; exactly zero if it has read nothing, and before training."""

    def __init__(self, events: ContactMemory, dim: int, features: int, choices: int) -> None:
        super().__init__()
        self.events = events
        self.hidden = nn.Sequential(nn.Linear(features + dim, 128), nn.ReLU())
        self.logits = nn.Linear(128, choices)
        nn.init.zeros_(self.logits.weight)
        nn.init.zeros_(self.logits.bias)

    def forward(self, features: Tensor, happened: Tensor, read: Tensor) -> Tensor:
        """Features (B, W), which get no gradient, and inputs of `ContactMemory` -> logits (B, K)."""
        added: Tensor = self.logits(self.hidden(torch.cat([features.detach(), self.events(happened, read)], dim=-1)))
        return added * read.any(dim=1, keepdim=True)
