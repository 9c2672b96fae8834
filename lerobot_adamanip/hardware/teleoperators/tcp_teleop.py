"""Base class of the teleoperators: one absolute tool goal that starts at the measured pose and passes the filter."""

from __future__ import annotations

import abc
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from lerobot.teleoperators.teleoperator import Teleoperator

from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA
from lerobot_adamanip.contract.rotations import Array, matrix_from_rotation_vector, pose_from_vector, pose_vector
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.closing import closing_on_error
from lerobot_adamanip.hardware.dense_kinds import encode_action
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, OPERATOR_SUCCESS, RESET_WANTED, ROBOTS, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.hardware.teleoperators.config_devices import TcpTeleopConfig
from lerobot_adamanip.util.errors import RobotError

MAX_PAUSE_S = 1.0
"""Maximum pause between calls [s]. After a longer one the goal is anchored again, since the arm may have moved."""


class TcpTeleop(Teleoperator):
    """Drives one absolute tool goal. Returned goals have passed the `SafetyFilter`, so the robot does not change them.

    The goal is anchored at the measured pose after a reset, when an episode starts or is abandoned, and after a second
    without calls. The gripper stays as last commanded, since fingers that hold a wide part are measured as open.
    LeRobot passes a teleoperator no observation, so it reads the `RobotRegistry`.

    Args:
        config: see `TcpTeleopConfig`.
        clock: returns the time [s].
    """

    config_class = TcpTeleopConfig
    name = "adamanip_tcp"
    feedback_features: ClassVar[dict[str, type]] = {}
    is_calibrated, is_connected = True, False

    def __init__(self, config: TcpTeleopConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config)
        self.config, self._clock = config, clock
        self._filter: SafetyFilter | None = None
        self._session: RobotSession | None = None
        self._episode = -1
        self._anchored_after = self._called = float("-inf")

    @property
    def action_features(self) -> dict[str, type]:
        """Action of the robot's kind, see `contract.control.ACTION_NAMES`."""
        session = ROBOTS.find(self.config.robot_id)
        return dict.fromkeys(ACTION_NAMES[session.action if session else EE_DELTA], float)

    # LeRobot's teleoperator -------------------------------------------------------------------------------------------

    def calibrate(self) -> None:
        """Does nothing: there is nothing to calibrate."""

    def configure(self) -> None:
        """Does nothing: there is nothing to configure."""

    def connect(self, calibrate: bool = True) -> None:
        """Opens the device. Raises `RobotError` if the device or its SDK is missing."""
        if self.is_connected:
            raise RobotError(f"Teleoperator {self.name} is connected already.")
        with closing_on_error(self._close):
            self._open()
        self.is_connected = True
        self.reset()

    def disconnect(self) -> None:
        """Closes the device. Idempotent."""
        if self.is_connected:
            self.is_connected = False
            self._close()

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Does nothing: the devices have no feedback."""

    def get_action(self) -> dict[str, float]:
        """Returns the action of the robot's kind that leads from the observed pose to the goal.

        This is what a policy would have to predict at this observation, so recordings store it.

        Raises:
            RobotError: not connected, no robot has been observed yet, or the device has failed.
        """
        session, reading = self._robot()
        now = self._clock()
        dt = self._passed(session, now)
        self._called = now
        if self._filter is None:
            gripper = reading.gripper if session.sent is None else float(session.sent[GRIPPER_DIM])
            if session.safety is None or reading.stamp <= self._anchored_after:
                start = pose_vector(reading.tcp_in_base, gripper)
                return encode_action(session.action, start, reading)
            self._filter = SafetyFilter(session.safety)
            self._filter.anchor(reading.tcp_in_base, gripper)
            dt = 0.0  # the robot also counts no time before its first target, so both filters stay equal
        return encode_action(session.action, self._advance(session, reading, dt), reading)

    # The goal --------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Anchors the goal at the next reading."""
        self._filter, self._anchored_after = None, self._clock()

    def _robot(self) -> tuple[RobotSession, ArmReading]:
        if not self.is_connected:
            raise RobotError(f"Teleoperator {self.name} is not connected.")
        session = ROBOTS.find(self.config.robot_id)
        if session is None or session.reading is None:
            raise RobotError(
                f"Teleoperator {self.name} finds no robot.",
                got=f"robot_id={self.config.robot_id!r}",
                allowed="a connected robot of this plugin that has been observed once",
                hint="--robot.type=adamanip_franka or adamanip_franka_sim; with several robots --teleop.robot_id=ID",
            )
        return session, session.reading

    def _passed(self, session: RobotSession, now: float) -> float:
        """Returns the time since the last call [s]. Drops the anchor after a long pause or at a new episode."""
        step = session.details.get(LOCKSTEP_DT)
        dt = now - self._called if step is None else float(step)  # in lockstep no call is late
        is_new = session is not self._session or session.episodes != self._episode
        if is_new or dt > MAX_PAUSE_S:
            self._session, self._episode = session, session.episodes
            self._filter = None
            self._anchored_after = float("-inf") if is_new else self._anchored_after
            self._begin(session, new_episode=is_new)
        return min(dt, MAX_PAUSE_S)

    def _to(self, target: Target, reading: ArmReading, dt: float) -> Target:
        """Moves the goal towards a target (10,), within the robot's limits."""
        assert self._filter is not None
        return self._filter.stream(target, reading.tcp_in_base, dt)

    # Subclasses ------------------------------------------------------------------------------------------------------

    def _open(self) -> None:
        """Opens the device, if any. Raises `RobotError`; then `_close` is called."""

    def _close(self) -> None:
        """Closes the device, if any. Idempotent."""

    @abc.abstractmethod
    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        """Returns the next goal (10,) from `_to`, ``dt`` [s] after the last one."""

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        """Prepares a new anchor. Called before the goal is anchored."""


@dataclass(frozen=True)
class Jog:
    """One reading of a device.

    Attributes:
        shift: (3,) deflection along the base frame's axes, -1 ... 1 each, multiplied by the teleoperator's speed.
        turn: (3,) deflection about these axes, -1 ... 1 each, multiplied by its angular speed.
        toggle: whether to open a closed gripper or close an open one.
        clutch: whether the device drives. While False the goal stays; True anchors it at the measured pose.
        success: whether the operator marks the task as done.
        reset: whether the operator requests a reset of a twin's scene.
    """

    shift: Array = field(default_factory=lambda: np.zeros(3))
    turn: Array = field(default_factory=lambda: np.zeros(3))
    toggle: bool = False
    clutch: bool = True
    success: bool = False
    reset: bool = False


def dead_zone(values: Array, width: float) -> Array:
    """Returns deflections (N,) that are zero below ``width`` and rise continuously to 1."""
    size = np.minimum(np.abs(values), 1.0)
    return np.asarray(np.sign(values) * np.maximum(size - width, 0.0) / (1.0 - width))


class JogTeleop(TcpTeleop):
    """Integrates the deflections that `_read` returns.

    The success key marks all further actions, until the goal is anchored anew at an episode or after a pause.
    """

    _driving = _succeeded = False

    @abc.abstractmethod
    def _read(self) -> Jog:
        """Returns the current deflections. Reports each key press once. Never waits. Raises `RobotError`."""

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        self._driving = self._succeeded = False

    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        jog = self._read()
        self._succeeded |= jog.success
        session.details[OPERATOR_SUCCESS] = self._succeeded
        if jog.reset:
            session.details[RESET_WANTED] = True
        assert self._filter is not None
        if jog.clutch and not self._driving:
            last = self._filter.last
            self._filter.anchor(reading.tcp_in_base, reading.gripper if last is None else float(last[GRIPPER_DIM]))
            dt = 0.0  # deflections from before the clutch was held cause no motion
        self._driving = jog.clutch
        last = self._filter.last
        assert last is not None
        pose, gripper = pose_from_vector(last)
        is_still = not jog.clutch or not (jog.shift.any() or jog.turn.any())
        if jog.toggle:
            gripper = 0.0 if gripper > 0.5 else 1.0
        if jog.clutch:
            pose[:3, 3] += jog.shift * (self.config.speed * dt)
            pose[:3, :3] = matrix_from_rotation_vector(jog.turn * (self.config.angular_speed * dt)) @ pose[:3, :3]
        target = last.copy() if is_still else pose_vector(pose, gripper)
        target[GRIPPER_DIM] = gripper
        return self._to(target, reading, dt)
