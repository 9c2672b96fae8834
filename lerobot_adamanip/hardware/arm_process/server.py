"""Loop of the arm process: receives targets, publishes states, stops the arm if the arm or the recorder fails.

The loop has one thread. Each tick, every `ArmBackend.period` seconds: answer requests; pass a new target to a healthy
arm; call `ArmBackend.tick` and `ArmBackend.read`; check the watchdogs; publish the status.

In lockstep only ``step`` requests advance time. Each takes the newest target. A streamed target ticks for 1/fps
seconds; the remainder is carried over, so 30 Hz on 50 Hz ticks stays exact. A key frame ticks until its outcome.

A fault stops the arm and refuses targets until ``recover``: arm errors, a stale state, a malformed target or a backend
exception. When the recorder dies (end of file, or another parent), the process stops the arm, waits until it rests,
and exits.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, ArmTarget, Execution
from lerobot_adamanip.hardware.arm_process.encoding import decode, encode
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox
from lerobot_adamanip.hardware.arm_process.messages import (
    COMMAND,
    MAX_TEXT,
    RESET,
    STATUS,
    ArmStatus,
    Handler,
    Reply,
    Request,
    Served,
    ServerOptions,
)
from lerobot_adamanip.hardware.arm_process.watch import malformed, trouble
from lerobot_adamanip.util.errors import AdaManipError, RobotError

REST_SPEED = 0.005
"""Maximum joint speed of an arm at rest [rad/s]."""
REST_WAIT = 2.0
"""Maximum wait for rest [s]."""
KEYFRAME_LIMIT = 120.0
"""Maximum duration of a key frame in lockstep [s of the backend]; the backend's own limit is shorter."""


class ArmServer:
    """Drives one connected backend for one recorder. `run` returns when the recorder has ended."""

    def __init__(
        self, served: Served, connection: Connection, boxes: Mapping[str, Mailbox], options: ServerOptions
    ) -> None:
        self._backend, self._connection, self._options = served.backend, connection, options
        self._lockstep = options.lockstep_fps is not None
        self._command, self._status = boxes[COMMAND], boxes[STATUS]
        self._handlers = {name: self._observed(name, each) for name, each in served.handlers.items()}
        self._handlers |= {"step": self._step, "stop": self._hold, "recover": self._recover, "shutdown": self._end}
        self._parent, self._ended = os.getppid(), False
        self._reading: ArmReading | None = None
        self._accepted = 0
        self._target: ArmTarget | None = None
        self._arrival = self._advanced = time.perf_counter()
        self._holding = self._lost = False
        self._fault: str | None = None
        self._backlog_s = 0.0

    def run(self) -> None:
        """Ticks until the recorder has ended, then stops the arm and waits for rest. Never raises `RobotError`."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the recorder also gets it and ends this process cleanly
        signal.signal(signal.SIGTERM, self._end)
        self._observe()
        due = time.perf_counter()
        while not self._ended:
            due += self._backend.period
            self._answer(due)
            if os.getppid() != self._parent:
                self._end()
            if self._ended:
                break
            if not self._lockstep:
                self._accept()
                self._observe(tick=True)
            due = max(due, time.perf_counter() - self._backend.period)  # skip missed ticks
        self._come_to_rest()

    def _end(self, *_: object) -> dict[str, Any]:
        self._ended = True
        return {}

    # One tick --------------------------------------------------------------------------------------------------------

    def _answer(self, due: float) -> None:
        """Answers requests until the next tick is due, but at least one, so that late ticks do not starve them."""
        try:
            while self._connection.poll(max(0.0, due - time.perf_counter())):
                request = decode(self._connection.recv_bytes(), Request)
                reply = self._answered(request)
                if request.number:
                    self._connection.send_bytes(encode(reply))
                if self._ended or time.perf_counter() >= due:
                    return
        except (EOFError, OSError):
            self._end()
        except RobotError as error:  # a request that cannot be read
            self._fail(str(error))

    def _answered(self, request: Request) -> Reply:
        handler = self._handlers.get(request.ask)
        if handler is None:
            return Reply(request.number, f"unknown request {request.ask!r}; known are {', '.join(self._handlers)}")
        try:
            return Reply(request.number, None, handler(request.values))
        except (AdaManipError, ValueError) as error:
            return Reply(request.number, str(error)[:MAX_TEXT] or type(error).__name__)

    def _accept(self) -> None:
        """Passes a new target to the backend if the arm is healthy."""
        try:
            found = self._command.read()
        except RobotError as error:  # a target that cannot be read
            self._fail(str(error))
            return
        if found is None or found[0] == self._accepted:
            self._stop_on_command_timeout()
            return
        if self._fault is not None or not self._try(self._read) or self._fault is not None:
            return
        target: ArmTarget = found[1]
        assert self._reading is not None
        if problem := malformed(target, self._options, self._reading.tcp_in_base):
            self._fail(problem)
            return
        self._arrival, self._holding = time.perf_counter(), False
        begin = self._backend.begin_keyframe if target.execution is Execution.KEYFRAME else self._backend.stream
        if self._try(lambda: begin(target)):
            self._accepted, self._target = found[0], target

    def _stop_on_command_timeout(self) -> None:
        streamed = self._target is not None and self._target.execution is Execution.STREAM
        if streamed and not self._holding and time.perf_counter() - self._arrival > self._options.command_age:
            self._hold({})

    def _observe(self, *, tick: bool = False) -> None:
        """Reads and publishes the state, after one tick if ``tick`` is set."""
        if tick:
            self._try(self._backend.tick)
        self._try(self._read)
        self._publish()

    def _read(self) -> None:
        before, reading = self._reading, self._backend.read()
        if before is None or reading.robot_time != before.robot_time:
            self._advanced = time.perf_counter()
        self._reading = reading
        stood_still = 0.0 if self._lockstep else time.perf_counter() - self._advanced
        if self._fault is None and (problem := trouble(reading, stood_still, self._options.state_age)):
            self._fail(problem)

    def _publish(self) -> None:
        sent = None if self._target is None else self._target.pose
        state = (self._accepted, sent, self._holding, self._fault, self._lost)
        self._status.write(ArmStatus(time.perf_counter(), self._reading, *state))

    # Faults ----------------------------------------------------------------------------------------------------------

    def _try(self, call: Callable[[], None]) -> bool:
        """Calls the backend and returns whether it succeeded. A `RobotError` becomes the fault."""
        try:
            call()
        except RobotError as error:
            self._fail(str(error), lost=call == self._read)
            return False
        return True

    def _fail(self, what: str, *, lost: bool = False) -> None:
        """Publishes the first fault, then stops the arm. The stop takes 1 s if the arm does not answer."""
        self._lost = self._lost or lost
        if self._fault is None:
            self._fault = what[:MAX_TEXT]
            self._publish()
            with contextlib.suppress(RobotError):
                self._backend.stop()

    # Requests --------------------------------------------------------------------------------------------------------

    def _observed(self, ask: str, handler: Handler) -> Handler:
        """Returns a handler that publishes the new state. In lockstep no tick would publish it before the next read."""

        def answer(values: dict[str, Any]) -> dict[str, Any]:
            began = time.perf_counter()
            told = handler(values)
            self._advanced += time.perf_counter() - began  # the arm could not move during this time
            if ask == RESET:
                self._backlog_s = 0.0
            self._observe()
            return told

        return answer

    def _hold(self, _: dict[str, Any]) -> dict[str, Any]:
        self._holding = True
        self._try(self._backend.stop)
        return {}

    def _recover(self, _: dict[str, Any]) -> dict[str, Any]:
        """Clears a fault. Drops targets sent before it."""
        if self._lost:
            raise RobotError("The connection to the arm is lost; recovery cannot restore it: connect again.")
        self._backend.recover()
        self._fault, self._holding, self._target = None, True, None
        self._accepted = self._command.number
        self._advanced = time.perf_counter()
        self._observe(tick=True)
        if self._fault is not None:
            raise RobotError(self._fault)
        return {}

    def _step(self, _: dict[str, Any]) -> dict[str, Any]:
        """Takes the newest target and advances time by one step."""
        fps = self._options.lockstep_fps
        if fps is None:
            raise RobotError("This process runs in real time; steps need lockstep.")
        self._accept()
        period = self._backend.period
        whole = self._target is not None and self._target.execution is Execution.KEYFRAME
        self._backlog_s = KEYFRAME_LIMIT if whole else self._backlog_s + 1.0 / fps
        while self._backlog_s >= period * (1 - 1e-9) and self._fault is None:
            self._backlog_s -= period
            self._observe(tick=True)
            if whole and self._reading is not None and self._reading.outcome is not None:
                self._backlog_s = 0.0
        self._publish()
        return {}

    def _come_to_rest(self) -> None:
        """Stops the arm and ticks until it rests."""
        with contextlib.suppress(RobotError):
            self._backend.stop()
            until = time.perf_counter() + REST_WAIT
            while time.perf_counter() < until:
                self._backend.tick()
                reading = self._backend.read()
                if reading.mode is not ArmMode.MOVING and abs(reading.qvel).max() < REST_SPEED:
                    return
                if not self._lockstep:
                    time.sleep(self._backend.period)
