"""Base of the teleoperators: one absolute tool goal, anchored at the measured pose, through the robot's filter."""

from __future__ import annotations

import abc
import time
from collections.abc import Callable
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator

from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, ROBOTS, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.hardware.teleoperators.config_devices import TcpTeleopConfig
from lerobot_adamanip.util.errors import RobotError

MAX_PAUSE_S = 1.0
"""After a longer pause between calls the goal is anchored again: the arm may be elsewhere."""


class TcpTeleop(Teleoperator):
    """Drives one absolute tool goal. Returned goals have passed the robot's `SafetyFilter`, which changes them no more.

    The goal is anchored at the measured pose of the first reading after a reset, when an episode begins or is given up,
    and after a second without calls. LeRobot shows a teleoperator no observation: it reads the `RobotRegistry`.

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
            RobotError: it is not connected, no robot was observed yet, or the device has failed.
        """
        session, reading = self._robot()
        now = self._clock()
        dt = self._passed(session, now)
        self._called = now
        if self._filter is None:
            if session.safety is None or reading.stamp <= self._anchored_after:
                return _named(pose_vector(reading.tcp_in_base, reading.gripper))
            self._filter = SafetyFilter(session.safety)
            self._filter.anchor(reading.tcp_in_base, reading.gripper)
            dt = 0.0  # the robot, too, counts no time before its first target: both filters go on in step
        return _named(self._advance(session, reading, dt))

    # The goal --------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Anchors the goal at the next reading."""
        self._filter, self._anchored_after = None, self._clock()

    def _robot(self) -> tuple[RobotSession, ArmReading]:
        if not self._connected:
            raise RobotError(f"Teleoperator {self.name} is not connected.")
        session = ROBOTS.find(self.config.robot_id)
        if session is None or session.reading is None:
            raise RobotError(
                f"Teleoperator {self.name} finds no robot.",
                got=f"robot_id={self.config.robot_id!r}",
                allowed="a connected robot of this plugin, which has been observed once",
                hint="--robot.type=adamanip_franka or adamanip_franka_sim; with several robots --teleop.robot_id=ID",
            )
        return session, session.reading

    def _passed(self, session: RobotSession, now: float) -> float:
        """Returns the time since the last call [s]; drops the anchor if it was long or an episode has begun."""
        step = session.details.get(LOCKSTEP_DT)
        dt = now - self._called if step is None else float(step)  # where time passes by steps, no call is late
        begun = session is not self._session or session.episodes != self._episode
        if begun or dt > MAX_PAUSE_S:
            self._session, self._episode = session, session.episodes
            self._filter = None
            self._anchored_after = float("-inf") if begun else self._anchored_after
            self._begin(session, new_episode=begun)
        return min(dt, MAX_PAUSE_S)

    def _to(self, wanted: Target, reading: ArmReading, dt: float) -> Target:
        """Moves the goal towards a target (10,), as far as the robot would let it."""
        assert self._filter is not None
        return self._filter.stream(wanted, reading.tcp_in_base, dt)

    # Subclasses ------------------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def _open(self) -> None:
        """Opens the device. Raises `RobotError`."""

    @abc.abstractmethod
    def _close(self) -> None:
        """Closes it; idempotent."""

    @abc.abstractmethod
    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        """Returns the next goal (10,), ``dt`` [s] after the last one, through `_to`."""

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        """Called before the goal is anchored."""


def _named(target: Target) -> dict[str, float]:
    return dict(zip(POSE_NAMES, target.tolist(), strict=True))
