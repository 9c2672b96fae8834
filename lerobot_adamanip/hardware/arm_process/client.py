"""Client of the arm process: starts it, sends targets, reads the newest state, and ends it."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import NO_PLUGIN
from lerobot_adamanip.hardware.arm import (
    COMMAND,
    STATUS,
    ArmStatus,
    ArmTarget,
    Execution,
    Reply,
    Request,
    ServerOptions,
    Start,
)
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox, create_memory, decode, encode, map_mailboxes
from lerobot_adamanip.util.errors import RobotError

PROGRAM = "lerobot_adamanip.hardware.arm_process.server"
COMMAND_BYTES, STATUS_BYTES = 1024, 16384
POLL_S = 0.002
CLOSE_S = 1.8
"""Time for the process to stop the arm and exit. Then it is killed, so that closing takes under 2 s."""
LOCKSTEP_S = 600.0
"""Longest step of a twin."""


class ArmClient:
    """One arm process, from `connect` to `close`. Use targets and states in one thread, frames in any.

    Args:
        factory: ``module:function`` of the backend, see `arm.BackendFactory`. A constant in the calling program.
        options: backend options, a registered `message`.
        server: watchdog settings of the process.
        frames: name -> size of further mailboxes that the backend fills [bytes].
        connect_time: time limit for start and connection [s].
    """

    def __init__(
        self,
        factory: str,
        options: object = None,
        *,
        server: ServerOptions | None = None,
        frames: Mapping[str, int] | None = None,
        connect_time: float = 30.0,
    ) -> None:
        self.server = server or ServerOptions()
        capacities = {COMMAND: COMMAND_BYTES, STATUS: STATUS_BYTES, **(frames or {})}
        self._factory, self._connect_time = factory, connect_time
        self._start_message = Start(options, self.server, capacities)
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._boxes: dict[str, Mailbox] = {}
        self._lock, self._requests = threading.RLock(), 0

    @property
    def is_connected(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    def connect(self) -> dict[str, Any]:
        """Starts the process, waits until its backend is connected, and returns the backend's description.

        Raises:
            RobotError: already connected, the backend cannot connect, or takes longer than ``connect_time``.
        """
        if self._process is not None:
            raise RobotError("The arm's process was started already.")
        try:
            self._start()
            return self._receive(0, self._connect_time, "connect")
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        memory = create_memory(self._start_message.capacities)
        self._boxes = map_mailboxes(memory, self._start_message.capacities)
        try:
            # A separate session: Ctrl-C in the recorder's terminal must reach the recorder before the arm process.
            self._process = subprocess.Popen(
                [sys.executable, "-m", PROGRAM, str(theirs.fileno()), str(memory), self._factory],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), memory),
                start_new_session=True,
                # Without LeRobot, whose import takes seconds, but with the import path of this process.
                env={**os.environ, NO_PLUGIN: "1", "PYTHONPATH": os.pathsep.join(sys.path)},
            )
        finally:
            theirs.close()
            os.close(memory)
        self._connection = Connection(ours.detach())
        with contextlib.suppress(OSError):  # a process that has already ended is reported by its exit status
            self._connection.send_bytes(encode(self._start_message))

    def close(self) -> None:
        """Stops the arm and ends the process; kills it after `CLOSE_S`. Idempotent; never raises."""
        process, connection = self._process, self._connection
        if connection is not None:
            with contextlib.suppress(OSError):  # without the lock, since another thread may wait for an answer
                self._send(Request(0, "shutdown"))
            with contextlib.suppress(OSError):
                connection.close()  # sends end of file to a process that reads no messages
        if process is not None:
            try:
                process.wait(CLOSE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._process = self._connection = None

    # States ----------------------------------------------------------------------------------------------------------

    def status(self) -> ArmStatus:
        """Returns the newest status, with or without a fault.

        Raises:
            RobotError: the process has ended, or published no status for `ServerOptions.state_age` seconds.
        """
        newest = self._box(STATUS).read()
        if not self.is_connected or newest is None:
            raise RobotError(self._last_words("has ended"))
        status: ArmStatus = newest[1]
        age = time.perf_counter() - status.beat
        if self.server.lockstep_fps is None and age > self.server.state_age:
            raise RobotError(
                "The arm's process publishes no state any more; a stop was requested.",
                got=f"a state that is {age:.2f} s old",
                allowed=f"{self.server.state_age:g} s",
                hint="is the robot reachable, and the machine not overloaded? Disconnect and connect again",
            )
        return status

    def healthy(self) -> ArmStatus:
        """Returns the newest status of a healthy arm. Raises `RobotError` for a fault, or as `status` does."""
        status = self.status()
        if status.fault is not None:
            recover = "check the arm, then --robot.recover_on_connect=true"
            hint = "disconnect and connect again" if status.lost else recover
            mode = "no state" if status.reading is None else status.reading.mode.name
            raise RobotError(status.fault, got=mode, allowed="no fault: nothing is accepted until then", hint=hint)
        return status

    def frame(self, name: str) -> tuple[int, Any] | None:
        """Returns (number, value) of the newest item in a backend mailbox; None before the first. Thread-safe."""
        return self._box(name).read()

    def _box(self, name: str) -> Mailbox:
        if not self._boxes:
            raise RobotError("The arm is not connected.")
        return self._boxes[name]

    # Targets ---------------------------------------------------------------------------------------------------------

    def send(self, pose: NDArray[np.float32], execution: Execution) -> int:
        """Sends a filtered target (10,) and returns its number for `wait`. In lockstep, waits for the step to finish.

        Raises:
            RobotError: see `healthy`.
        """
        self.healthy()
        number = self._box(COMMAND).write(ArmTarget(pose, execution, time.perf_counter()))
        if self.server.lockstep_fps is not None:
            self.request("step", time_limit=LOCKSTEP_S)
        return number

    def wait(self, number: int, time_limit: float) -> ArmStatus:
        """Waits for the end of the key frame with this number and returns its status.

        Raises:
            RobotError: see `healthy`; or ``time_limit`` [s] is exceeded. The arm is then stopped.
        """
        until = time.perf_counter() + time_limit
        while time.perf_counter() < until:
            status = self.healthy()
            if status.accepted >= number and status.reading is not None and status.reading.outcome is not None:
                return status
            time.sleep(POLL_S)
        self.post("stop")
        raise RobotError("A key frame does not end.", got=f"{time_limit:g} s", allowed="the backend's own time limit")

    # Requests --------------------------------------------------------------------------------------------------------

    def request(self, ask: str, values: Mapping[str, Any] | None = None, *, time_limit: float = 10.0) -> dict[str, Any]:
        """Sends ``stop``, ``recover`` or a backend request and returns the answer.

        Raises:
            RobotError: the process refuses, has ended, or does not answer within ``time_limit`` [s].
        """
        with self._lock:
            self._requests += 1
            try:
                self._send(Request(self._requests, ask, dict(values or {})))
            except OSError as error:
                raise RobotError(self._last_words(f"cannot be asked for {ask!r} ({error})")) from None
            return self._receive(self._requests, time_limit, ask)

    def post(self, ask: str, values: Mapping[str, Any] | None = None) -> None:
        """Sends a request without waiting for an answer. Does nothing if the process has ended."""
        with self._lock, contextlib.suppress(OSError):
            self._send(Request(0, ask, dict(values or {})))

    def _send(self, request: Request) -> None:
        if self._connection is None:
            raise OSError("not connected")
        self._connection.send_bytes(encode(request))

    def _receive(self, number: int, time_limit: float, ask: str) -> dict[str, Any]:
        """Returns the values of the reply with this number. Drops older replies."""
        until = time.perf_counter() + time_limit
        while self._connection is not None:
            if not self._connection.poll(max(0.0, until - time.perf_counter())):
                raise RobotError(f"The arm's process did not answer {ask!r} within {time_limit:g} s.")
            try:
                reply = decode(self._connection.recv_bytes(), Reply)
            except (EOFError, OSError) as error:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    if self._process is not None:
                        self._process.wait(1.0)  # collects its exit status
                raise RobotError(self._last_words(f"broke off at {ask!r} ({type(error).__name__})")) from None
            if reply.number in (number, 0):
                if reply.error is not None:
                    raise RobotError(reply.error)
                return reply.values
        raise RobotError(self._last_words(f"cannot be asked for {ask!r}"))

    def _last_words(self, what: str) -> str:
        """Returns a message with the last error of the process.

        If another thread waits for an answer, that thread reads and reports the error.
        """
        reason = ""
        if self._lock.acquire(blocking=False):
            try:
                with contextlib.suppress(OSError, EOFError):
                    while self._connection is not None and self._connection.poll(0):
                        reason = decode(self._connection.recv_bytes(), Reply).error or reason
            finally:
                self._lock.release()
        code = None if self._process is None else self._process.poll()
        return f"The arm's process {what}{'' if code is None else f' (exit status {code})'}. {reason}".strip()
