"""The arm process: receives targets, publishes states, stops the arm if the arm or the recorder fails.

`ArmClient` runs ``python -m`` this module with SOCKET MEMORY FACTORY. The loop has one thread. Each tick, every
`ArmBackend.period` seconds: answer requests; pass a new target to a healthy arm; call `ArmBackend.tick` and
`ArmBackend.read`; check the watchdogs; publish the status.

In lockstep only ``step`` requests advance time. Each takes the newest target. A streamed target ticks for 1/fps
seconds; the remainder is carried over, so 30 Hz on 50 Hz ticks stays exact. A key frame ticks until its outcome.

A fault stops the arm and refuses targets until ``recover``: arm errors, a stale state, a malformed target or a backend
exception. When the recorder dies (end of file, or another parent), the process stops the arm, waits until it rests,
and exits.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pkgutil
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.contract.schema import ACTION_DIM, GRIPPER_DIM, ROTATION_DIMS
from lerobot_adamanip.hardware.arm import (
    COMMAND,
    RESET,
    STATUS,
    ArmMode,
    ArmReading,
    ArmStatus,
    ArmTarget,
    Array,
    BackendFactory,
    Execution,
    Handler,
    Reply,
    Request,
    Served,
    ServerOptions,
    Start,
)
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox, decode, encode, map_mailboxes
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_adamanip.util.errors import AdaManipError, RobotError

MAX_TEXT = 2000
"""Maximum length of an error text [characters]."""
REST_SPEED, REST_S = 0.005, 2.0
"""Maximum joint speed of an arm at rest [rad/s], and maximum wait for rest."""
KEYFRAME_S = 120.0
"""Maximum duration of a key frame in lockstep, on the backend's clock; the backend's own limit is shorter."""
ROTATION_ERROR = 1e-3
"""Maximum orthonormality error of a target's rotation rows. The safety filter returns orthonormal rows."""
MAX_LEADS = 2.0
"""Allowed multiple of the filter's lead. It exceeds 1 because this process has a newer reading."""
BOX_ROUNDING = 1e-6
"""Tolerance [m] for float32 targets against the float64 box."""
STOPPED_MODES = {
    ArmMode.REFLEX: "The arm stopped itself (reflex)",
    ArmMode.USER_STOPPED: "The arm's user stop is pressed",
    ArmMode.GUIDING: "The arm is being guided by hand",
}
PR_SET_PDEATHSIG = 1
"""Linux constant of `prctl(2)`."""


class ArmServer:
    """Drives one connected backend for one recorder. `run` returns when the recorder has ended.

    From its construction on, so before the recorder knows of it, this process ignores SIGINT and ends at SIGTERM.
    """

    def __init__(
        self, served: Served, connection: Connection, boxes: Mapping[str, Mailbox], options: ServerOptions
    ) -> None:
        self._backend, self._connection, self._options = served.backend, connection, options
        self._lockstep = options.lockstep_fps is not None
        self._command, self._status = boxes[COMMAND], boxes[STATUS]
        self._handlers = {name: self._observed(name, handler) for name, handler in served.handlers.items()}
        self._handlers |= {"step": self._step, "stop": self._hold, "recover": self._recover, "shutdown": self._end}
        self._parent, self._ended = os.getppid(), False
        self._reading: ArmReading | None = None
        self._accepted = 0
        self._target: ArmTarget | None = None
        self._arrival = self._advanced = time.perf_counter()
        self._holding = self._lost = False
        self._fault: str | None = None
        self._backlog_s = 0.0
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the recorder also gets it and ends this process cleanly
        signal.signal(signal.SIGTERM, self._end)
        self._observe()

    def run(self) -> None:
        """Ticks until the recorder has ended, then stops the arm and waits for rest. Never raises `RobotError`."""
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
            newest = self._command.read()
        except RobotError as error:  # a target that cannot be read
            self._fail(str(error))
            return
        if newest is None or newest[0] == self._accepted:
            self._stop_on_command_timeout()
            return
        if self._fault is not None or not self._try(self._read) or self._fault is not None:
            return
        target: ArmTarget = newest[1]
        assert self._reading is not None
        if problem := malformed(target, self._options, self._reading.tcp_in_base):
            self._fail(problem)
            return
        self._arrival, self._holding = time.perf_counter(), False
        begin = self._backend.begin_keyframe if target.execution is Execution.KEYFRAME else self._backend.stream
        if self._try(lambda: begin(target)):
            self._accepted, self._target = newest[0], target

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
        state = (self._reading, self._accepted, self._fault, self._lost)
        self._status.write(ArmStatus(time.perf_counter(), *state))

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

        def handle(values: dict[str, Any]) -> dict[str, Any]:
            began = time.perf_counter()
            answer = handler(values)
            self._advanced += time.perf_counter() - began  # the arm could not move during this time
            if ask == RESET:
                self._backlog_s = 0.0
            self._observe()
            return answer

        return handle

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
        self._backlog_s = KEYFRAME_S if whole else self._backlog_s + 1.0 / fps
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
            until = time.perf_counter() + REST_S
            while time.perf_counter() < until:
                self._backend.tick()
                reading = self._backend.read()
                if reading.mode is not ArmMode.MOVING and abs(reading.qvel).max() < REST_SPEED:
                    return
                if not self._lockstep:
                    time.sleep(self._backend.period)


# Checks ---------------------------------------------------------------------------------------------------------------


def malformed(target: ArmTarget, options: ServerOptions, tcp_in_base: Array) -> str | None:
    """Returns why a target is refused, given the measured pose (4, 4); None for a valid target.

    The recorder's filter blocks such targets. This check detects a recorder without the filter.
    """
    pose = target.pose.astype(np.float64)
    if pose.shape != (ACTION_DIM,) or not np.isfinite(pose).all():
        return f"A target that is no pose reached the arm's process: {pose.tolist()}"
    rows = pose[ROTATION_DIMS].reshape(2, 3)
    if np.abs(rows @ rows.T - np.eye(2)).max() > ROTATION_ERROR:
        return f"A target whose rotation is none reached the arm's process: {rows.ravel().tolist()}"
    goal, _ = pose_from_vector(pose)
    if options.limits is None:
        return None
    if not options.limits.contains(goal, BOX_ROUNDING):
        return f"A target with the hand outside the box reached the arm's process: {pose[:GRIPPER_DIM].tolist()}"
    if target.execution is Execution.STREAM:
        ahead, turned = pose_error(tcp_in_base, goal)
        if ahead > MAX_LEADS * options.limits.lead or turned > MAX_LEADS * options.limits.angular_lead:
            return (
                f"A target that jumps reached the arm's process: {ahead:.3f} m, {turned:.3f} rad from where the arm is"
            )
    return None


def trouble(reading: ArmReading, stood_still: float, state_age: float) -> str | None:
    """Returns why the arm must not move; None if it may. ``stood_still``: time since its clock last advanced [s]."""
    if reading.mode in STOPPED_MODES or reading.errors:
        what = STOPPED_MODES.get(reading.mode, "The arm reports errors")
        return f"{what}: {', '.join(reading.errors) or 'no flag is set'}."
    if stood_still > state_age:
        return f"The arm's state is {stood_still:.2f} s old, more than {state_age:g} s: its connection stands still."
    return None


# Program --------------------------------------------------------------------------------------------------------------


def main(socket: int, memory: int, factory_name: str) -> int:
    """Runs the arm process to its end and returns its exit status.

    Args:
        socket: inherited descriptor of the socket.
        memory: inherited descriptor of the shared memory.
        factory_name: ``module:function`` of a `BackendFactory`. The module registers its options as a message.
    """
    connection = Connection(socket)
    served = None
    try:
        factory: BackendFactory = pkgutil.resolve_name(factory_name)
        start = decode(connection.recv_bytes(), Start)
        boxes = map_mailboxes(memory, start.capacities)
        served = factory(start.options, boxes)
        with killed_with_parent():
            served.backend.connect()
    except Exception as error:
        _reply(connection, Reply(0, _text_of(error)))
        if served is not None:
            served.backend.close()
        return 1
    try:
        server = ArmServer(served, connection, boxes, start.server)
        _reply(connection, Reply(0, None, served.describe()))
        server.run()
    except Exception as error:
        _reply(connection, Reply(0, f"the arm's process failed: {_text_of(error)}"))
        raise
    finally:
        served.backend.close()
    return 0


def _reply(connection: Connection, reply: Reply) -> None:
    with contextlib.suppress(OSError):
        connection.send_bytes(encode(reply))


def _text_of(error: Exception) -> str:
    return (str(error) if isinstance(error, AdaManipError) else f"{type(error).__name__}: {error}")[:MAX_TEXT]


@contextlib.contextmanager
def killed_with_parent() -> Iterator[None]:
    """Makes the kernel kill this process if its parent dies within the context.

    For driver calls that may hang before the arm moves: no other code checks the parent then.
    """
    parent, library = os.getppid(), ctypes.CDLL(None, use_errno=True)
    if library.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:  # the parent died before the request to the kernel
        os.kill(os.getpid(), signal.SIGKILL)
    try:
        yield
    finally:
        library.prctl(PR_SET_PDEATHSIG, 0, 0, 0, 0)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]))
