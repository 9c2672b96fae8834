"""What the recorder's and the arm's process send each other; `encoding` has the bytes."""

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
"""Mailboxes that there always are: an `ArmTarget`, an `ArmStatus`. Others are the backend's."""
RESET = "reset"
"""Request that resets scene and arm; later measurements do not depend on earlier ones."""
MAX_TEXT = 2000
"""Characters of an error that are kept."""


@message
@dataclass(frozen=True)
class ServerOptions:
    """Watchdogs of the arm's process, and how time passes.

    Attributes:
        state_age: a state that stands still for longer is a fault, which stops the arm [s].
        command_age: a stream without a new target for longer is stopped [s]. The next target moves it on.
        lockstep_fps: None: real time. A number: only targets advance the backend, each by 1/fps seconds, a
            key frame to its end. For twins.
        limits: of the recorder's filter, see `watch.malformed`; None checks nothing.
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
    """First message to the arm's process.

    Attributes:
        options: of the backend, see its `BackendFactory`.
        server: watchdogs and clock.
        capacities: name -> bytes of every mailbox, in their order in memory.
    """

    options: Any
    server: ServerOptions
    capacities: dict[str, int]


@message
@dataclass(frozen=True)
class ArmStatus:
    """Published by the arm's process after each tick.

    Attributes:
        beat: when it was published, `time.perf_counter()` [s].
        reading: the arm's state; None if it could not be read even once.
        accepted: number of the newest target that was passed to the backend; 0 before the first.
        sent: (10,) float32, that target; None before the first.
        holding: the arm was stopped: targets of a stream did not come, or `stop` was asked for.
        fault: why no target is accepted until `recover`; None if all is well.
        lost: the fault is a lost connection: connect again.
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
    """A question or command beside targets; ``number`` 0 wants no reply."""

    number: int
    ask: str
    values: dict[str, Any] = field(default_factory=dict)


@message
@dataclass(frozen=True)
class Reply:
    """Answer to the request of the same number; ``error`` says why there is none. Number 0: the process has ended."""

    number: int
    error: str | None = None
    values: dict[str, Any] = field(default_factory=dict)


Handler = Callable[[dict[str, Any]], dict[str, Any]]
"""Answers a request, between two ticks: no watchdog runs meanwhile. Raises `AdaManipError` or ValueError to refuse."""


@dataclass(frozen=True)
class Served:
    """A backend that is not yet connected, and the requests that it answers.

    Attributes:
        backend: moves the arm.
        handlers: request -> handler, e.g. `RESET`. ``step``, ``stop``, ``recover``, ``shutdown`` are the server's own.
        describe: called once after `connect`: what the recorder should know.
    """

    backend: ArmBackend
    handlers: Mapping[str, Handler] = field(default_factory=dict)
    describe: Callable[[], dict[str, Any]] = dict


BackendFactory = Callable[[Any, Mapping[str, Mailbox]], Served]
"""(options, mailboxes by name) -> backend. Raises `ConfigurationError` for a wrong option."""
