"""Executes actions: filtered, as a key frame or in a stream, with recovery from reflexes where allowed."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.arm import ArmReading, Execution
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.arm_process.messages import ArmStatus
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter
from lerobot_adamanip.hardware.target_geometry import Target, angle, canonical, distance, placed
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

FAR_STEPS = 1.5
"""Under execution=auto, ticks of a stream that a key frame is farther than."""
CALM = 5.0
"""Time without a fault that resets the count of faults in a row [s]."""

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class MotionRules:
    """Options of the same names of `AdamanipFrankaConfig`."""

    execution: str
    auto_recover: int
    motion_time: float


def action_vector(action: Mapping[str, Any]) -> Target:
    """Returns LeRobot's action as (10,) float32. Raises `ConfigurationError` for one that lacks a name."""
    if missing := [name for name in POSE_NAMES if name not in action]:
        raise ConfigurationError(
            "An action lacks names.", got=f"no {', '.join(missing)}", allowed=", ".join(POSE_NAMES)
        )
    with np.errstate(over="ignore"):
        return np.array([float(action[name]) for name in POSE_NAMES], dtype=np.float32)


class MotionDriver:
    """Executes actions on one connected arm, and updates its session.

    Args:
        arm: connected.
        session: gets every reading and sent target.
        safety: of this arm alone.
        rules: of execution.

    Attributes:
        rested_at: when the latest key frame ended, `time.perf_counter()` [s]; None while the arm is streamed to.
    """

    def __init__(self, arm: ArmClient, session: RobotSession, safety: SafetyFilter, rules: MotionRules) -> None:
        self._arm, self._session, self._filter, self._rules = arm, session, safety, rules
        self.rested_at: float | None = None
        self._sent_at: float | None = None
        self._done_at: float | None = None  # when the latest action was, however long it took
        self._goal: bytes | None = None
        self._faults, self._fault_at = 0, 0.0

    def anchor(self) -> None:
        """Makes the measured pose the last sent target.

        Raises:
            RobotError: the arm has a fault, or the hand is outside the box.
        """
        reading = self._arm.healthy().reading
        assert reading is not None
        self._session.reading = reading
        self._session.sent = self._filter.anchor(reading.tcp_in_base, reading.gripper)
        self._sent_at = self._done_at = self.rested_at = self._goal = None

    # Faults -----------------------------------------------------------------------------------------------------------

    def read_or_raise(self) -> ArmReading:
        """Returns the reading of a healthy arm, after a recovery if that is allowed. Raises `RobotError`."""
        status = self._arm.status()
        if status.fault is not None and not status.lost and self._rules.auto_recover:
            status = self._recovered(status)
        status = self._arm.healthy() if status.fault is not None else status
        assert status.reading is not None
        self._session.reading = status.reading
        return status.reading

    def recover(self) -> None:
        """Clears a fault; nothing moves, and the next actions begin at the present pose. Raises `RobotError`."""
        self._arm.request("recover")
        self.anchor()

    def _recovered(self, status: ArmStatus) -> ArmStatus:
        self._faults, self._fault_at = self._faults + 1, time.perf_counter()
        if self._faults > self._rules.auto_recover:
            raise RobotError(
                f"{self._faults} faults in a row; the last: {status.fault}",
                got=f"{self._faults} faults",
                allowed=f"auto_recover={self._rules.auto_recover}",
                hint="see to the arm and to what it touches",
            )
        _logger.warning("recovering: %s", status.fault)
        self.recover()
        return self._arm.healthy()

    # Motions ----------------------------------------------------------------------------------------------------------

    def send(self, wanted: Target, reading: ArmReading) -> Target:
        """Sends a target (10,) through the filter, waits for the end of a key frame, and returns what was sent.

        Raises:
            RobotError: the arm has a fault, ten malformed targets came in a row, a key frame does not end.
        """
        whole = self._execution(wanted) is Execution.KEYFRAME
        sent = self._send_keyframe(wanted, reading) if whole else self._send_stream(wanted, reading)
        self._session.sent = sent
        self._done_at = time.perf_counter()
        return sent

    def _execution(self, wanted: Target) -> Execution:
        if self._rules.execution != "auto":
            return Execution(self._rules.execution)
        last, goal = self._filter.last, canonical(wanted)
        if last is None or goal is None:
            return Execution.STREAM
        limits, ahead, at = self._filter.limits, placed(goal), placed(last)
        tick = limits.max_dt if self._done_at is None else time.perf_counter() - self._done_at
        seconds = FAR_STEPS * min(float(self._session.details.get(LOCKSTEP_DT, tick)), limits.max_dt)
        far = distance(ahead, at) > limits.speed * seconds or angle(ahead, at) > limits.angular_speed * seconds
        return Execution.KEYFRAME if far else Execution.STREAM

    def _send_keyframe(self, wanted: Target, reading: ArmReading) -> Target:
        """Executes one motion to its end; the same goal again is none: a paused roll-out resends its last action."""
        last = self._filter.last
        if self._goal == wanted.tobytes() and last is not None:
            return last
        for sent in self._filter.keyframe(wanted, reading.tcp_in_base):
            self._session.sent = sent
            try:
                ended = self._arm.wait(self._arm.send(sent, Execution.KEYFRAME), self._rules.motion_time)
            except RobotError:
                if not self._arm.is_connected or self._arm.status().fault is None:
                    raise
                self.read_or_raise()  # recovers and goes on, or raises what is wrong
                return sent
            self._session.reading, self._goal = ended.reading, wanted.tobytes()
            self.rested_at, self._faults = time.perf_counter(), 0
            if ended.reading is None or ended.reading.outcome is not Outcome.REACHED:
                break  # from here the rest of the way may lead out of the box
        return sent

    def _send_stream(self, wanted: Target, reading: ArmReading) -> Target:
        now = time.perf_counter()
        passed = 0.0 if self._sent_at is None else self._session.details.get(LOCKSTEP_DT, now - self._sent_at)
        sent = self._filter.stream(wanted, reading.tcp_in_base, passed)
        self._arm.send(sent, Execution.STREAM)
        self._sent_at, self.rested_at, self._goal = now, None, None
        if now - self._fault_at > CALM:
            self._faults = 0
        return sent
