"""Sessions of connected robots, for the teleoperators and policies of the same process.

LeRobot connects a teleoperator before the robot and shows it no observation; a policy's preprocessor is built from a
checkpoint alone. Robots register here what both need, under the robot's id.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.hardware.safety_limits import SafetyLimits

LOCKSTEP_DT = "lockstep_dt"
"""Detail of a session: seconds of one step, where time passes by steps."""
OPERATOR_SUCCESS, SUCCESS = "operator_success", "success"
"""Details: the operator has pressed the key for success; a twin reports success."""
RESET_WANTED = "reset_wanted"
"""Detail: the operator wants the scene reset."""


@dataclass
class RobotSession:
    """State of one connected robot.

    Attributes:
        reading: the latest one.
        sent: (10,) last accepted target; None before the first.
        safety: limits of its filter.
        calibrations: by camera key.
        details: what a backend describes beside that (the twin: its annotations and episode).
        episodes: counts up when an episode begins or is given up: teleoperators anchor their goal then.
    """

    reading: ArmReading | None = None
    sent: NDArray[np.float32] | None = None
    safety: SafetyLimits | None = None
    calibrations: dict[str, CameraCalibration] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    episodes: int = 0


class RobotRegistry:
    """Robot id -> `RobotSession`, of this process."""

    def __init__(self) -> None:
        self._sessions: dict[str, RobotSession] = {}

    def open(self, robot_id: str) -> RobotSession:
        """Returns a new session of this robot, instead of an older one."""
        self._sessions[robot_id] = RobotSession()
        return self._sessions[robot_id]

    def find(self, robot_id: str | None = None) -> RobotSession | None:
        """Returns the session of ``robot_id``, or without one the only session; None if there is none such."""
        if robot_id is not None:
            return self._sessions.get(robot_id)
        sessions = list(self._sessions.values())
        return sessions[0] if len(sessions) == 1 else None

    def close(self, robot_id: str) -> None:
        """Removes a robot; nothing happens if it is not registered."""
        self._sessions.pop(robot_id, None)


ROBOTS = RobotRegistry()
"""Of this process."""
