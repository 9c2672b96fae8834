"""Thread that opens and closes a gripper, so that the arm's loop never waits for it.

Franka's hand takes 0.5-0.9 s for a command and accepts no second one before. So a command is given only when the wanted
opening crosses the middle, and only the newest.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Protocol

from lerobot_adamanip.util.errors import RobotError

OPEN_ABOVE, CLOSE_BELOW = 0.55, 0.45
"""Wanted openings [0 closed, 1 open]; between the two nothing changes."""
WIDE = 0.95
"""Opening of fingers that need not be opened at first."""
READ_PERIOD = 0.05
"""[s]"""


class Hand(Protocol):
    """A gripper whose calls may take a second. `opening` is called while another thread is in `open` or `close`."""

    def open(self) -> None:
        """Opens as far as it goes."""

    def close(self) -> None:
        """Closes on an object, and holds it."""

    def opening(self) -> float:
        """Returns the present opening, 0 closed ... 1 open."""

    def stop(self) -> None:
        """Ends a command under way."""


class GripperThread:
    """Executes the wanted opening and reads the present one; ``connect`` makes the hand in the commanding thread."""

    def __init__(self, connect: Callable[[], Hand]) -> None:
        self._connect = connect
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._ready, self._reading = threading.Event(), threading.Lock()
        self._wanted: bool | None = None
        self._done: bool | None = None
        self._opening, self._error = 1.0, ""
        self.commands = 0
        self._hand: Hand | None = None
        self._thread = threading.Thread(target=self._run, name="gripper", daemon=True)
        self._looks = threading.Thread(target=self._look, name="gripper's eye", daemon=True)

    def start(self, time_limit: float = 10.0) -> None:
        """Connects. Raises `RobotError` if that fails or takes longer than ``time_limit`` [s]."""
        self._thread.start()
        if not self._ready.wait(time_limit):
            raise RobotError(f"The gripper did not connect within {time_limit:g} s.")
        self.check()

    def want(self, opening: float) -> None:
        """Sets the wanted opening, 0 closed ... 1 open; returns at once."""
        if CLOSE_BELOW <= opening <= OPEN_ABOVE:
            return
        if self._wanted is None and opening > OPEN_ABOVE and self._opening > WIDE:
            self._done = True
        self._wanted = opening > OPEN_ABOVE
        if self._wanted != self._done:
            self._wake.set()

    @property
    def opening(self) -> float:
        """Last reading, 0 closed ... 1 open."""
        return self._opening

    @property
    def busy(self) -> bool:
        """Whether a command is outstanding."""
        return self._wanted is not None and self._wanted != self._done and not self._error

    def check(self) -> None:
        """Raises `RobotError` if the gripper has failed."""
        if self._error:
            raise RobotError(f"The gripper failed: {self._error}")

    def forgive(self) -> None:
        """Clears a failure and the wanted opening."""
        self._error, self._wanted, self._done = "", None, None

    def close(self, time_limit: float = 0.5) -> None:
        """Stops a command under way and ends the threads, waiting at most ``time_limit`` [s]."""
        self._stopping.set()
        self._wake.set()
        if self.busy and self._hand is not None:
            with contextlib.suppress(Exception):
                self._hand.stop()
        until = time.perf_counter() + time_limit
        for thread in (self._thread, self._looks):
            if thread.is_alive():
                thread.join(max(0.0, until - time.perf_counter()))

    def _run(self) -> None:
        try:
            self._hand = self._connect()
            self._opening = self._hand.opening()
            self._looks.start()
        except Exception as error:  # of whatever library: told by `check`
            self._error = f"{type(error).__name__}: {error}"
        self._ready.set()
        while not self._stopping.is_set():
            self._wake.wait()
            self._wake.clear()
            if self._hand is None or self._error or self._stopping.is_set():
                continue
            try:
                self._serve(self._hand)
            except Exception as error:
                self._error = f"{type(error).__name__}: {error}"

    def _serve(self, hand: Hand) -> None:
        wanted = self._wanted
        if wanted is not None and wanted != self._done:
            self.commands += 1
            hand.open() if wanted else hand.close()
            self._read(hand)
            self._done = wanted

    def _read(self, hand: Hand) -> None:
        with self._reading:  # a look from before a command's end does not overwrite one from after it
            self._opening = hand.opening()

    def _look(self) -> None:
        """Reads the opening, during commands as well."""
        while not self._stopping.wait(READ_PERIOD):
            if self._hand is None or self._error:
                continue
            try:
                self._read(self._hand)
            except Exception as error:
                self._error = f"{type(error).__name__}: {error}"
