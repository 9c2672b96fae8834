"""Targets, readings and backends of an arm.

A backend runs in the arm process and is called by one thread. It does not depend on LeRobot, recorders or cameras.
The real arm, the twin and the test fake are backends of `lerobot_adamanip.hardware.arm_process`.
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
    """Execution mode of a target: one complete motion, or the newest target of a stream."""

    KEYFRAME = "keyframe"
    STREAM = "stream"


@message
@dataclass(frozen=True)
class ArmTarget:
    """A tool target that passed the safety filter.

    Attributes:
        pose: (10,) float32 action: position [m], rotation 6D, gripper [0 closed, 1 open], base frame.
        execution: KEYFRAME moves until the target is reached, stalled or out of time; STREAM replaces the last target.
        stamp: send time, `time.perf_counter()` [s].
    """

    pose: NDArray[np.float32]
    execution: Execution
    stamp: float


@message
@dataclass(frozen=True)
class ArmReading:
    """State of the arm at one time.

    Attributes:
        stamp: measurement time, `time.perf_counter()` [s]; comparable between processes on one machine.
        robot_time: the arm's own clock [s]; it stops when the connection is lost.
        tcp_in_base: (4, 4) measured pose of the tool centre point, robot base frame [m].
        gripper: opening, 0 closed ... 1 open.
        qpos: (7,) joint positions [rad].
        qvel: (7,) joint velocities [rad/s].
        effort: (7,) external joint torque [N m], positive in the direction in which the arm pushes.
        mode: controller state.
        errors: names of the error flags that are set.
        outcome: outcome of the latest key frame; None during a key frame and before the first.
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
    """Driver of an arm. Only `connect` and `close` may take longer than one tick of the arm process."""

    @property
    def period(self) -> float:
        """Time between two calls of `tick` [s]."""

    def connect(self) -> None:
        """Opens the connection, sets limits and verifies them. The arm does not move. Raises `RobotError`."""

    def read(self) -> ArmReading:
        """Returns the latest state. Raises `RobotError` if the connection is lost."""

    def tick(self) -> None:
        """Advances a simulated arm or checks a real one. Called once per `period`."""

    def stream(self, target: ArmTarget) -> None:
        """Replaces the target of the current motion. Returns at once."""

    def begin_keyframe(self, target: ArmTarget) -> None:
        """Starts a complete motion. It has ended when `read().outcome` is set."""

    def stop(self) -> None:
        """Decelerates within the limits. The arm then holds its position."""

    def recover(self) -> None:
        """Clears a reflex without motion. Raises `RobotError` on failure."""

    def close(self) -> None:
        """Stops and disconnects within 2 s. Idempotent; never raises."""
