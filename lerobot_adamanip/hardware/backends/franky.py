"""Backend of the real arm with `franky-control` 2: firmware impedance control, within the limits of our own table.

The 1 kHz control loop is a C++ thread of franky. This backend sends it motions and reads its states.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Outcome
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.hardware.arm import ArmReading, ArmTarget, Array, Served
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox
from lerobot_adamanip.hardware.backends.franky_options import PERIOD, ROTATIONAL_STIFFNESS, STALL_TORQUE, FrankyOptions
from lerobot_adamanip.hardware.backends.franky_sdk import (
    check_joints,
    check_tool_frame,
    connect_robot,
    flags_of,
    import_franky,
    reading_of,
    scaled_limits,
    set_limits,
)
from lerobot_adamanip.hardware.backends.gripper import FrankyHand, GripperThread
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_adamanip.util.errors import RobotError

SETTLE_S, SETTLED_M, SETTLED_RAD, REST_SPEED = 0.5, 0.002, 0.01, 0.01
"""Time for the arm to reach a target that no longer moves; errors and joint speed [rad/s] below which it ends early."""
GENTLE_FACTOR, GENTLE_S = 0.5, 10.0
"""Fraction of the dynamics after a recovery, and its duration on the arm's clock."""
LEANING_M, LEANING_RAD = 0.01, 0.01
"""Lag of an arm that presses on something. The next key frame first releases it."""
NO_MOTION = 5e-4
"""Distance below which a goal needs no motion [m, rad]."""
SAME_TARGET = 5e-5
"""Distance below which streamed targets are equal [m, rad]."""
RECOVERY_S, STOP_S = 0.5, 1.0
"""Maximum waits: for a state without errors, and for a stop when closing."""


class OutcomeWatch:
    """Determines the outcome of one key frame, tick by tick.

    An arm with stiffness K lags F / K behind its target under a force F. So force and stiffness give the lag of a
    stall.

    Args:
        goal_in_base: (4, 4) goal of the tool.
        options: force and stiffness for the stall test.
        began: start time on the arm's own clock [s].
        time_limit: time limit of the motion [s].
        leaning: whether the arm still presses on something, and first releases it: that is no stall.
    """

    def __init__(
        self, goal_in_base: Array, options: FrankyOptions, began: float, time_limit: float, leaning: bool = False
    ) -> None:
        self._goal = goal_in_base
        self._stall_lag = options.stall_force / options.stiffness
        self._stall_turn = STALL_TORQUE / ROTATIONAL_STIFFNESS
        self._until, self._strained_ticks, self._releases = began + time_limit, 0, leaning
        self._arrived: float | None = None

    def look(
        self, tcp_in_base: Array, desired_in_base: Array, *, running: bool, speed: float, now: float
    ) -> Outcome | None:
        """Returns the outcome; None during the motion.

        Args:
            tcp_in_base: (4, 4) measured pose.
            desired_in_base: (4, 4) current target of the controller.
            running: whether that target still changes.
            speed: speed of the fastest joint [rad/s].
            now: time on the arm's own clock [s].
        """
        lag, turned = pose_error(tcp_in_base, desired_in_base)
        is_strained = lag > self._stall_lag or turned > self._stall_turn
        self._releases = self._releases and is_strained
        self._strained_ticks = self._strained_ticks + 1 if is_strained and not self._releases else 0
        if self._strained_ticks >= DEFAULT_MOTION.stall_ticks:
            return Outcome.STALLED
        if now > self._until:
            return Outcome.TIMEOUT
        if running:
            self._arrived = None
            return None
        self._arrived = now if self._arrived is None else self._arrived
        distance, angle = pose_error(tcp_in_base, self._goal)
        is_settled = distance < SETTLED_M and angle < SETTLED_RAD and speed < REST_SPEED
        if not is_settled and now - self._arrived < SETTLE_S:
            return None
        is_reached = distance <= DEFAULT_MOTION.reached_position and angle <= DEFAULT_MOTION.reached_rotation
        return Outcome.REACHED if is_reached else Outcome.STALLED


class FrankyBackend:
    """An `ArmBackend` on one `franky.Robot`. It cannot be used after a lost connection."""

    period = PERIOD

    def __init__(self, options: FrankyOptions) -> None:
        self._options = options
        self._robot: Any = None
        self._franky: Any = None
        self._hand: GripperThread | None = None
        self._state: Any = None
        self._lost = ""
        self._watch: OutcomeWatch | None = None
        self._outcome: Outcome | None = None
        self._ending: Outcome | None = None
        self._streamed: Array | None = None
        self._goal_opening = 1.0
        self._gentle_until = -1.0

    # Connection ------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Connects, checks the tool frame, sets limits, impedance and thresholds. Raises `RobotError`."""
        self._franky = import_franky()
        self._robot = connect_robot(self._franky, self._options)
        try:
            self._state = self._robot.state
            check_tool_frame(self._state)
            set_limits(self._robot, self._options)
            self._robot.set_cartesian_impedance([self._options.stiffness] * 3 + [ROTATIONAL_STIFFNESS] * 3)
            if self._options.gripper:
                self._hand = GripperThread(lambda: FrankyHand(self._options.address, self._options.grasp_force))
                self._hand.start()
        except RobotError:
            raise
        except Exception as error:
            raise RobotError(f"The arm was connected but could not be configured: {error}") from None
        check_joints(self._state.q, self._options)

    def close(self) -> None:
        """Stops the arm, ends the gripper thread and disconnects. Idempotent; never raises."""
        robot, self._robot = self._robot, None
        if robot is not None and not self._lost:
            with contextlib.suppress(Exception):
                if robot.is_in_control:
                    robot.move(self._franky.CartesianStopMotion(), asynchronous=True)
                    robot.join_motion(STOP_S)
        if self._hand is not None:
            self._hand.close()

    # States ----------------------------------------------------------------------------------------------------------

    def read(self) -> ArmReading:
        """Returns the state. Raises `RobotError` if the connection is lost."""
        self._state = self._ask(lambda: self._robot.state)
        opening = 1.0 if self._hand is None else self._hand.opening
        return reading_of(self._state, opening, self._options.effort_sign, self._outcome)

    def tick(self) -> None:
        """Updates the key frame's outcome. Raises `RobotError` if the motion was aborted or the gripper failed."""
        if self._hand is not None:
            self._hand.check()
        # Raises the error that ended a motion. In franky 2.0.0 its return value is inverted, so it is not used.
        self._ask(self._robot.poll_motion)
        running = bool(self._ask(lambda: self._robot.is_in_control))
        if self._watch is None:
            if self._ending is not None and not running and not (self._hand is not None and self._hand.busy):
                self._outcome, self._ending = self._ending, None
            return
        self._state = state = self._ask(lambda: self._robot.state)
        self._ending = self._watch.look(
            np.array(state.O_T_EE.matrix),
            np.array(state.O_T_EE_d.matrix),
            running=running,
            speed=float(np.abs(state.dq).max()),
            now=state.time.to_msec() / 1000.0,
        )
        if self._ending is not None:
            self._watch = None
            if running:
                self._move(self._franky.CartesianStopMotion())
            self._grip()

    # Motions ---------------------------------------------------------------------------------------------------------

    def stream(self, target: ArmTarget) -> None:
        """Replaces the target of a motion that holds its end. Returns at once. Raises `RobotError`."""
        goal, self._goal_opening = pose_from_vector(target.pose)
        streamed = self._streamed
        self._forget()
        # franky plans from a state that is some milliseconds old. Replanning at 30 Hz makes a braking arm overshoot by
        # half of the braking distance. So a target that does not move keeps its motion.
        rests = streamed is not None and max(pose_error(streamed, goal)) < SAME_TARGET
        if not (rests and self._ask(lambda: self._robot.is_in_control)):
            self._move(
                self._franky.CartesianMotion(
                    self._franky.Affine(goal), relative_dynamics_factor=self._pace, return_when_finished=False
                )
            )
            streamed = goal
        self._streamed = streamed
        self._grip()

    def begin_keyframe(self, target: ArmTarget) -> None:
        """Starts a motion to the target, then the gripper's. Raises `RobotError`."""
        goal, _ = pose_from_vector(target.pose)
        self._forget()
        self._goal_opening = float(target.pose[GRIPPER_DIM])
        state = self._state
        here, now = np.array(state.O_T_EE.matrix), state.time.to_msec() / 1000.0
        lag, turned = pose_error(here, np.array(state.O_T_EE_d.matrix))
        leaning = lag > LEANING_M or turned > LEANING_RAD
        ways = [here, goal] if leaning else [goal]
        way, turn = pose_error(here, goal)
        maxima = scaled_limits(self._options)
        speed, angular_speed = (maxima[f"{name}_velocity_limit"][0] for name in ("translation", "rotation"))
        travel_s = (way / speed + turn / angular_speed) / self._pace
        self._watch = OutcomeWatch(goal, self._options, now, 3.0 + 2.0 * travel_s, leaning)
        if not leaning and max(way, turn) < NO_MOTION:
            return  # only the fingers move
        points = [self._franky.CartesianWaypoint(self._franky.Affine(pose)) for pose in ways]
        self._move(self._franky.CartesianWaypointMotion(points, relative_dynamics_factor=self._pace))

    @property
    def _pace(self) -> float:
        gentle = self._state.time.to_msec() / 1000.0 < self._gentle_until
        return GENTLE_FACTOR if gentle else 1.0

    def _forget(self) -> None:
        self._watch = self._outcome = self._ending = self._streamed = None

    def _grip(self) -> None:
        if self._hand is not None:
            self._hand.want(self._goal_opening)

    def stop(self) -> None:
        """Decelerates within the limits and holds. Raises `RobotError` if the arm refuses."""
        self._watch = self._ending = self._streamed = None
        if self._robot is not None and not self._lost and self._ask(lambda: self._robot.is_in_control):
            self._move(self._franky.CartesianStopMotion())

    def recover(self) -> None:
        """Clears a reflex. The next motions are slower. Raises `RobotError` if the arm does not recover."""
        self._forget()
        if self._hand is not None:
            self._hand.forgive()
        with contextlib.suppress(Exception):  # the exception of the aborted motion, raised once
            self._robot.poll_motion()
        recovered = bool(self._ask(self._robot.recover_from_errors))
        self._state = self._ask(lambda: self._robot.state)
        # franky may use a state from before the arm's answer.
        end = time.perf_counter() + RECOVERY_S
        while not recovered and time.perf_counter() < end:
            self._state = self._ask(lambda: self._robot.state)
            recovered = not flags_of(self._state.current_errors)
        if not recovered:
            raise RobotError("The arm did not recover from its errors: check it in Desk.")
        self._gentle_until = self._state.time.to_msec() / 1000.0 + GENTLE_S

    # Franky's errors -------------------------------------------------------------------------------------------------

    def _move(self, motion: Any) -> None:
        self._ask(lambda: self._robot.move(motion, asynchronous=True))

    def _ask(self, call: Callable[[], Any]) -> Any:
        """Calls franky and translates its errors. A lost connection stays lost."""
        if self._lost:
            raise RobotError(self._lost)
        try:
            return call()
        except self._franky.ControlException as error:
            raise RobotError(f"The arm aborted the motion: {self._flags() or error}") from None
        except (self._franky.NetworkException, RuntimeError) as error:
            self._lost = f"The connection to the arm at {self._options.address} is lost: {error}"
            raise RobotError(self._lost) from None
        except Exception as error:
            raise RobotError(f"The arm refused a motion: {type(error).__name__}: {error}") from None

    def _flags(self) -> str:
        with contextlib.suppress(Exception):
            state = self._robot.state
            return ", ".join(flags_of(state.current_errors) or flags_of(state.last_motion_errors))
        return ""


def serve_franky(options: FrankyOptions, _: Mapping[str, Mailbox]) -> Served:
    """Returns the backend of the real arm, see `BackendFactory`."""
    return Served(FrankyBackend(options))
