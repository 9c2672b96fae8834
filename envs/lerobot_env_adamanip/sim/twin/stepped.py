"""A blocking motion in slices of one tick."""

from __future__ import annotations

import threading
from collections.abc import Callable


class MotionAbortedError(Exception):
    """Raised within a motion that is given up, where it would have ticked next."""


class SteppedMotion:
    """Runs a blocking motion in slices of a tick, on a thread that is awake only while `step` waits for it.

    Two threads never run at once: nothing has to be locked, and ticks are the same as without slices.

    Args:
        run: the motion, e.g. `KeyframeDriver.execute`; calls `pause` after each of its ticks.
    """

    def __init__(self, run: Callable[[], object]) -> None:
        self._run = run
        self._go, self._paused = threading.Semaphore(0), threading.Semaphore(0)
        self._error: BaseException | None = None
        self._aborted = self.finished = False
        self._thread = threading.Thread(target=self._work, name="key frame", daemon=True)
        self._thread.start()

    def step(self) -> bool:
        """Runs up to the end of the next tick, or of the motion; True once it has ended. Raises what the motion did."""
        if not self.finished:
            self._go.release()
            self._paused.acquire()
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        return self.finished

    def abort(self) -> None:
        """Ends the motion where it is; it ticks no more. Idempotent."""
        self._aborted = True
        while not self.finished:
            self._go.release()
            self._paused.acquire()
        self._thread.join()
        self._error = None

    def pause(self) -> None:
        """Called by the motion after a tick. Raises `MotionAbortedError` where it is to end."""
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
        except BaseException as error:  # handed to who steps
            self._error = error
        finally:
            self.finished = True
            self._paused.release()
