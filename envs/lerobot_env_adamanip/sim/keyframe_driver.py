"""Execution of one key frame: moves the arm to a commanded pose until it arrives, stalls or runs out of time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Feedback, MotionLimits, Outcome
from lerobot_adamanip.contract.rotations import angle_between, pose_from_vector, straight_path
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.kinematics import NUM_ARM_JOINTS, ArmKinematics, joint_path

Array = NDArray[np.float64]

FINGER_OPEN, FINGER_CLOSED = 0.04, -0.01
"""Finger targets [m]. The closed target is beyond contact, so that the fingers press on thin parts."""
FINGER_HALF = 0.5 * (FINGER_OPEN + FINGER_CLOSED)
"""Finger target below which a hand counts as closed [m]."""
FOLDED = 1.5
"""Distance of a joint from rest at which the arm is folded and no straight line leads back [rad]."""
PATH_TOLERANCE, LAST_TOLERANCE = 5e-4, 1e-4
"""Tolerances of inverse kinematics on the way and at its end [m and rad]; the next tick corrects the error of this
one."""
LEANING_SPEED = 0.5
"""Joint speed below which a stalled arm counts as leaning against something [rad/s]."""


@dataclass
class ArmState:
    """State of the arm's joints. Arrays are (7,), except ``fingers`` (2,): [rad], [rad/s], [m]."""

    qpos: Array
    qvel: Array
    fingers: Array


class KeyframeDriver:
    """Converts one (10,) action into control ticks.

    Args:
        kinematics: kinematics of the arm.
        read: returns the present `ArmState`.
        tick: advances the simulation by one control step with joint targets (7,), joint velocity targets (7,) and a
            finger target [m].
        control_dt: duration of a tick [s].
        stiffness: stiffness of the joint drives (7,) [N m/rad].
        limits: see `MotionLimits`.
    """

    def __init__(
        self,
        kinematics: ArmKinematics,
        read: Callable[[], ArmState],
        tick: Callable[[Array, Array, float], None],
        *,
        control_dt: float,
        stiffness: Array,
        limits: MotionLimits = DEFAULT_MOTION,
    ) -> None:
        self.kinematics, self.limits = kinematics, limits
        self._read, self._tick_simulation = read, tick
        self._dt, self._stiffness = control_dt, stiffness
        self._target: Array = read().qpos.copy()
        self._finger = self._finger_target = FINGER_OPEN
        self._ticks = self._strained = 0
        self._leans = self._is_clipped = False
        self.effort: Array = np.zeros(NUM_ARM_JOINTS)
        self.feedback = self._feedback(None)
        self.goal: tuple[Array, float] = (self.feedback.tcp_in_base, self.feedback.gripper)

    def execute(self, action: NDArray[np.float32]) -> Feedback:
        """Runs one key frame and returns its feedback.

        A stalled motion ends at rest under strain. State, cloud and effort are measured then, like the external torque
        of a robot that leans against something. The next key frame first releases the strain. An arm that was stopped
        on its way, or pushed away, is braked first.

        Raises:
            ConfigurationError: the action has the wrong shape or is not finite.
        """
        goal, gripper = self.goal = self._checked(action)
        self._ticks = self._strained = 0
        if self._leans:
            self._relax()
        finger_goal = self._finger_goal(gripper)
        gripper_moves = abs(finger_goal - self._finger_target) > 5e-3
        self._finger_target = finger_goal
        outcome = self._follow(goal)
        if outcome is Outcome.UNREACHABLE and self._finger_target >= FINGER_HALF:
            outcome = self._go_round(goal)
        if outcome is Outcome.REACHED:
            outcome = self._settle(goal, self.limits.grip_ticks if gripper_moves else 0)
        self._leans = outcome is Outcome.STALLED and np.abs(self._read().qvel).max() < LEANING_SPEED
        if outcome is not Outcome.REACHED and not self._leans:
            self._relax()
        self.effort = self._torque(self._read())
        self.feedback = replace(self._feedback(outcome), is_clipped=self._is_clipped)
        return self.feedback

    def _checked(self, action: NDArray[np.float32]) -> tuple[Array, float]:
        array = np.asarray(action, dtype=np.float64)
        if array.shape != (ACTION_DIM,) or not np.isfinite(array).all():
            got = f"shape {array.shape}" if array.shape != (ACTION_DIM,) else f"non-finite values {array.tolist()}"
            allowed = f"({ACTION_DIM},) finite numbers: position [m], rotation 6D, gripper"
            raise ConfigurationError(
                "Malformed action.", got=got, allowed=allowed, hint="lerobot_adamanip.contract.rotations.pose_vector"
            )
        goal, gripper = pose_from_vector(array)
        inside = np.clip(goal[:3, 3], self.limits.reach_lower, self.limits.reach_upper)
        self._is_clipped, goal[:3, 3] = not np.array_equal(inside, goal[:3, 3]), inside
        return goal, float(np.clip(gripper, 0.0, 1.0))

    @staticmethod
    def _finger_goal(gripper: float) -> float:
        return FINGER_CLOSED + (FINGER_OPEN - FINGER_CLOSED) * gripper

    def _follow(self, goal: Array) -> Outcome:
        """Follows a straight line and slerp with a smooth speed profile, from the present pose."""
        start = self.kinematics.tcp_in_base(self._target)
        distance = float(np.linalg.norm(goal[:3, 3] - start[:3, 3]))
        angle = angle_between(start[:3, :3], goal[:3, :3])
        limits = self.limits
        seconds = max(
            _quintic_seconds(distance, limits.linear_speed, limits.linear_acceleration),
            _quintic_seconds(angle, limits.angular_speed, limits.angular_acceleration),
        )
        ticks = max(1, int(np.ceil(seconds / self._dt)))
        shares = [_quintic(k / ticks) for k in range(1, ticks + 1)]
        for number, waypoint in enumerate(straight_path(start, goal, np.array(shares)), 1):
            tolerance = LAST_TOLERANCE if number == ticks else PATH_TOLERANCE
            solution = self.kinematics.solve(waypoint, self._target, iterations=15, tolerance=tolerance)
            if not solution.within(5e-3, 0.03):
                solution = self.kinematics.solve(waypoint, self._target, iterations=80)
                if not solution.within(0.01, 0.06):
                    return Outcome.UNREACHABLE
            if self._advance(solution.qpos):
                return Outcome.STALLED
            if self._ticks >= self.limits.max_ticks:
                return Outcome.TIMEOUT
        return Outcome.REACHED

    def _go_round(self, goal: Array) -> Outcome:
        """Moves in joint space to the goal's posture as reached from rest.

        A straight line may move the elbow into a corner from which no straight line leads back. From far left, every
        goal would then be unreachable until the next reset. Only an open hand does this; a closed one may hold a part.
        """
        posture = self.kinematics.canonical(goal)
        folded = np.abs(posture.qpos - self.kinematics.rest).max() > FOLDED
        if folded or not posture.within(0.01, 0.06):
            return Outcome.UNREACHABLE
        for target in joint_path(self._target, posture.qpos, self.limits.joint_speed * self._dt):
            if self._advance(target):
                return Outcome.STALLED
            if self._ticks >= self.limits.max_ticks:
                return Outcome.TIMEOUT
        return Outcome.REACHED

    def _settle(self, goal: Array, wait: int) -> Outcome:
        state = self._read()
        for k in range(self.limits.settle_ticks + wait):
            if self._advance(self._target):
                return Outcome.STALLED
            state = self._read()
            if k + 1 >= wait and np.abs(state.qvel).max() < 0.03:
                break
        actual = self.kinematics.tcp_in_base(state.qpos)
        far = np.linalg.norm(actual[:3, 3] - goal[:3, 3]) > self.limits.reached_position
        turned = angle_between(actual[:3, :3], goal[:3, :3]) > self.limits.reached_rotation
        return Outcome.STALLED if far or turned else Outcome.REACHED

    def _advance(self, target: Array) -> bool:
        """Runs one control tick towards ``target``; True once the arm has lagged long enough to count as stalled."""
        velocity = (target - self._target) / self._dt
        self._target = target
        self._tick(target, velocity)
        self._strained = self._strained + 1 if self._lags(target) else 0
        return self._strained >= self.limits.stall_ticks

    def _lags(self, target: Array) -> bool:
        """Returns whether the tool lags ``target`` by more than inertia explains."""
        wanted, actual = self.kinematics.tcp_in_base(target), self.kinematics.tcp_in_base(self._read().qpos)
        x, y, z = (wanted[:3, 3] - actual[:3, 3]).tolist()
        if x * x + y * y + z * z > self.limits.stall_position**2:
            return True
        # For two rotations at an angle, the trace of one's inverse times the other is 1 + 2 cos(angle).
        alike = float(np.vdot(wanted[:3, :3], actual[:3, :3]))
        return alike < 1.0 + 2.0 * math.cos(self.limits.stall_rotation)

    def _relax(self) -> None:
        """Releases strain: sets the targets to the present joint positions."""
        for _ in range(8):
            self._target = self._read().qpos.copy()
            self._tick(self._target, np.zeros(NUM_ARM_JOINTS))

    def _tick(self, target: Array, velocity: Array) -> None:
        """Runs one control tick; limits the speed of the finger target."""
        step = self.limits.finger_speed * self._dt
        self._finger += float(np.clip(self._finger_target - self._finger, -step, step))
        self._tick_simulation(target, velocity, self._finger)
        self._ticks += 1

    def _torque(self, state: ArmState) -> Array:
        """Returns the external joint torque (7,) [N m] from the drives' springs; exact at rest, as gravity is balanced.

        It omits the drives' damping, which reacts to the arm's own inertia and would look like contact.
        """
        return self._stiffness * (self._target - state.qpos)

    def _feedback(self, outcome: Outcome | None) -> Feedback:
        state = self._read()
        return Feedback(self.kinematics.tcp_in_base(state.qpos), float(state.fingers.mean() / FINGER_OPEN), outcome)


def _quintic_seconds(distance: float, speed: float, acceleration: float) -> float:
    """Returns the duration of a quintic over ``distance`` within both peaks: 15/8 d/T and 10/sqrt(3) d/T^2."""
    return float(max(1.875 * distance / speed, np.sqrt(10 / np.sqrt(3) * distance / acceleration)))


def _quintic(t: float) -> float:
    return t * t * t * (10 - 15 * t + 6 * t * t)
