"""Messages between the recorder and the arm process. See `encoding` for their bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.arm import ArmBackend, ArmReading
from lerobot_adamanip.hardware.arm_process.encoding import message
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox
from lerobot_adamanip.hardware.safety_limits import SafetyLimits
from lerobot_adamanip.util.errors import ConfigurationError

COMMAND, STATUS = "command", "status"
"""Names of the required mailboxes: `ArmTarget` and `ArmStatus`. A backend may add others."""
RESET = "reset"
"""Request that resets scene and arm. Measurements after it do not depend on earlier ones."""
MAX_TEXT = 2000
"""Maximum length of an error text [characters]."""


@message
@dataclass(frozen=True)
class ServerOptions:
    """Watchdog and clock settings of the arm process.

    Attributes:
        state_age: maximum age of the arm's state [s]. An older state is a fault and stops the arm.
        command_age: maximum time without a streamed target [s]. Then the arm stops; the next target resumes.
        lockstep_fps: None for real time. A number for twins in lockstep: each streamed target advances the backend
            by 1/fps seconds, and each key frame runs to its end.
        limits: limits of the recorder's filter, see `watch.malformed`; None disables the check.
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
    """First message to the arm process.

    Attributes:
        options: backend options, see its `BackendFactory`.
        server: watchdog and clock settings.
        capacities: name -> size of every mailbox [bytes], in memory order.
    """

    options: Any
    server: ServerOptions
    capacities: dict[str, int]


@message
@dataclass(frozen=True)
class ArmStatus:
    """Status that the arm process publishes after each tick.

    Attributes:
        beat: publication time, `time.perf_counter()` [s].
        reading: the arm's state; None if no reading has succeeded.
        accepted: number of the newest target that was passed to the backend; 0 before the first.
        sent: (10,) float32 pose of that target; None before the first.
        holding: whether the arm was stopped, by a missing streamed target or a `stop` request.
        fault: reason why targets are refused until `recover`; None without a fault.
        lost: whether the connection is lost; then connect again.
    """

    beat: float
    reading: ArmReading | None
    accepted: int = 0
    sent: NDArray[np.float32] | None = None
    holding: bool = False
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
