"""What devices of one LeRobot process know of each other: a teleoperator is never shown the robot's state.

LeRobot connects a teleoperator before the robot and passes it no observation; a policy's preprocessor is built from a
checkpoint alone. Robots put here what both need, under the robot's id.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.arm import ArmReading

LOCKSTEP_DT = "lockstep_dt"
"""Detail of a session: seconds of one step, where time passes by steps."""
OPERATOR_SUCCESS, SUCCESS = "operator_success", "success"
"""Details: the operator has pressed the key for it; a twin knows it."""
RESET_WANTED = "reset_wanted"
"""Detail: the operator wants the scene anew."""


@dataclass
class RobotSession:
    """What is known of one connected robot.

    Attributes:
        reading: the latest one.
        sent: (10,) last accepted target; None before the first.
        safety: the filter's limits, `lerobot_adamanip.hardware.safety_limits.SafetyLimits`.
        calibrations: camera key -> `lerobot_adamanip.hardware.camera_frames.CameraCalibration`.
        details: what a backend has to tell beside that, JSON-able (the twin: its annotations and episode).
        episodes: counts up whenever an episode begins or is given up: who integrates a goal starts anew then.
    """

    reading: ArmReading | None = None
    sent: NDArray[np.float32] | None = None
    safety: Any = None
    calibrations: dict[str, Any] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    episodes: int = 0


class RobotRegistry:
    """Robot id -> `RobotSession`, of this process. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sessions: dict[str, RobotSession] = {}

    def open(self, robot_id: str) -> RobotSession:
        """Returns a new session of this robot; the one before it, if any, is forgotten."""
        with self._lock:
            self._sessions[robot_id] = RobotSession()
            return self._sessions[robot_id]

    def find(self, robot_id: str | None = None) -> RobotSession | None:
        """Returns the session of ``robot_id``; without one, the only session there is. None if there is none such."""
        with self._lock:
            if robot_id is not None:
                return self._sessions.get(robot_id)
            return next(iter(self._sessions.values())) if len(self._sessions) == 1 else None

    def close(self, robot_id: str) -> None:
        """Forgets a robot; one that is not known is none to forget."""
        with self._lock:
            self._sessions.pop(robot_id, None)


ROBOTS = RobotRegistry()
"""Of this process."""
