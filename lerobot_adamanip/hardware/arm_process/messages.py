"""What the recorder's and the arm's process say to each other: numbers by position, the rest as strict JSON."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, ArmTarget, Execution
from lerobot_adamanip.util import json_fields as checked_json

COMMAND, STATUS = "command", "status"
"""Names of the two mailboxes that there always are; others hold frames."""
COMMAND_BYTES, STATUS_BYTES = 64, 8192
NO_OUTCOME = -1.0

_COMMAND = struct.Struct(f"<Bd{ACTION_DIM}f")
_EXECUTIONS = (Execution.KEYFRAME, Execution.STREAM)
_NUMBERS = 5 + 16 + 7 + 7 + 7 + ACTION_DIM
_STATUS = struct.Struct(f"<{_NUMBERS}d")
_any = checked_json.mapping(checked_json.text(r".{1,64}", "a name"), lambda _, value: value, 1000)
_text = checked_json.text(r"(?s).{0,4000}", "a text")
_REQUEST = checked_json.table({"id": checked_json.integer(0, 2**53), "ask": _text, "values": _any})
_REPLY = checked_json.table(
    {"id": checked_json.integer(0, 2**53), "error": checked_json.optional(_text), "values": _any}
)
_TAIL = checked_json.table(
    {
        "reading": checked_json.flag,
        "moved": checked_json.flag,
        "accepted": checked_json.integer(0, 2**53),
        "faults": checked_json.integer(0, 2**53),
        "holding": checked_json.flag,
        "lost": checked_json.flag,
        "fault": checked_json.optional(_text),
        "errors": checked_json.listing(_text, 0, 100),
    }
)


@dataclass(frozen=True)
class ArmStatus:
    """What the arm's process publishes after each of its ticks.

    Attributes:
        beat: when it was published, `time.perf_counter()` [s].
        reading: the arm's state; None if it could not be read even once.
        accepted: number of the newest target that was passed to the backend; 0 before the first.
        sent: (10,) float32, that target; None before the first.
        holding: nothing moves because targets of a stream stopped to come, or because it was asked to stop.
        fault: why no target is accepted until `recover`, with the names of the flags; None if all is well.
        lost: the fault is a lost connection: connect anew.
        faults: how many there were since the process began.
    """

    beat: float
    reading: ArmReading | None
    accepted: int = 0
    sent: NDArray[np.float32] | None = None
    holding: bool = False
    fault: str | None = None
    lost: bool = False
    faults: int = 0


@dataclass(frozen=True)
class Request:
    """Something asked of the arm's process beside targets. ``number`` 0 wants no reply."""

    number: int
    ask: str
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Reply:
    """The answer to the request of the same number; ``error`` says why there is none."""

    number: int
    error: str | None = None
    values: dict[str, Any] = field(default_factory=dict)


def pack_target(target: ArmTarget) -> bytes:
    """Returns a target as the command mailbox holds it."""
    return _COMMAND.pack(_EXECUTIONS.index(target.execution), target.stamp, *target.pose.astype(np.float32).tolist())


def unpack_target(content: bytes) -> ArmTarget:
    """Inverse of `pack_target`."""
    execution, stamp, *pose = _COMMAND.unpack(content)
    return ArmTarget(np.array(pose, np.float32), _EXECUTIONS[execution], stamp)


def pack_status(status: ArmStatus) -> bytes:
    """Returns a status as its mailbox holds it: 52 doubles, then JSON."""
    r = status.reading
    numbers = np.zeros(_NUMBERS)
    numbers[0] = status.beat
    if r is not None:
        outcome = NO_OUTCOME if r.outcome is None else float(r.outcome)
        parts = ([r.stamp, r.robot_time, r.gripper, outcome], r.tcp_in_base.ravel(), r.qpos, r.qvel, r.effort)
        numbers[1 : _NUMBERS - ACTION_DIM] = np.concatenate(parts)
    if status.sent is not None:
        numbers[-ACTION_DIM:] = status.sent
    tail = {
        "reading": r is not None, "moved": status.sent is not None, "accepted": status.accepted,
        "faults": status.faults, "holding": status.holding, "lost": status.lost, "fault": _short(status.fault),
        "errors": [] if r is None else [str(int(r.mode)), *r.errors],
    }  # fmt: skip
    return _STATUS.pack(*numbers.tolist()) + json.dumps(tail).encode()


def unpack_status(content: bytes) -> ArmStatus:
    """Inverse of `pack_status`. Raises ValueError for what is none."""
    numbers = np.array(_STATUS.unpack(content[: _STATUS.size]))
    tail = _TAIL("the arm's status", checked_json.parse(content[_STATUS.size :]))
    sent = numbers[-ACTION_DIM:].astype(np.float32) if tail["moved"] else None
    reading = _reading(numbers, tail["errors"]) if tail["reading"] else None
    told = {name: tail[name] for name in ("accepted", "holding", "fault", "lost", "faults")}
    return ArmStatus(float(numbers[0]), reading, sent=sent, **told)


def _reading(numbers: NDArray[np.float64], errors: tuple[str, ...]) -> ArmReading:
    stamp, robot_time, gripper, outcome = numbers[1:5].tolist()
    return ArmReading(
        stamp=stamp,
        robot_time=robot_time,
        tcp_in_base=numbers[5:21].reshape(4, 4),
        gripper=gripper,
        qpos=numbers[21:28],
        qvel=numbers[28:35],
        effort=numbers[35:42],
        mode=ArmMode(int(errors[0])),
        errors=errors[1:],
        outcome=None if outcome == NO_OUTCOME else Outcome(int(outcome)),
    )


def pack_request(request: Request) -> bytes:
    """Returns a request as JSON."""
    return _json({"id": request.number, "ask": request.ask, "values": request.values})


def unpack_request(content: bytes) -> Request:
    """Inverse of `pack_request`. Raises ValueError for what is none."""
    found = _REQUEST("a request", checked_json.parse(content))
    return Request(found["id"], found["ask"], found["values"])


def pack_reply(reply: Reply) -> bytes:
    """Returns a reply as JSON."""
    return _json({"id": reply.number, "error": _short(reply.error), "values": reply.values})


def unpack_reply(content: bytes) -> Reply:
    """Inverse of `pack_reply`. Raises ValueError for what is none."""
    found = _REPLY("a reply", checked_json.parse(content))
    return Reply(found["id"], found["error"], found["values"])


def _short(text: str | None) -> str | None:
    return text if text is None else text[:2000]


def _json(values: Mapping[str, Any]) -> bytes:
    return json.dumps(values, allow_nan=False).encode()
