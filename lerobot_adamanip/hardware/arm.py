"""Messages of an arm: targets, readings, requests, and the backend that drives it in the arm process.

A backend does not depend on LeRobot, recorders or cameras. The real arm, the twin and the test fake are backends.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox, message
from lerobot_adamanip.hardware.safety import SafetyLimits
from lerobot_adamanip.util.errors import ConfigurationError

Array = NDArray[np.float64]
COMMAND, STATUS = "command", "status"
"""Names of the required mailboxes: `ArmTarget` and `ArmStatus`. A backend may add others."""
RESET = "reset"
"""Request that resets scene and arm. Measurements after it do not depend on earlier ones."""
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


@message
@dataclass(frozen=True)
class ArmStatus:
    """Status that the arm process publishes after each tick.

    Attributes:
        beat: publication time, `time.perf_counter()` [s].
        reading: the arm's state; None if no reading has succeeded.
        accepted: number of the newest target that was passed to the backend; 0 before the first.
        fault: reason why targets are refused until `recover`; None without a fault.
        lost: whether the connection is lost; then connect again.
    """

    beat: float
    reading: ArmReading | None
    accepted: int = 0
    fault: str | None = None
    lost: bool = False


@message
@dataclass(frozen=True)
class Request:
    """Request other than a target. ``number`` 0 asks for no reply."""

    number: int
    ask: str
    values: dict[str, Any] = field(default_factory=dict)


@message
@dataclass(frozen=True)
class Reply:
    """Reply to the request with the same number; ``error`` gives the reason of a failure. 0: the process has ended."""

    number: int
    error: str | None = None
    values: dict[str, Any] = field(default_factory=dict)


@message
@dataclass(frozen=True)
class ServerOptions:
    """Watchdog and clock settings of the arm process.

    Attributes:
        state_age: maximum age of the arm's state [s]. An older state is a fault and stops the arm.
        command_age: maximum time without a streamed target [s]. Then the arm stops; the next target resumes.
        lockstep_fps: None for real time. A number for twins in lockstep: each streamed target advances the backend
            by 1/fps seconds, and each key frame runs to its end.
        limits: limits of the recorder's filter, see `server.malformed`; None disables the check.
    """

    state_age: float = 0.2
    command_age: float = 0.5
    lockstep_fps: float | None = None
    limits: SafetyLimits | None = None

    def __post_init__(self) -> None:
        for name in ("state_age", "command_age"):
            if not 0.001 <= getattr(self, name) <= 3600:
                raise ConfigurationError(f"{name} cannot be used.", got=getattr(self, name), allowed="0.001 ... 3600 s")


@message
@dataclass(frozen=True)
class Start:
    """First message to the arm process: backend options, server settings, and name -> size of every mailbox [bytes]."""

    options: Any
    server: ServerOptions
    capacities: dict[str, int]


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


Handler = Callable[[dict[str, Any]], dict[str, Any]]
"""Handles a request between two ticks; no watchdog runs meanwhile. Raises `AdaManipError` or ValueError to refuse."""


@dataclass(frozen=True)
class Served:
    """An unconnected backend and its request handlers.

    Attributes:
        backend: driver of the arm.
        handlers: request -> handler, e.g. `RESET`. The server handles ``step``, ``stop``, ``recover``, ``shutdown``.
        describe: called once after `connect`; returns the description for the recorder.
    """

    backend: ArmBackend
    handlers: Mapping[str, Handler] = field(default_factory=dict)
    describe: Callable[[], dict[str, Any]] = dict


BackendFactory = Callable[[Any, Mapping[str, Mailbox]], Served]
"""(options, mailboxes by name) -> backend. Raises `ConfigurationError` for a wrong option."""
