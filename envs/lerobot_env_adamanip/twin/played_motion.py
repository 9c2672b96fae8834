"""Streams a key frame at human speed and determines its outcome from the arm's readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Feedback, Outcome
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, straight_path
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.target_geometry import Target, pose_error

Array = NDArray[np.float64]

STILL_POSITION, STILL_ROTATION, STILL_GRIPPER = 0.001, 0.004, 0.01
"""Maximum motion of an arm at rest within `STILL_TIME` [m, rad, fraction of the opening]."""
STILL_TIME = 0.4
"""Time window of the rest test [s]."""
LAG_POSITION, LAG_ROTATION = 0.5, 0.5
"""Lag of a blocked arm at rest, as a fraction of a key frame's stall lag."""
STRAINED = 2.0
"""Joint torque above which the arm is blocked [N m]. An arm at the limit of its reach exerts none."""
PATIENCE = 8.0
"""Delay after which a motion times out [s]."""


@dataclass
class PlayedMotion:
    """Streams targets from the current pose to a goal, then moves the fingers, then waits.

    Args:
        start: (4, 4) measured start pose, robot base frame.
        goal: (4, 4) goal pose.
        held: currently commanded gripper opening.
        gripper: gripper opening at the goal.
        speed, angular_speed: peak speeds [m/s, rad/s].
        pause: pause at the end [s].

    Attributes:
        outcome: None until the end.
    """

    start: Array
    goal: Array
    held: float
    gripper: float
    speed: float
    angular_speed: float
    pause: float

    def __post_init__(self) -> None:
        way, turn = pose_error(self.start, self.goal)
        self._duration = 1.875 * max(way / self.speed, turn / self.angular_speed)
        self._elapsed, self._seen = 0.0, list[tuple[float, ArmReading]]()
        self._arrived: Outcome | None = None
        self._grips, self._left = False, 0.0
        self.outcome: Outcome | None = None

    def step(self, reading: ArmReading, sent: Target, dt: float) -> Target:
        """Returns the next target (10,) from the last sent one. Sets `outcome` at the end."""
        self._elapsed += dt
        self._seen = [(at, seen) for at, seen in self._seen if self._elapsed - at <= STILL_TIME + 1e-9]
        self._seen.append((self._elapsed, reading))
        if self._arrived is None:
            self._arrived = self._judge_move(reading, sent)
            # As in `ArmDriver`: the gripper acts during a motion, or alone without one.
            self._grips = self._arrived is Outcome.REACHED and abs(self.gripper - self.held) > 0.1
            self._left = STILL_TIME if self._grips else self.pause
        else:
            self._left -= dt
            if self._left <= 0 and not self._grips:
                self.outcome = self._arrived
            elif self._left <= 0 and self._rests():
                self._grips, self._left = False, self.pause
        return self._wanted(sent)

    def feedback(self, reading: ArmReading) -> Feedback:
        """Returns the expert's feedback at the end."""
        return Feedback(reading.tcp_in_base, reading.gripper, self.outcome)

    def _wanted(self, sent: Target) -> Target:
        if self._arrived is None:
            share = 1.0 if self._duration <= 0 else min(1.0, self._elapsed / self._duration)
            smooth = share**3 * (10 - 15 * share + 6 * share**2)
            return pose_vector(straight_path(self.start, self.goal, np.array([smooth]))[0], self.gripper)
        held = sent.copy()
        held[9] = self.gripper
        return held

    def _judge_move(self, reading: ArmReading, sent: Target) -> Outcome | None:
        """Returns the outcome of the motion; None before its end."""
        limits = DEFAULT_MOTION
        far, turned = pose_error(reading.tcp_in_base, self.goal)
        near = far < limits.reached_position and turned < limits.reached_rotation
        if near and self._elapsed >= self._duration and self._rests():
            return Outcome.REACHED
        if self._elapsed > self._duration + PATIENCE:
            return Outcome.TIMEOUT
        if self._elapsed > STILL_TIME and self._rests() and self._lags(reading, sent):
            return Outcome.STALLED if float(np.abs(reading.effort).max()) > STRAINED else Outcome.UNREACHABLE
        return None

    def _rests(self) -> bool:
        (first, before), (last, now) = self._seen[0], self._seen[-1]
        if last - first < STILL_TIME * 0.9:
            return False
        moved, turned = pose_error(now.tcp_in_base, before.tcp_in_base)
        return bool(
            moved < STILL_POSITION and turned < STILL_ROTATION and abs(now.gripper - before.gripper) < STILL_GRIPPER
        )

    def _lags(self, reading: ArmReading, sent: Target) -> bool:
        far, turned = pose_error(reading.tcp_in_base, pose_from_vector(sent)[0])
        limits = DEFAULT_MOTION
        return far / limits.stall_position > LAG_POSITION or turned / limits.stall_rotation > LAG_ROTATION
