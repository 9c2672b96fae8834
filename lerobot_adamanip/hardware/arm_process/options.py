"""How the arm's process is started and what it watches: one JSON argument, checked."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lerobot_adamanip.hardware.arm_process.messages import COMMAND, COMMAND_BYTES, STATUS, STATUS_BYTES
from lerobot_adamanip.util import json_fields as checked_json

MAX_FRAME_BYTES = 64_000_000
"""Of one frame buffer: a 4K picture with depth takes 41 MB."""

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class ServerOptions:
    """What the arm's process watches beside what its backend does.

    Attributes:
        state_age: the arm's own clock may stand still this long [s]; then the arm is stopped, and that is a fault.
        command_age: targets of a stream may stop this long [s]; then the arm holds where it is. Any target moves it on.
        lockstep_fps: None lets time pass by itself. A number stops it: each target advances the backend by 1/fps
            seconds (a key frame by as much as it takes), and nothing else does. For twins only.
        box_lower, box_upper: a target whose tool or hand is outside is a fault [m, base frame]; None checks nothing.
            The filter has clipped targets long before: this notices a recorder that does not use it.
        jump, angular_jump: a streamed target farther from the measured pose is a fault [m, rad]; None checks nothing.
            Wider than the filter's lead, which was counted from an older reading.
    """

    state_age: float = 0.2
    command_age: float = 0.5
    lockstep_fps: float | None = None
    box_lower: Corner | None = None
    box_upper: Corner | None = None
    jump: float | None = None
    angular_jump: float | None = None


@dataclass(frozen=True)
class Start:
    """All that the arm's process is told when it starts.

    Attributes:
        socket, memory: inherited file descriptors: the connection, and the mailboxes.
        backend: name in the table of the program that is started.
        options: of that backend; its own factory checks them.
        server: what is watched.
        frames: name -> bytes of further mailboxes, which the backend fills.
    """

    socket: int
    memory: int
    backend: str
    options: dict[str, Any] = field(default_factory=dict)
    server: ServerOptions = field(default_factory=ServerOptions)
    frames: dict[str, int] = field(default_factory=dict)

    def mailboxes(self) -> dict[str, int]:
        """Returns name -> capacity of every mailbox, in the order in which they lie in memory."""
        return mailbox_capacities(self.frames)

    def to_json(self) -> str:
        """Returns the argument that `parse_start` takes."""
        return json.dumps(dataclasses.asdict(self), allow_nan=False)


def mailbox_capacities(frames: Mapping[str, int]) -> dict[str, int]:
    """Returns name -> capacity [bytes] of the command, the status and the frames' mailboxes, in their order."""
    return {COMMAND: COMMAND_BYTES, STATUS: STATUS_BYTES, **dict(sorted(frames.items()))}


_NAME = checked_json.text(r"[a-z][a-z0-9_]{0,63}", "a name of small letters")
_SECONDS = checked_json.number(0.001, 3600.0)
_CORNER = checked_json.optional(checked_json.listing(checked_json.number(-10.0, 10.0), 3, 3))
_SERVER = checked_json.table(
    {
        "state_age": _SECONDS,
        "command_age": _SECONDS,
        "box_lower": _CORNER,
        "box_upper": _CORNER,
        "jump": checked_json.optional(checked_json.number(0.001, 10.0)),
        "angular_jump": checked_json.optional(checked_json.number(0.001, 10.0)),
        "lockstep_fps": checked_json.optional(checked_json.number(0.1, 1000.0)),
    }
)
_START = checked_json.table(
    {
        "socket": checked_json.integer(0, 2**20),
        "memory": checked_json.integer(0, 2**20),
        "backend": _NAME,
        "options": checked_json.mapping(_NAME, lambda _, value: value, 100),
        "server": _SERVER,
        "frames": checked_json.mapping(_NAME, checked_json.integer(1, MAX_FRAME_BYTES), 16),
    }
)


def parse_start(argument: str) -> Start:
    """Returns what the JSON argument of an arm's process says. Raises ValueError that names the field."""
    found = _START("the argument", checked_json.parse(argument))
    server = ServerOptions(**found.pop("server"))
    return Start(**found, server=server)
