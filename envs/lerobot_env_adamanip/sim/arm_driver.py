"""Motion of the arm: one key frame until it arrives, stalls or runs out of time, or a stream of targets."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Feedback, MotionLimits, Outcome
from lerobot_adamanip.contract.rotations import (
    angle_between,
    matrix_from_rotation_vector,
    pose_from_vector,
    quintic_duration,
    straight_path,
)
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.kinematics import NUM_ARM_JOINTS, IKResult, joint_path, pose_error
from lerobot_env_adamanip.sim.simulation import Simulation

Array = NDArray[np.float64]

TICKS_PER_SECOND = 50
"""Control ticks per second of the tasks [Hz]."""
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
RELAX_TICKS = 8
"""Control ticks in which an arm gives up its strain."""
SETTLING = 0.06
"""Time constant of a stream's approach to its target [s]. It smooths targets that arrive at 30 Hz."""
BRAKING = 0.8
"""Fraction of the acceleration used for braking in a stream, since ticks have a finite length."""
FOLLOWS = 0.2
"""Minimum fraction of its path that the pose of a stream covers, unless a joint is at its limit."""

AT_REST = 0.03
"""Maximum joint speed of an arm at rest [rad/s]."""
STREAM_JOINT_SPEED, STREAM_JOINT_ACCELERATION = 2.0, 10.0
"""Limits of a stream of joint positions [rad/s, rad/s^2], below the Franka's own."""

Ticks = Generator[None, None, Outcome]
"""Yields after each control tick and returns the outcome."""


class ArmDriver:
    """Converts one (10,) action, or a stream of them, into control ticks of a simulation.

    In a stream the commanded pose follows the latest target within the speed and acceleration limits of a key frame.
    After a stall it only moves where the tool's lag does not grow. So a blocked pull stays at about 30 N until the
    target moves back.

    Args:
        simulation: simulation of the episode, with the arm at rest.
        control_dt: duration of a tick [s].
        stiffness: stiffness of the joint drives (7,) [N m/rad].
        limits: see `MotionLimits`.

    Attributes:
        feedback: feedback of the latest key frame.
        effort: external joint torque (7,) [N m] at its end, from the drives' springs; exact at rest, as gravity is
            balanced. It omits their damping, which reacts to the arm's own inertia and would look like contact.
        goal: its commanded tool pose (4, 4), after clipping, and gripper opening.
        stalled: whether the tool of a stream presses against an obstacle in front of the target.
        unreachable: whether the arm of a stream cannot move any closer to the target.
    """

    def __init__(
        self, simulation: Simulation, *, control_dt: float, stiffness: Array, limits: MotionLimits = DEFAULT_MOTION
    ) -> None:
        self._simulation, self._kinematics, self._limits = simulation, simulation.kinematics, limits
        self._dt, self._stiffness = control_dt, stiffness
        self._target: Array = simulation.arm_state().qpos.copy()
        self._finger = self._finger_target = FINGER_OPEN
        self._ticks = self._strained = 0
        self._leans = self._is_clipped = False
        self.effort: Array = np.zeros(NUM_ARM_JOINTS)
        self.feedback = self.measured()
        self.goal: tuple[Array, float] = (self.feedback.tcp_in_base, self.feedback.gripper)
        self._stream: Array | None = None
        self._velocity: Array = np.zeros(6)
        self._joint_goal: Array | None = None
        self._joint_velocity: Array = np.zeros(NUM_ARM_JOINTS)
        self._holding = self.stalled = self.unreachable = False
        self._stuck = 0

    def measured(self, outcome: Outcome | None = None) -> Feedback:
        """Returns the measured pose and gripper."""
        state = self._simulation.arm_state()
        gripper = float(state.fingers.mean() / FINGER_OPEN)
        return Feedback(self._kinematics.tcp_in_base(state.qpos), gripper, outcome)

    # Key frames -----------------------------------------------------------------------------------------------------

    def execute(self, action: NDArray[np.float32]) -> Feedback:
        """Runs one key frame, see `motion`, and returns its feedback."""
        for _ in self.motion(action):
            pass
        return self.feedback

    def motion(self, action: NDArray[np.float32]) -> Iterator[None]:
        """Runs one key frame; yields after each control tick. Sets `feedback` and `effort` at the end.

        A stalled motion ends at rest under strain. State, cloud and effort are measured then, like the external torque
        of a robot that leans against something. The next key frame first releases the strain. An arm that was stopped
        on its way, or pushed away, is braked first.

        Raises:
            ConfigurationError: the action has the wrong shape or is not finite.
        """
        goal, gripper = self.goal = self._checked(action)
        self._ticks = self._strained = 0
        if self._leans:
            yield from self._relax()
        finger_goal = FINGER_CLOSED + (FINGER_OPEN - FINGER_CLOSED) * gripper
        gripper_moves = abs(finger_goal - self._finger_target) > 5e-3
        self._finger_target = finger_goal
        outcome = yield from self._follow(goal)
        if outcome is Outcome.UNREACHABLE and self._finger_target >= FINGER_HALF:
            outcome = yield from self._go_round(goal)
        if outcome is Outcome.REACHED:
            outcome = yield from self._settle(goal, self._limits.grip_ticks if gripper_moves else 0)
        state = self._simulation.arm_state()
        self._leans = outcome is Outcome.STALLED and bool(np.abs(state.qvel).max() < LEANING_SPEED)
        if outcome is not Outcome.REACHED and not self._leans:
            yield from self._relax()
        self.effort = self._stiffness * (self._target - self._simulation.arm_state().qpos)
        self.feedback = replace(self.measured(outcome), is_clipped=self._is_clipped)

    def _checked(self, action: NDArray[np.float32]) -> tuple[Array, float]:
        array = np.asarray(action, dtype=np.float64)
        if array.shape != (ACTION_DIM,) or not np.isfinite(array).all():
            got = f"shape {array.shape}" if array.shape != (ACTION_DIM,) else f"non-finite values {array.tolist()}"
            allowed = f"({ACTION_DIM},) finite numbers: position [m], rotation 6D, gripper"
            raise ConfigurationError(
                "Malformed action.", got=got, allowed=allowed, hint="lerobot_adamanip.contract.rotations.pose_vector"
            )
        goal, gripper = pose_from_vector(array)
        inside = np.clip(goal[:3, 3], self._limits.reach_lower, self._limits.reach_upper)
        self._is_clipped, goal[:3, 3] = not np.array_equal(inside, goal[:3, 3]), inside
        return goal, float(np.clip(gripper, 0.0, 1.0))

    def _follow(self, goal: Array) -> Ticks:
        """Follows a straight line and slerp with a smooth speed profile, from the present pose."""
        limits, start = self._limits, self._kinematics.tcp_in_base(self._target)
        distance = float(np.linalg.norm(goal[:3, 3] - start[:3, 3]))
        angle = angle_between(start[:3, :3], goal[:3, :3])
        seconds = max(
            quintic_duration(distance, limits.linear_speed, limits.linear_acceleration),
            quintic_duration(angle, limits.angular_speed, limits.angular_acceleration),
        )
        ticks = max(1, int(np.ceil(seconds / self._dt)))
        times = [k / ticks for k in range(1, ticks + 1)]
        shares = np.array([t * t * t * (10 - 15 * t + 6 * t * t) for t in times])
        for number, waypoint in enumerate(straight_path(start, goal, shares), 1):
            tolerance = LAST_TOLERANCE if number == ticks else PATH_TOLERANCE
            solution = self._solve(waypoint, tolerance)
            if not solution.within(0.01, 0.06):
                return Outcome.UNREACHABLE
            stalls = self._advance(solution.qpos)
            yield
            if stalls:
                return Outcome.STALLED
            if self._ticks >= limits.max_ticks:
                return Outcome.TIMEOUT
        return Outcome.REACHED

    def _go_round(self, goal: Array) -> Ticks:
        """Moves in joint space to the goal's posture as reached from rest.

        A straight line may move the elbow into a corner from which no straight line leads back. From far left, every
        goal would then be unreachable until the next reset. Only an open hand does this; a closed one may hold a part.
        """
        posture = self._kinematics.canonical(goal)
        folded = np.abs(posture.qpos - self._kinematics.rest).max() > FOLDED
        if folded or not posture.within(0.01, 0.06):
            return Outcome.UNREACHABLE
        for target in joint_path(self._target, posture.qpos, self._limits.joint_speed * self._dt):
            stalls = self._advance(target)
            yield
            if stalls:
                return Outcome.STALLED
            if self._ticks >= self._limits.max_ticks:
                return Outcome.TIMEOUT
        return Outcome.REACHED

    def _settle(self, goal: Array, wait: int) -> Ticks:
        """Waits for the arm, and for ``wait`` ticks for the fingers, to come to rest."""
        state = self._simulation.arm_state()
        for k in range(self._limits.settle_ticks + wait):
            stalls = self._advance(self._target)
            yield
            if stalls:
                return Outcome.STALLED
            state = self._simulation.arm_state()
            if k + 1 >= wait and np.abs(state.qvel).max() < AT_REST:
                break
        actual = self._kinematics.tcp_in_base(state.qpos)
        far = np.linalg.norm(actual[:3, 3] - goal[:3, 3]) > self._limits.reached_position
        turned = angle_between(actual[:3, :3], goal[:3, :3]) > self._limits.reached_rotation
        return Outcome.STALLED if far or turned else Outcome.REACHED

    def _relax(self) -> Iterator[None]:
        """Releases strain: sets the targets to the present joint positions."""
        for _ in range(RELAX_TICKS):
            self._target = self._simulation.arm_state().qpos.copy()
            self._tick(self._target, np.zeros(NUM_ARM_JOINTS))
            yield

    def _solve(self, waypoint: Array, tolerance: float) -> IKResult:
        """Returns a posture near the present target for a pose (4, 4); searches longer if a short search fails."""
        solution = self._kinematics.solve(waypoint, self._target, iterations=15, tolerance=tolerance)
        if solution.within(5e-3, 0.03):
            return solution
        return self._kinematics.solve(waypoint, self._target, iterations=80)

    # Control ticks --------------------------------------------------------------------------------------------------

    def _advance(self, target: Array) -> bool:
        """Runs one control tick towards ``target``; True once the arm has lagged long enough to count as stalled.

        The tool lags if it is farther behind its target than inertia explains.
        """
        velocity = (target - self._target) / self._dt
        self._target = target
        self._tick(target, velocity)
        commanded = self._kinematics.tcp_in_base(target)
        actual = self._kinematics.tcp_in_base(self._simulation.arm_state().qpos)
        x, y, z = (commanded[:3, 3] - actual[:3, 3]).tolist()
        # For two rotations at an angle, the trace of one's inverse times the other is 1 + 2 cos(angle).
        lags = x * x + y * y + z * z > self._limits.stall_position**2 or (
            float(np.vdot(commanded[:3, :3], actual[:3, :3])) < 1.0 + 2.0 * math.cos(self._limits.stall_rotation)
        )
        self._strained = self._strained + 1 if lags else 0
        return self._strained >= self._limits.stall_ticks

    def _tick(self, target: Array, velocity: Array) -> None:
        """Runs one control tick; limits the speed of the finger target."""
        step = self._limits.finger_speed * self._dt
        self._finger += float(np.clip(self._finger_target - self._finger, -step, step))
        self._simulation.tick(target, velocity, self._finger)
        self._ticks += 1

    # Streams --------------------------------------------------------------------------------------------------------

    def follow_target(self, action: NDArray[np.float32]) -> None:
        """Sets the target to an action (10,). `stream_tick` then approaches it.

        Raises:
            ConfigurationError: the action has the wrong shape or is not finite.
        """
        goal, gripper = self._checked(action)
        self._start_stream(gripper)
        self._stream, self._joint_goal, self.goal = goal, None, (goal, gripper)

    def follow_joints(self, qpos: Array, gripper: float) -> None:
        """Sets the target to joint positions (7,) [rad] within the arm's limits, and a gripper opening."""
        gripper = float(np.clip(gripper, 0.0, 1.0))
        self._start_stream(gripper)
        target = self._kinematics.inside(qpos)
        self._is_clipped = not np.allclose(target, qpos)
        self._joint_goal = target
        self._stream = self._kinematics.tcp_in_base(target)
        self.goal = self._stream, gripper

    def _start_stream(self, gripper: float) -> None:
        if self._stream is None:
            if self._leans:  # a stalled key frame ends under strain
                self._target, self._leans = self._simulation.arm_state().qpos.copy(), False
            self._strained = 0
        self._finger_target = FINGER_CLOSED + (FINGER_OPEN - FINGER_CLOSED) * gripper
        self._holding = False

    def hold(self) -> None:
        """Stops following: the arm decelerates and stays. The fingers continue."""
        self._holding = True

    def stream_tick(self) -> None:
        """Advances one control tick towards the target. Without a target the arm stays."""
        if self._joint_goal is not None and not self._holding:
            self.stalled = self._advance(self._next_joints(self._joint_goal))
        else:
            before = self._kinematics.tcp_in_base(self._target)
            goal = before if self._stream is None or self._holding else self._stream
            lag = pose_error(self._kinematics.tcp_in_base(self._simulation.arm_state().qpos), before)
            waypoint, velocity = self._next_waypoint(before, goal)
            if self.stalled and self._is_farther(waypoint, lag):
                waypoint, velocity = before, np.zeros(6)
            self._velocity = velocity
            self.stalled = self._advance(self._posture(waypoint, before) if velocity.any() else self._target)
        self.effort = self._stiffness * (self._target - self._simulation.arm_state().qpos)
        self.feedback = replace(self.measured(), is_clipped=self._is_clipped)

    def _next_joints(self, goal: Array) -> Array:
        """Returns the next joint targets (7,) on the way to ``goal`` (7,), within the limits of a stream.

        After a stall the tool's lag does not grow, as in a stream of poses.
        """
        left = goal - self._target
        largest = float(np.abs(left).max())
        speed = min(STREAM_JOINT_SPEED, _braking_speed(largest, BRAKING * STREAM_JOINT_ACCELERATION))
        aim = left * (speed / largest) if largest > 0 else np.zeros(NUM_ARM_JOINTS)
        bound = STREAM_JOINT_ACCELERATION * self._dt
        velocity = self._joint_velocity + np.clip(aim - self._joint_velocity, -bound, bound)
        if self.stalled:
            actual = self._kinematics.tcp_in_base(self._simulation.arm_state().qpos)
            lag = pose_error(actual, self._kinematics.tcp_in_base(self._target))
            if self._is_farther(self._kinematics.tcp_in_base(self._target + velocity * self._dt), lag):
                velocity = np.zeros(NUM_ARM_JOINTS)
        self._joint_velocity = velocity
        return self._target + velocity * self._dt

    def posture(self, pose: Array) -> Array:
        """Returns the joint positions (7,) [rad] of a tool pose (4, 4) near the present ones."""
        return self._kinematics.solve(pose, self._simulation.arm_state().qpos, iterations=80).qpos

    @property
    def is_at_rest(self) -> bool:
        """Whether the arm's joints stand still."""
        return bool(np.abs(self._simulation.arm_state().qvel).max() < AT_REST)

    def end_stream(self) -> None:
        """Drops the target. The next target or key frame starts at the arm's current pose."""
        is_slow = bool(np.abs(self._simulation.arm_state().qvel).max() < LEANING_SPEED)
        self._leans = self.stalled and is_slow
        self._stream, self._joint_goal, self._stuck, self._velocity = None, None, 0, np.zeros(6)
        self._joint_velocity = np.zeros(NUM_ARM_JOINTS)
        self._holding = self.stalled = self.unreachable = False

    def break_off(self) -> None:
        """Decelerates from the current speed after an aborted key frame."""
        state = self._simulation.arm_state()
        self.end_stream()
        self._leans = False
        turn = self._kinematics.tcp_in_base(state.qpos)[:3, :3]
        twist = self._kinematics.body_jacobian(state.qpos) @ state.qvel
        self._velocity = np.concatenate([turn @ twist[:3], twist[3:]])

    def _next_waypoint(self, commanded: Array, goal: Array) -> tuple[Array, Array]:
        """Returns the next commanded pose (4, 4) and its velocity (6,): [m/s, base frame], [rad/s, tool frame]."""
        limits, left = self._limits, pose_error(commanded, goal)
        left[:3] = goal[:3, 3] - commanded[:3, 3]
        velocity = np.empty(6)
        for part, speed, acceleration in (
            (slice(0, 3), limits.linear_speed, limits.linear_acceleration),
            (slice(3, 6), limits.angular_speed, limits.angular_acceleration),
        ):
            distance = math.sqrt(float(left[part] @ left[part]))
            wanted = min(speed, _braking_speed(distance, BRAKING * acceleration))
            aim = left[part] * (wanted / distance) if distance > 0 else np.zeros(3)
            change = aim - self._velocity[part]
            size, largest = math.sqrt(float(change @ change)), acceleration * self._dt
            velocity[part] = aim if size <= largest else self._velocity[part] + change * (largest / size)
        waypoint = commanded.copy()
        waypoint[:3, 3] += velocity[:3] * self._dt
        waypoint[:3, :3] = commanded[:3, :3] @ matrix_from_rotation_vector(velocity[3:] * self._dt)
        return waypoint, velocity

    def _is_farther(self, waypoint: Array, lag: Array) -> bool:
        """Returns whether the strained part of the lag would be larger at ``waypoint`` (4, 4) than ``lag`` (6,)."""
        actual, limits = self._kinematics.tcp_in_base(self._simulation.arm_state().qpos), self._limits
        lags = (pose_error(actual, waypoint), lag)
        far = [np.linalg.norm(twist[:3]) / limits.stall_position for twist in lags]
        turned = [np.linalg.norm(twist[3:]) / limits.stall_rotation for twist in lags]
        return bool(max(far[0], turned[0]) > max(far[1], turned[1]))

    def _posture(self, waypoint: Array, commanded: Array) -> Array:
        """Returns joint positions (7,) [rad] of a commanded pose, or the current ones without a nearby solution."""
        solution = self._solve(waypoint, PATH_TOLERANCE)
        follows = solution.within(0.01, 0.06)
        error = pose_error(commanded, waypoint)
        covered = pose_error(commanded, self._kinematics.tcp_in_base(solution.qpos))
        moves = error @ error > PATH_TOLERANCE**2  # less than that is not solved for
        self._stuck = self._stuck + 1 if not follows or (moves and covered @ error < FOLLOWS * (error @ error)) else 0
        self.unreachable = self._stuck >= self._limits.stall_ticks
        if not follows:
            self._velocity = np.zeros(6)
        return solution.qpos if follows else self._target


def _braking_speed(distance: float, deceleration: float) -> float:
    """Returns the speed that comes to rest within ``distance``, with constant deceleration and a gentle end."""
    gentle = deceleration * SETTLING**2
    if distance < gentle:
        return distance / SETTLING
    return math.sqrt(2 * deceleration * (distance - gentle / 2))
