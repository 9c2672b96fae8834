"""Runs a blocking motion in slices of one tick."""

from __future__ import annotations

import threading
from collections.abc import Callable


class MotionAbortedError(Exception):
    """Raised in an aborted motion in place of its next tick."""


class SteppedMotion:
    """Runs a blocking motion in slices of one tick, in a thread that runs only while `step` waits for it.

    The two threads never run at once. So no locks are needed, and the ticks are the same as without slices.

    Args:
        run: motion, e.g. `KeyframeDriver.execute`, that calls `pause` after each tick.
    """

    def __init__(self, run: Callable[[], object]) -> None:
        self._run = run
        self._go, self._paused = threading.Semaphore(0), threading.Semaphore(0)
        self._error: BaseException | None = None
        self._aborted = self.finished = False
        self._thread = threading.Thread(target=self._work, name="key frame", daemon=True)
        self._thread.start()

    def step(self) -> bool:
        """Runs until the end of the next tick. Returns whether the motion has ended. Raises the motion's exception."""
        if not self.finished:
            self._go.release()
            self._paused.acquire()
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        return self.finished

    def abort(self) -> None:
        """Ends the motion without a further tick. Idempotent."""
        self._aborted = True
        while not self.finished:
            self._go.release()
            self._paused.acquire()
        self._thread.join()
        self._error = None

    def pause(self) -> None:
        """Ends a slice. The motion calls it after each tick. Raises `MotionAbortedError` after `abort`."""
        if threading.current_thread() is not self._thread:
            return
        self._paused.release()
        self._go.acquire()
        if self._aborted:
            raise MotionAbortedError

    def _work(self) -> None:
        self._go.acquire()
        try:
            if not self._aborted:
                self._run()
        except MotionAbortedError:
            pass
        except BaseException as error:  # raised again in `step`
            self._error = error
        finally:
            self.finished = True
            self._paused.release()
