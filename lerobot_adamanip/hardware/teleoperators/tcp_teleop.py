"""A teleoperator of the tool: integrates one absolute goal, anchored where the arm is, through the robot's filter."""

from __future__ import annotations

import abc
import time
from collections.abc import Callable
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator

from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, pose_from_vector, pose_vector
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSE_NAMES
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, OPERATOR_SUCCESS, RESET_WANTED, ROBOTS, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter
from lerobot_adamanip.hardware.safety_limits import SafetyLimits
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.hardware.teleoperators.config_tcp_teleop import TcpTeleopConfig
from lerobot_adamanip.hardware.teleoperators.jog import JogDevice
from lerobot_adamanip.util.errors import RobotError

FORGOTTEN = 1.0
"""A teleoperator that was not asked for so long anchors anew [s]: the arm may be elsewhere by now."""


class TcpTeleop(Teleoperator):
    """Drives one absolute tool goal. What it returns has passed the robot's `SafetyFilter`, which changes it no more.

    The goal begins at the measured pose of the first reading that is newer than the latest reset, and does so again
    when an episode begins or is given up, and after a second without calls. LeRobot connects a teleoperator before
    the robot and shows it no observation: all that it knows of the arm stands on the `RobotRegistry`.

    Args:
        config: see `TcpTeleopConfig`.
        clock: returns seconds.
    """

    config_class = TcpTeleopConfig
    name = "adamanip_tcp"

    def __init__(self, config: TcpTeleopConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config)
        self.config, self._clock = config, clock
        self._connected = False
        self._filter: SafetyFilter | None = None
        self._session: RobotSession | None = None
        self._episode = -1
        self._anchored_after = self._called = float("-inf")

    # LeRobot's teleoperator -------------------------------------------------------------------------------------------

    @property
    def action_features(self) -> dict[str, type]:
        """The contract's action: tool pose and gripper."""
        return dict.fromkeys(POSE_NAMES, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether the device is open."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Nothing to calibrate."""
        return True

    def calibrate(self) -> None:
        """Nothing to calibrate."""

    def configure(self) -> None:
        """Nothing to configure."""

    def connect(self, calibrate: bool = True) -> None:
        """Opens the device; raises `RobotError` where it, or its SDK, is missing."""
        if self._connected:
            raise RobotError(f"Teleoperator {self.name} is connected already.")
        self._open()
        self._connected = True
        self.reset()

    def disconnect(self) -> None:
        """Closes the device; idempotent."""
        if self._connected:
            self._connected = False
            self._close()

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Takes none."""

    def get_action(self) -> dict[str, float]:
        """Returns the goal by name, see `schema.POSE_NAMES`.

        Raises:
            RobotError: it is not connected, no robot has told a reading yet, or the device has failed.
        """
        session, reading = self._robot()
        now = self._clock()
        dt = self._passed(session, now)
        self._called = now
        if self._filter is None:
            if not self._anchored(session, reading):
                return _named(pose_vector(reading.tcp_in_base, reading.gripper))
            dt = 0.0  # the robot, too, counts no time before its first target: both filters go on in step
        return _named(self._advance(session, reading, dt))

    # The goal --------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Anchors anew at the next reading."""
        self._filter, self._anchored_after = None, self._clock()

    @property
    def goal(self) -> Target | None:
        """(10,) the goal as it was let through; None before it is anchored."""
        return None if self._filter is None else self._filter.last

    def _robot(self) -> tuple[RobotSession, ArmReading]:
        if not self._connected:
            raise RobotError(f"Teleoperator {self.name} is not connected.")
        session = ROBOTS.find(self.config.robot_id)
        if session is None or session.reading is None:
            raise RobotError(
                f"Teleoperator {self.name} knows no robot.",
                got=f"robot_id={self.config.robot_id!r}",
                allowed="a connected robot of this plugin, which has been observed once",
                hint="--robot.type=adamanip_franka or adamanip_franka_sim; with several robots --teleop.robot_id=ID",
            )
        return session, session.reading

    def _passed(self, session: RobotSession, now: float) -> float:
        """Returns the time since the last call [s]; anchors anew where it was long, or an episode has begun."""
        step = session.details.get(LOCKSTEP_DT)
        dt = now - self._called if step is None else float(step)  # where time passes by steps, no call is late
        begun = session is not self._session or session.episodes != self._episode
        if begun or dt > FORGOTTEN:
            self._session, self._episode = session, session.episodes
            self._filter = None
            self._anchored_after = float("-inf") if begun else self._anchored_after
            self._begin(session, new_episode=begun)
        return min(dt, FORGOTTEN)

    def _anchored(self, session: RobotSession, reading: ArmReading) -> bool:
        if reading.stamp > self._anchored_after:
            self._anchor(session, reading)
        return self._filter is not None

    def _anchor(self, session: RobotSession, reading: ArmReading) -> None:
        limits = session.safety
        if not isinstance(limits, SafetyLimits):
            raise RobotError("The robot tells no safety limits.", got=type(limits).__name__, allowed="SafetyLimits")
        self._filter = SafetyFilter(limits)
        self._filter.anchor(reading.tcp_in_base, reading.gripper)

    def _to(self, wanted: Target, reading: ArmReading, dt: float) -> Target:
        """Moves the goal towards a target (10,), as far as the robot would let it."""
        assert self._filter is not None
        return self._filter.stream(wanted, reading.tcp_in_base, dt)

    # What a kind of teleoperator does --------------------------------------------------------------------------------

    @abc.abstractmethod
    def _open(self) -> None:
        """Opens the device. Raises `RobotError`."""

    @abc.abstractmethod
    def _close(self) -> None:
        """Closes it; idempotent."""

    @abc.abstractmethod
    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        """Returns the next goal (10,), ``dt`` [s] after the last one; it goes through `_to`."""

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        """Called before the goal is anchored anew."""


class JogTeleop(TcpTeleop):
    """Integrates what a hand-held device asks for.

    Args:
        config: see `TcpTeleopConfig`.
        device: the device.
        clock: returns seconds.
    """

    def __init__(
        self, config: TcpTeleopConfig, device: JogDevice, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        super().__init__(config, clock)
        self._device, self._driving, self._gripper = device, False, 1.0

    def _open(self) -> None:
        self._device.open()

    def _close(self) -> None:
        self._device.close()

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        self._driving = False
        if new_episode:
            session.details.pop(OPERATOR_SUCCESS, None)

    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        jog = self._device.read()
        if jog.success:
            session.details[OPERATOR_SUCCESS] = True
        if jog.reset:
            session.details[RESET_WANTED] = True
        assert self._filter is not None
        if jog.clutch and not self._driving:
            held = self._filter.last
            self._filter.anchor(reading.tcp_in_base, reading.gripper if held is None else float(held[GRIPPER_DIM]))
            dt = 0.0  # what was asked before the clutch closed moves nothing
        self._driving = jog.clutch
        last = self._filter.last
        assert last is not None
        pose, gripper = pose_from_vector(last)
        if jog.clutch:
            shift, turn = jog.shift * (self.config.speed * dt), jog.turn * (self.config.angular_speed * dt)
            pose[:3, 3] += shift
            pose[:3, :3] = matrix_from_rotation_vector(turn) @ pose[:3, :3]
        if jog.gripper is not None:
            gripper = jog.gripper
        elif jog.toggle:
            gripper = 0.0 if gripper > 0.5 else 1.0
        still = not jog.clutch or not (jog.shift.any() or jog.turn.any())
        wanted = last.copy() if still else pose_vector(pose, gripper)
        wanted[GRIPPER_DIM] = gripper
        return self._to(wanted, reading, dt)


def _named(target: Target) -> dict[str, float]:
    return dict(zip(POSE_NAMES, target.tolist(), strict=True))
