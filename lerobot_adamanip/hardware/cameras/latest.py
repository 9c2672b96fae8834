"""The latest frame of a camera, between the thread that delivers frames and those that want one."""

from __future__ import annotations

import threading
import time
from collections import deque

from lerobot_adamanip.hardware.camera_frames import Frame


class LatestFrame:
    """Holds one frame, whole: colour and depth of it are taken or left together. Safe to use from several threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._failure: Exception | None = None
        self._taken = -1

    def put(self, frame: Frame) -> None:
        """Replaces the frame and wakes who waits for it."""
        with self._changed:
            self._frame = frame
            self._changed.notify_all()

    def fail(self, error: Exception) -> None:
        """No frame will come any more: whoever waits, or asks later, is told why."""
        with self._changed:
            self._failure = error
            self._changed.notify_all()

    def clear(self) -> None:
        """As new: no frame, no failure."""
        with self._changed:
            self._frame, self._failure, self._taken = None, None, -1
            self._changed.notify_all()

    @property
    def failure(self) -> Exception | None:
        """Why no frame will come; None while some may."""
        return self._failure

    def latest(self) -> Frame | None:
        """Returns the frame that arrived last, however old it is; None before the first."""
        with self._changed:
            return self._frame

    def after(self, stamp: float, timeout: float) -> Frame | None:
        """Returns a frame exposed after ``stamp`` [s]; None if none came within ``timeout`` [s], or will."""
        end = time.perf_counter() + timeout
        with self._changed:
            while self._frame is None or self._frame.stamp <= stamp:
                left = end - time.perf_counter()
                if self._failure is not None or left <= 0:
                    return None
                self._changed.wait(left)
            return self._frame

    def next(self, timeout: float) -> Frame | None:
        """Returns a frame that `next` has not given yet, as `after` does: LeRobot's ``async_read``."""
        end = time.perf_counter() + timeout
        with self._changed:
            while self._frame is None or self._frame.number == self._taken:
                left = end - time.perf_counter()
                if self._failure is not None or left <= 0:
                    return None
                self._changed.wait(left)
            self._taken = self._frame.number
            return self._frame


class DeviceClock:
    """Maps a device's own clock to `time.perf_counter()` by the quickest arrivals: delays only ever add.

    The least delay itself stays unknown and is left in: a stamp is late by it, never early.

    Args:
        window: arrivals looked at. Clocks drift by some 50 millionths, which is 0.5 ms in 300 frames at 30 Hz.
    """

    def __init__(self, window: int = 300) -> None:
        self._offsets: deque[float] = deque(maxlen=window)

    def stamp(self, device: float, arrival: float) -> float:
        """Returns when a frame was exposed [s], given what its device says [s] and when it arrived [s]."""
        self._offsets.append(arrival - device)
        return device + min(self._offsets)
