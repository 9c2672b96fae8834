"""Sessions of connected robots, for the teleoperators and policies in the same process.

LeRobot connects a teleoperator before the robot and passes it no observation. It builds a policy's preprocessor from a
checkpoint only. So each robot registers the data that both need here, under its id.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.control import EE_POSE, FULL
from lerobot_adamanip.contract.memory import MEMORY_NAMES
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.episode.memory import Memory
from lerobot_adamanip.hardware.arm import ArmReading, Execution
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.hardware.dense_kinds import encode_action, named_state, state_of
from lerobot_adamanip.hardware.features import FRONT_CAMERA
from lerobot_adamanip.hardware.recorded_rows import ObservedRows, recorded_row
from lerobot_adamanip.hardware.safety import SafetyLimits

LOCKSTEP_DT = "lockstep_dt"
"""Session detail: duration of one step in lockstep [s]."""
OPERATOR_SUCCESS, SUCCESS = "operator_success", "success"
"""Session details: the operator marks the next action as a success; a twin reports success."""
RESET_WANTED = "reset_wanted"
"""Session detail: the operator requested a scene reset."""


@dataclass
class RobotSession:
    """State of one connected robot.

    Attributes:
        reading: latest reading.
        sent: (10,) last accepted target; None before the first.
        safety: limits of the robot's safety filter.
        execution: mode of all actions; None if unknown.
        action, state: kinds of action and state, see `contract.control`.
        calibrations: camera calibrations by camera key.
        details: further descriptions from the backend (twin: its annotations and episode).
        rows: rows of the latest observations, for the recorder.
        memory: memory of felt tries, if observations hold it; each episode starts without tries.
        episodes: counter that rises when an episode starts, is saved or is abandoned. Then the memory starts anew, and
            teleoperators anchor their goal again. A rollout may save an episode without a start of the next one.
    """

    reading: ArmReading | None = None
    sent: NDArray[np.float32] | None = None
    safety: SafetyLimits | None = None
    execution: Execution | None = None
    action: str = EE_POSE
    state: str = FULL
    calibrations: dict[str, CameraCalibration] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    memory: Memory | None = None
    episodes: int = 0
    rows: ObservedRows = field(default_factory=ObservedRows)
    _remembered_episode: int = 0
    _acted: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None

    @property
    def success(self) -> bool:
        """Whether the operator or a twin reports success."""
        return bool(self.details.get(OPERATOR_SUCCESS) or self.details.get(SUCCESS))

    def observe(self, reading: ArmReading, stamp: float) -> dict[str, float]:
        """Stores a reading for teleoperators and the recorder.

        Args:
            reading: arm reading.
            stamp: its measurement time since connection [s].

        Returns:
            Numbers of the reading by name: those of `state`, the tool pose, and the memory.
        """
        self.reading = reading
        sent = pose_vector(reading.tcp_in_base, reading.gripper) if self.sent is None else self.sent
        state = state_of(self.state, reading)
        camera = self.calibrations.get(FRONT_CAMERA)
        self.rows.add(state, recorded_row(self.action, reading, sent, stamp, camera))
        return {**named_state(self.state, reading), **self._remember(state)}

    def _remember(self, state: NDArray[np.float32]) -> dict[str, float]:
        """Returns the memory by name, after the action since the observation before; empty without a memory."""
        acted, self._acted = self._acted, None
        if self.memory is None:
            return {}
        if self._remembered_episode != self.episodes:
            self._remembered_episode = self.episodes
            self.memory.reset()
        elif acted is not None:
            self.memory.after(*acted, state)
        return dict(zip(MEMORY_NAMES, self.memory.numbers().tolist(), strict=True))

    def act(self, sent: NDArray[np.float32], observed: ArmReading) -> dict[str, float]:
        """Stores a target that the arm accepted after an observation, and whether the task is done now.

        Returns:
            The target as an action by name.
        """
        self.sent = sent
        action = encode_action(self.action, sent, observed)
        executed = np.array(list(action.values()), np.float32)
        self.rows.complete(executed, sent, self.success)
        self.details.pop(OPERATOR_SUCCESS, None)  # a policy's action after the operator's is not marked
        self._acted = state_of(self.state, observed), executed
        return action


class RobotRegistry:
    """Registry of this process: robot id -> `RobotSession`."""

    def __init__(self) -> None:
        self._sessions: dict[str, RobotSession] = {}

    def open(self, robot_id: str) -> RobotSession:
        """Returns a new session for this robot. It replaces an older one."""
        self._sessions[robot_id] = RobotSession()
        return self._sessions[robot_id]

    def find(self, robot_id: str | None = None) -> RobotSession | None:
        """Returns the session of ``robot_id``, or the only session without an id; None if not found."""
        if robot_id is not None:
            return self._sessions.get(robot_id)
        return next(iter(self._sessions.values())) if len(self._sessions) == 1 else None

    def close(self, robot_id: str) -> None:
        """Removes a robot. Does nothing if it is not registered."""
        self._sessions.pop(robot_id, None)


ROBOTS = RobotRegistry()
"""Registry of this process."""
