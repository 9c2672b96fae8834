"""Executes filtered actions as key frames or as a stream."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.arm import ArmReading, Execution
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.util.errors import ConfigurationError


def action_vector(action: Mapping[str, Any]) -> Target:
    """Returns LeRobot's action as (10,) float32. Raises `ConfigurationError` if a name is missing."""
    if missing := [name for name in POSE_NAMES if name not in action]:
        raise ConfigurationError(
            "An action lacks names.", got=f"no {', '.join(missing)}", allowed=", ".join(POSE_NAMES)
        )
    with np.errstate(over="ignore"):
        return np.array([float(action[name]) for name in POSE_NAMES], dtype=np.float32)


class MotionDriver:
    """Executes actions on one connected arm and updates its session.

    Args:
        arm: connected client.
        session: stores every reading and sent target.
        safety: filter of this arm only.
        execution: mode of all actions.
        motion_time: maximum duration of a key frame [s].

    Attributes:
        rested_at: end of the latest key frame, `time.perf_counter()` [s]; None during streaming.
    """

    def __init__(
        self, arm: ArmClient, session: RobotSession, safety: SafetyFilter, execution: Execution, motion_time: float
    ) -> None:
        self._arm, self._session, self._filter = arm, session, safety
        self._execution, self._motion_time = execution, motion_time
        self.rested_at: float | None = None
        self._sent_at: float | None = None
        self._goal: bytes | None = None

    def read(self) -> ArmReading:
        """Returns the reading of a healthy arm. Raises `RobotError` for a fault."""
        reading = self._arm.healthy().reading
        assert reading is not None
        self._session.reading = reading
        return reading

    def anchor(self) -> None:
        """Sets the last sent target to the measured pose.

        Raises:
            RobotError: the arm has a fault, or the hand is outside the box.
        """
        reading = self.read()
        self._session.sent = self._filter.anchor(reading.tcp_in_base, reading.gripper)
        self._sent_at = self.rested_at = self._goal = None

    def recover(self) -> None:
        """Clears a fault without motion. The next action starts at the current pose. Raises `RobotError`."""
        self._arm.request("recover")
        self.anchor()

    def send(self, wanted: Target, reading: ArmReading) -> Target:
        """Filters and sends a target (10,), and returns the filtered target. Waits for the end of a key frame.

        Raises:
            RobotError: the arm has a fault, ten targets in a row were malformed, or a key frame does not end.
        """
        whole = self._execution is Execution.KEYFRAME
        self._session.sent = self._send_keyframe(wanted, reading) if whole else self._send_stream(wanted, reading)
        return self._session.sent

    def _send_keyframe(self, wanted: Target, reading: ArmReading) -> Target:
        """Executes one motion to its end. Skips a repeated goal: a paused rollout resends its last action."""
        last = self._filter.last
        if self._goal == wanted.tobytes() and last is not None:
            return last
        for sent in self._filter.keyframe(wanted, reading.tcp_in_base):
            self._session.sent = sent
            ended = self._arm.wait(self._arm.send(sent, Execution.KEYFRAME), self._motion_time)
            self._session.reading, self._goal = ended.reading, wanted.tobytes()
            self.rested_at = time.perf_counter()
            if ended.reading is None or ended.reading.outcome is not Outcome.REACHED:
                break  # from here the rest of the path may leave the box
        return sent

    def _send_stream(self, wanted: Target, reading: ArmReading) -> Target:
        now = time.perf_counter()
        passed = 0.0 if self._sent_at is None else self._session.details.get(LOCKSTEP_DT, now - self._sent_at)
        sent = self._filter.stream(wanted, reading.tcp_in_base, passed)
        self._arm.send(sent, Execution.STREAM)
        self._sent_at, self.rested_at, self._goal = now, None, None
        return sent
