"""Targets, readings and backends of an arm.

A backend runs in the arm's process, is called by one thread, and knows nothing of LeRobot, recorders or cameras. The
real arm, the twin and the tests' fake are backends of `lerobot_adamanip.hardware.arm_process`.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.hardware.arm_process.encoding import message

Array = NDArray[np.float64]
message(Outcome)


@message
class ArmMode(enum.IntEnum):
    """State of the arm's controller."""

    IDLE = 0
    MOVING = 1
    GUIDING = 2
    REFLEX = 3
    USER_STOPPED = 4
    RECOVERING = 5
    OTHER = 6


@message
class Execution(enum.StrEnum):
    """A target is one whole motion, or the newest of a stream."""

    KEYFRAME = "keyframe"
    STREAM = "stream"


@message
@dataclass(frozen=True)
class ArmTarget:
    """A target of the tool, after the safety filter.

    Attributes:
        pose: (10,) float32 action of the contract: position [m], rotation 6D, gripper [0 closed, 1 open], base frame.
        execution: KEYFRAME moves there until reached, stalled or out of time; STREAM replaces the target before it.
        stamp: when it was sent, `time.perf_counter()` [s].
    """

    pose: NDArray[np.float32]
    execution: Execution
    stamp: float


@message
@dataclass(frozen=True)
class ArmReading:
    """State of the arm at one moment.

    Attributes:
        stamp: when it was measured, `time.perf_counter()` [s]: comparable between processes of one machine.
        robot_time: the arm's own clock [s]; it stops with the connection.
        tcp_in_base: (4, 4) measured pose of the tool centre point, robot base frame [m].
        gripper: opening, 0 closed ... 1 open.
        qpos: (7,) joint positions [rad].
        qvel: (7,) joint velocities [rad/s].
        effort: (7,) external joint torque [N m], signed as the contract's: what the arm exerts.
        mode: of the controller.
        errors: names of the flags that are set.
        outcome: of the latest key frame; None while one is under way, and before the first.
    """

    stamp: float
    robot_time: float
    tcp_in_base: Array
    gripper: float
    qpos: Array
    qvel: Array
    effort: Array
    mode: ArmMode
    errors: tuple[str, ...] = ()
    outcome: Outcome | None = None


class ArmBackend(Protocol):
    """Driver of an arm. Only `connect` and `close` may take longer than a tick of the arm's process."""

    @property
    def period(self) -> float:
        """Seconds between two calls of `tick`."""

    def connect(self) -> None:
        """Opens the connection, sets limits and reads them back; leaves the arm where it is. Raises `RobotError`."""

    def read(self) -> ArmReading:
        """Returns the latest state. Raises `RobotError` where the connection is lost."""

    def tick(self) -> None:
        """Called every `period`: advances a simulated arm, checks a real one."""

    def stream(self, target: ArmTarget) -> None:
        """Replaces the target of a motion; returns at once."""

    def begin_keyframe(self, target: ArmTarget) -> None:
        """Begins a whole motion, which `read().outcome` ends."""

    def stop(self) -> None:
        """Decelerates within the limits; the arm holds where it comes to rest."""

    def recover(self) -> None:
        """Clears a reflex without moving. Raises `RobotError` if it cannot."""

    def close(self) -> None:
        """Stops and disconnects; idempotent, at most 2 s, never raises."""
