"""Clock for time limits of other processes."""

from __future__ import annotations

import time
from collections.abc import Callable


class RunningTime:
    """Clock that hardly advances while this process is stopped: no worker may count as hanging because of that.

    A process stops for instance after Ctrl-Z, when its machine is paused, or while its caller handles a result.

    Args:
        max_step: maximum advance between two calls [s]. Call the clock more often than that.
        clock: source of the time [s].
    """

    def __init__(self, max_step: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._max_step, self._clock = max_step, clock
        self._latest, self._seconds = clock(), 0.0

    def __call__(self) -> float:
        """Returns the time [s]."""
        now = self._clock()
        self._seconds += min(now - self._latest, self._max_step)
        self._latest = now
        return self._seconds
