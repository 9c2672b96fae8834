"""Key frames: what robot, policy, expert and simulator share. Goals out, felt feedback in, and how a motion ends."""

from __future__ import annotations

import enum
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import pose_vector

PRE_GRASP = 0.10
"""Distance from a grasp, along its approach, at which a part is approached and left [m]."""
FOLLOWED = 0.5
"""A part that has covered this share of a commanded motion follows; one that has not is blocked."""
EMPTY_HAND = 0.05
"""Finger opening below which nothing is between them: the grip was torn off, or closed on nothing."""

OPEN_HAND = 0.9
"""Finger opening above which a hand holds nothing: around a bottle's cap it is at 0.6."""


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
    """

    tcp_in_base: NDArray[np.float64]
    gripper: float
    phase: Phase

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


@dataclass(frozen=True)
class KeyFrameLabels:
    """What a key frame tried, and its result: written by the environment, for people and analysis.

    A *try* is a key frame in which a closed hand that is at a part was sent far enough to move one of the part's
    joints; the joint is the one that leads the hand nearest to where it was sent. It has *failed* if the joint covered
    less than half of the way it was sent (of the way that its nominal range leaves: a button is pushed past its stop).
    A label never is a policy's input. `lerobot_adamanip.episode.contact_labels` finds them.

    Attributes:
        tried: index of the joint that was tried in the mechanism's `joints` (0 the one that opens); -1 for none.
        failed: whether the try failed; False where nothing was tried.
        progress: how far the tried joint moved, in the direction it was sent [rad or m]; 0 where nothing was tried.
        sent: how far the tried joint was sent, signed [rad or m]; 0 where nothing was tried.
        trial: failed tries of this episode before this key frame: it counts up right after each failed one.
    """

    tried: int = -1
    failed: bool = False
    progress: float = 0.0
    trial: int = 0
    sent: float = 0.0


KeyFrames = Generator[Goal, Feedback, None]
"""An expert at work. Prime it with ``next``; send each `Feedback`; it ends when it has nothing more to do."""


@dataclass(frozen=True)
class MotionLimits:
    """How the arm moves, and when it gives up. Speeds and forces a real Franka is comfortable with.

    Attributes:
        linear_speed: [m/s] peak.
        angular_speed: [rad/s] peak.
        linear_acceleration: [m/s^2] peak; low enough that the arm's own inertia never looks like a stall.
        angular_acceleration: [rad/s^2] peak.
        joint_speed: [rad/s] of the fastest joint, where the arm has to go round in joint space.
        stall_position: [m] that the tool lags behind its target, for ``stall_ticks``, end a motion: some 30 N.
        stall_rotation: [rad] likewise: 1.1 N m about the approach, which is what two fingers can hold.
        stall_ticks: control ticks.
        settle_ticks: at most waited for the arm to come to rest.
        finger_speed: [m/s] of each finger. Unbounded, they would be inside what they close on within one physics step.
        grip_ticks: waited for the fingers.
        reached_position: [m] error up to which a goal counts as reached.
        reached_rotation: [rad] likewise.
        max_ticks: a key frame never lasts longer.
        reach_lower, reach_upper: commanded positions are clipped to this box [m, base frame].
    """

    linear_speed: float = 0.45
    angular_speed: float = 1.6
    linear_acceleration: float = 1.2
    angular_acceleration: float = 5.0
    joint_speed: float = 0.8
    stall_position: float = 0.0065
    stall_rotation: float = 0.045
    stall_ticks: int = 4
    settle_ticks: int = 25
    finger_speed: float = 0.2
    grip_ticks: int = 20
    reached_position: float = 0.012
    reached_rotation: float = 0.12
    max_ticks: int = 300
    reach_lower: tuple[float, float, float] = (0.15, -0.7, 0.03)
    reach_upper: tuple[float, float, float] = (0.95, 0.7, 1.1)


DEFAULT_MOTION = MotionLimits()
GENTLE = MotionLimits(angular_speed=0.8, stall_rotation=0.03, stall_ticks=3)
"""For round parts: at the usual speed a blocked one slips by up to 20 degrees in the fingers before the arm gives up,
and then it looks as if it had followed."""
