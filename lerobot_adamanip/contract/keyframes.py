"""Key frames, shared by robot, policy, expert and simulator: goals, feedback, outcomes and motion limits."""

from __future__ import annotations

import enum
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import pose_vector

PRE_GRASP = 0.10
"""Distance of the pre-grasp pose from the grasp, along the approach [m]; a retreat goes back as far."""
FOLLOWED = 0.5
"""Least share of a commanded motion that a following part covers; a part that covers less is blocked."""
EMPTY_HAND = 0.05
"""Gripper opening below which the hand is empty: the grip was lost, or closed on nothing."""
CLOSED_HAND = 0.5
"""Commanded gripper opening below which the hand closes."""
OPEN_HAND = 0.9
"""Gripper opening above which the hand holds nothing; around a bottle's cap it is 0.6."""


class Outcome(enum.IntEnum):
    """How a key frame ended. The arm itself measures it, so policies and real robots have it too."""

    REACHED = 0
    STALLED = 1
    TIMEOUT = 2
    UNREACHABLE = 3


class Phase(enum.IntEnum):
    """What an expert is doing. A label for analysis, never a policy input."""

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
    """Measured result of a key frame, or the state at the start. Contains no hidden state.

    Attributes:
        tcp_in_base: (4, 4) pose reached, robot base frame [m].
        gripper: opening reached, 0 closed ... 1 open.
        outcome: how the key frame ended; None at the start.
        is_clipped: whether the commanded position was outside `MotionLimits`' box, so that the goal was another one.
    """

    tcp_in_base: NDArray[np.float64]
    gripper: float
    outcome: Outcome | None = None
    is_clipped: bool = False

    @property
    def failed(self) -> bool:
        """True if the arm did not reach its goal."""
        return self.outcome is not None and self.outcome is not Outcome.REACHED


@dataclass(frozen=True)
class KeyFrameLabels:
    """Try of a key frame, and its result. Set by the environment, for analysis; never a policy input.

    `lerobot_adamanip.episode.tries` defines a try, by contacts. A try may last several key frames, and a key frame with
    several tries has the labels of the longest.

    Attributes:
        tried: index of the tried joint in the mechanism's `joints` (0 is the one that opens); -1 for none.
        failed: whether the joint had not moved by the end of the key frame; False without a try.
        progress: motion of the tried joint in this key frame, in the direction of the try [rad or m]; 0 without a try.
        trial: number of failed tries in this episode before this key frame.
        direction: sign of the try; 0 without a try.
        number: index of the try in the episode; -1 without a try.
    """

    tried: int = -1
    failed: bool = False
    progress: float = 0.0
    trial: int = 0
    direction: int = 0
    number: int = -1


KeyFrames = Generator[Goal, Feedback, None]
"""A running expert. Prime it with ``next``, then send each `Feedback`; it ends when it has no further goal."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the arm's motion, and conditions that end it. A real Franka can execute them.

    Attributes:
        linear_speed: [m/s] peak.
        angular_speed: [rad/s] peak.
        linear_acceleration: [m/s^2] peak; low enough that the arm's own inertia never looks like a stall.
        angular_acceleration: [rad/s^2] peak.
        joint_speed: [rad/s] of the fastest joint, where the arm takes a detour in joint space.
        stall_position: [m] lag of the tool behind its target that ends a motion after ``stall_ticks``: about 30 N.
        stall_rotation: [rad] likewise: 1.1 N m about the approach, the most that two fingers can hold.
        stall_ticks: control ticks.
        settle_ticks: longest wait for the arm to come to rest.
        finger_speed: [m/s] of each finger. Without a bound they would penetrate a part within one physics step.
        grip_ticks: wait for the fingers.
        reached_position: [m] error up to which a goal counts as reached.
        reached_rotation: [rad] likewise.
        max_ticks: longest duration of a key frame.
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
"""For round parts. At the usual speed a blocked part slips up to 20 degrees in the fingers before the arm detects the
stall, and then looks as if it had followed."""
