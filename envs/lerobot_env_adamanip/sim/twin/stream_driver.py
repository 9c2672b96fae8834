"""Driver that follows a stream of targets tick by tick. Key frames are unchanged."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import Feedback, Outcome
from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector
from lerobot_env_adamanip.sim.keyframe_driver import LEANING_SPEED, PATH_TOLERANCE, KeyframeDriver
from lerobot_env_adamanip.sim.kinematics import pose_error

Array = NDArray[np.float64]

SETTLING = 0.06
"""Time constant of the approach to the target [s]. It smooths targets that arrive at 30 Hz."""
BRAKING = 0.8
"""Fraction of the acceleration used for braking, since ticks have a finite length."""
FOLLOWS = 0.2
"""Minimum fraction of its path that the commanded pose covers, unless a joint is at its limit."""


class StreamDriver(KeyframeDriver):
    """A `KeyframeDriver` that also follows a stream of targets, one control tick at a time.

    The commanded pose follows the target within the speed and acceleration limits of a key frame. After a stall it only
    moves where the tool's lag does not grow. So a blocked pull stays at about 30 N until the target moves back.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._slot: tuple[Array, float] | None = None
        self._velocity: Array = np.zeros(6)
        self._holding = False
        self._stuck = 0
        self.stalled = False
        """Whether the tool presses against an obstacle in front of the target."""
        self.unreachable = False
        """Whether the arm cannot move any closer to the target."""

    def follow_target(self, action: NDArray[np.float32]) -> None:
        """Sets the target to an action (10,). `stream_tick` then approaches it.

        Raises:
            ConfigurationError: the action has the wrong shape or is not finite.
        """
        goal, gripper = self._checked(action)
        if self._slot is None:
            self._begin_stream()
        self._finger_target = self._finger_goal(gripper)
        self._slot = self.goal = (goal, gripper)
        self._holding = False

    def hold(self) -> None:
        """Stops following: the arm decelerates and stays. The fingers continue."""
        self._holding = True

    def stream_tick(self) -> None:
        """Advances one control tick towards the target. Without a target the arm stays."""
        before = self.kinematics.tcp_in_base(self._target)
        goal = before if self._slot is None or self._holding else self._slot[0]
        lag = pose_error(self.kinematics.tcp_in_base(self._read().qpos), before)
        waypoint, velocity = self._next(before, goal)
        if self.stalled and self._farther(waypoint, lag):
            waypoint, velocity = before, np.zeros(6)
        self._velocity = velocity
        self.stalled = self._advance(self._posture(waypoint, before) if velocity.any() else self._target)
        self.effort = self._torque(self._read())
        self.feedback = self._feedback(None)

    def end_stream(self) -> None:
        """Drops the target. The next target or key frame starts at the arm's current pose."""
        self._leans = self.stalled and bool(np.abs(self._read().qvel).max() < LEANING_SPEED)
        self._slot, self._stuck = None, 0
        self._holding = False
        self._velocity, self.stalled, self.unreachable = np.zeros(6), False, False

    def break_off(self) -> None:
        """Decelerates from the current speed after an aborted key frame."""
        state = self._read()
        self.end_stream()
        self._leans = False
        turn = self.kinematics.tcp_in_base(state.qpos)[:3, :3]
        twist = self.kinematics.body_jacobian(state.qpos) @ state.qvel
        self._velocity = np.concatenate([turn @ twist[:3], twist[3:]])

    @property
    def stream_outcome(self) -> Outcome | None:
        """Returns STALLED, UNREACHABLE or None."""
        return Outcome.STALLED if self.stalled else Outcome.UNREACHABLE if self.unreachable else None

    def measured(self) -> Feedback:
        """Returns the measured pose and gripper, without an outcome."""
        return self._feedback(None)

    def _begin_stream(self) -> None:
        if self._leans:  # a stalled key frame ends under strain
            self._target, self._leans = self._read().qpos.copy(), False
        self._strained = 0

    def _next(self, commanded: Array, goal: Array) -> tuple[Array, Array]:
        """Returns the next commanded pose (4, 4) and its velocity (6,): [m/s, base frame], [rad/s, tool frame]."""
        limits, left = self.limits, pose_error(commanded, goal)
        left[:3] = goal[:3, 3] - commanded[:3, 3]
        velocity = np.empty(6)
        for part, speed, acceleration in (
            (slice(0, 3), limits.linear_speed, limits.linear_acceleration),
            (slice(3, 6), limits.angular_speed, limits.angular_acceleration),
        ):
            distance = math.sqrt(float(left[part] @ left[part]))
            wanted = min(speed, _braking_speed(distance, BRAKING * acceleration))
            aim = left[part] * (wanted / distance) if distance > 0 else np.zeros(3)
            velocity[part] = _bounded_change(self._velocity[part], aim, acceleration * self._dt)
        waypoint = commanded.copy()
        waypoint[:3, 3] += velocity[:3] * self._dt
        waypoint[:3, :3] = commanded[:3, :3] @ matrix_from_rotation_vector(velocity[3:] * self._dt)
        return waypoint, velocity

    def _farther(self, waypoint: Array, lag: Array) -> bool:
        """Returns whether the strained part of the lag would be larger at ``waypoint`` (4, 4) than ``lag`` (6,)."""
        ahead, limits = pose_error(self.kinematics.tcp_in_base(self._read().qpos), waypoint), self.limits
        far = [np.linalg.norm(each[:3]) / limits.stall_position for each in (ahead, lag)]
        turned = [np.linalg.norm(each[3:]) / limits.stall_rotation for each in (ahead, lag)]
        return bool(max(far[0], turned[0]) > max(far[1], turned[1]))

    def _posture(self, waypoint: Array, commanded: Array) -> Array:
        """Returns joint positions (7,) [rad] of a commanded pose, or the current ones without a nearby solution."""
        solution = self.kinematics.solve(waypoint, self._target, iterations=15, tolerance=PATH_TOLERANCE)
        if not solution.within(5e-3, 0.03):
            solution = self.kinematics.solve(waypoint, self._target, iterations=80)
        follows = solution.within(0.01, 0.06)
        wanted, got = (pose_error(commanded, each) for each in (waypoint, self.kinematics.tcp_in_base(solution.qpos)))
        self._stuck = self._stuck + 1 if not follows or got @ wanted < FOLLOWS * (wanted @ wanted) else 0
        self.unreachable = self._stuck >= self.limits.stall_ticks
        if not follows:
            self._velocity = np.zeros(6)
        return solution.qpos if follows else self._target


def _braking_speed(distance: float, deceleration: float) -> float:
    """Returns the speed that comes to rest within ``distance``, with constant deceleration and a gentle end."""
    gentle = deceleration * SETTLING**2
    if distance < gentle:
        return distance / SETTLING
    return math.sqrt(2 * deceleration * (distance - gentle / 2))


def _bounded_change(velocity: Array, wanted: Array, most: float) -> Array:
    change = wanted - velocity
    size = math.sqrt(float(change @ change))
    return wanted if size <= most else velocity + change * (most / size)
