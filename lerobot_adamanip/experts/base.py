"""What an expert sees and says: key-frame goals out, felt feedback in."""

from __future__ import annotations

import enum
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.rotations import pose_vector

PRE_GRASP = 0.10
"""Distance from a grasp, along its approach, at which a part is approached and left [m]."""


class Outcome(enum.IntEnum):
    """How a key frame ended. Felt by the arm itself, so a policy and a real robot know it too."""

    REACHED = 0
    STALLED = 1
    TIMEOUT = 2
    UNREACHABLE = 3


class Phase(enum.IntEnum):
    """What an expert is doing: a label for people and analysis, never an input to a policy."""

    APPROACH = 0
    GRASP = 1
    TRY = 2
    RELEASE = 3
    UNLOCK = 4
    OPEN = 5


@dataclass(frozen=True)
class Goal:
    """One key frame: where the tool centre point should go.

    Attributes:
        tcp_in_base: (4, 4) pose, robot base frame [m].
        gripper: opening, 0 closed ... 1 open.
        phase: label.
        trial: how many tries at the mechanism came before or are under way, from 0.
    """

    tcp_in_base: NDArray[np.float64]
    gripper: float
    phase: Phase
    trial: int = 0

    def action(self) -> NDArray[np.float32]:
        """Returns the (10,) action of the contract."""
        return pose_vector(self.tcp_in_base, self.gripper)


@dataclass(frozen=True)
class Feedback:
    """What was felt after a key frame (or at the start): no hidden state, nothing a camera or the arm could not tell.

    Attributes:
        tcp_in_base: (4, 4) pose reached, robot base frame [m].
        gripper: opening reached, 0 closed ... 1 open.
        outcome: how the key frame ended; None at the start.
    """

    tcp_in_base: NDArray[np.float64]
    gripper: float
    outcome: Outcome | None = None

    @property
    def failed(self) -> bool:
        """True if the arm did not get where it was sent."""
        return self.outcome is not None and self.outcome is not Outcome.REACHED


KeyFrames = Generator[Goal, Feedback, None]
"""An expert at work. Prime it with ``next``; send each `Feedback`; it ends when it has nothing more to do."""
