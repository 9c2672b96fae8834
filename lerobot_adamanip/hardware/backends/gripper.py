"""The gripper: Franka's hand, opened and closed by a thread, so that the arm's loop never waits for it.

Franka's hand takes 0.5-0.9 s for a command and refuses a second one meanwhile. So the thread sends a command only when
the requested opening crosses the middle, and only the newest one.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

from lerobot_adamanip.hardware.backends.franky_options import GRIPPER_SPEED
from lerobot_adamanip.hardware.backends.franky_sdk import import_franky
from lerobot_adamanip.util.errors import RobotError

OPEN_ABOVE, CLOSE_BELOW = 0.55, 0.45
"""Thresholds of the requested opening [0 closed, 1 open]. Between the two nothing changes."""
OPEN_ENOUGH = 0.95
"""Opening above which the fingers need no initial open command."""
READ_PERIOD_S, CONNECT_S, CLOSE_S = 0.05, 10.0, 0.5
"""Time between readings, and time limits of connect and close."""


class FrankyHand:
    """A Franka Hand with a grasp force [N]. `open` and `close` may take 1 s; `opening` may be called meanwhile."""

    def __init__(self, address: str, force: float) -> None:
        self._hand, self._force = import_franky().Gripper(address), force
        self._max_width = float(self._hand.max_width)
        if self._max_width <= 0:
            raise RobotError("The gripper's width is unknown: home it once, in Desk or with franky's Gripper.homing().")

    def open(self) -> None:
        """Opens the hand completely."""
        self._command(lambda: self._hand.move(self._max_width, GRIPPER_SPEED))

    def close(self) -> None:
        """Closes on an object of any width and holds it."""
        self._command(lambda: self._hand.grasp(0.0, GRIPPER_SPEED, self._force, epsilon_outer=1.0))

    def _command(self, call: Callable[[], bool]) -> None:
        """Calls the gripper. An empty grasp or a blocked move is not an error: the width shows it."""
        with contextlib.suppress(import_franky().CommandException):
            call()

    def opening(self) -> float:
        """Returns the opening: width / maximum width."""
        return min(1.0, max(0.0, float(self._hand.width) / self._max_width))

    def stop(self) -> None:
        """Stops the current command."""
        self._hand.stop()


class GripperThread:
    """Executes the requested opening and reads the current one. ``connect`` creates the hand in the command thread.

    Attributes:
        opening: last reading, 0 closed ... 1 open.
    """

    def __init__(self, connect: Callable[[], FrankyHand]) -> None:
        self._connect = connect
        self._wake, self._stopping, self._ready = threading.Event(), threading.Event(), threading.Event()
        self._reading = threading.Lock()
        self._wanted: bool | None = None
        self._done: bool | None = None
        self._error = ""
        self.opening = 1.0
        self._hand: FrankyHand | None = None
        self._commander = threading.Thread(target=self._carry_out, name="gripper", daemon=True)
        self._reader = threading.Thread(target=self._keep_reading, name="gripper reader", daemon=True)

    def start(self) -> None:
        """Connects. Raises `RobotError` if that fails or takes longer than `CONNECT_S`."""
        self._commander.start()
        if not self._ready.wait(CONNECT_S):
            raise RobotError(f"The gripper did not connect within {CONNECT_S:g} s.")
        self.check()

    def want(self, opening: float) -> None:
        """Sets the requested opening, 0 closed ... 1 open. Returns at once."""
        if CLOSE_BELOW <= opening <= OPEN_ABOVE:
            return
        if self._wanted is None and opening > OPEN_ABOVE and self.opening > OPEN_ENOUGH:
            self._done = True
        self._wanted = opening > OPEN_ABOVE
        self._wake.set()  # always: `_done` is out of date during a command

    @property
    def busy(self) -> bool:
        """Returns whether a command is pending."""
        return self._wanted is not None and self._wanted != self._done and not self._error

    def check(self) -> None:
        """Raises `RobotError` if the gripper has failed."""
        if self._error:
            raise RobotError(f"The gripper failed: {self._error}")

    def forgive(self) -> None:
        """Clears a failure and the requested opening."""
        self._error, self._wanted, self._done = "", None, None

    def close(self) -> None:
        """Stops the current command and ends the threads, waiting at most `CLOSE_S`."""
        self._stopping.set()
        self._wake.set()
        if self.busy and self._hand is not None:
            with contextlib.suppress(Exception):
                self._hand.stop()
        until = time.perf_counter() + CLOSE_S
        for thread in (self._commander, self._reader):
            if thread.is_alive():
                thread.join(max(0.0, until - time.perf_counter()))

    def _carry_out(self) -> None:
        self._guarded(self._open_hand)
        self._ready.set()
        while not self._stopping.is_set():
            self._wake.wait()
            self._wake.clear()
            if not self._stopping.is_set():
                self._guarded(self._command)

    def _keep_reading(self) -> None:
        """Reads the opening repeatedly, also during commands."""
        while not self._stopping.wait(READ_PERIOD_S):
            self._guarded(self._read)

    def _guarded(self, call: Callable[[], None]) -> None:
        """Calls the hand unless it has failed. Keeps any error for `check`."""
        if not self._error:
            try:
                call()
            except Exception as error:
                self._error = f"{type(error).__name__}: {error}"

    def _open_hand(self) -> None:
        self._hand = self._connect()
        self._read()
        self._reader.start()

    def _command(self) -> None:
        opens = self._wanted
        if self._hand is not None and opens is not None and opens != self._done:
            self._hand.open() if opens else self._hand.close()
            self._read()
            self._done = opens

    def _read(self) -> None:
        assert self._hand is not None
        with self._reading:  # an older reading must not overwrite one taken after a command's end
            self.opening = self._hand.opening()
