"""Base class of the cameras: timestamped frames, waiting for a frame, and an error for a stale frame."""

from __future__ import annotations

import abc
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig
from numpy.typing import NDArray

from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.closing import closing_on_error
from lerobot_adamanip.util.errors import RobotError

MAX_AGE = 0.5
"""Maximum age of a camera's latest frame [s]. All supported cameras run at 4 Hz or faster."""
STOP_TIMEOUT = 2.0
"""Maximum wait for the reading thread to end [s]."""
QUEUED_PICTURES, DRIVER_DELAY_S = 4, 0.1
"""Upper bound of the time from exposure to arrival: pictures in a driver's queue, and a delay [s]."""
SLOWEST_FPS = 10
"""Assumed rate of a camera that does not report its rate [Hz]."""


def max_latency(fps: float | None) -> float:
    """Returns the longest time [s] from exposure to arrival of a camera with this rate [Hz]."""
    return DRIVER_DELAY_S + QUEUED_PICTURES / (fps or SLOWEST_FPS)


class LatestFrame:
    """Newest frame, shared between the reading thread and its consumers. Thread-safe."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.clear()

    def clear(self) -> None:
        """Removes the frame and the failure."""
        self._taken = -1
        self._set(None, None)

    def put(self, frame: Frame) -> None:
        """Replaces the frame."""
        self._set(frame, self.failure)

    def fail(self, error: Exception) -> None:
        """Stores a failure: waiting and later calls return None."""
        self._set(self._frame, error)

    def _set(self, frame: Frame | None, failure: Exception | None) -> None:
        with self._changed:
            self._frame, self.failure = frame, failure
            self._changed.notify_all()

    def latest(self) -> Frame | None:
        """Returns the last frame of any age; None before the first."""
        return self._frame

    def after(self, stamp: float, timeout: float) -> Frame | None:
        """Returns a frame exposed after ``stamp`` [s]; None after ``timeout`` [s]."""
        return self._wait(lambda frame: frame.stamp > stamp, timeout)

    def next(self, timeout: float) -> Frame | None:
        """Returns a frame that `next` has not returned yet; None after ``timeout`` [s]. Used by ``async_read``."""
        frame = self._wait(lambda frame: frame.number != self._taken, timeout)
        self._taken = self._taken if frame is None else frame.number
        return frame

    def _wait(self, is_due: Callable[[Frame], bool], timeout: float) -> Frame | None:
        def ready() -> bool:
            return self._frame is not None and is_due(self._frame)

        with self._changed:
            self._changed.wait_for(lambda: self.failure is not None or ready(), timeout)
            return self._frame if ready() else None


class FrameReader:
    """Mixin with all read methods for a LeRobot camera whose thread fills ``frames``.

    The methods never return a frame that is too old. They raise `RobotError` with the camera's name instead.

    Attributes:
        name: camera name in errors.
        frames: buffer that the thread fills.
        use_rgb, use_depth: whether frames have colour, depth.
    """

    name: str
    frames: LatestFrame
    use_rgb: bool
    use_depth: bool

    def wake(self, *, new: bool = False) -> None:
        """Requests a frame, if the camera takes frames on demand. Called before each read. ``new``: an unread frame."""

    def latest_frame(self, max_age: float = MAX_AGE) -> Frame:
        """Returns the last frame at once.

        Raises:
            RobotError: there is no frame yet, its exposure is older than ``max_age`` [s], or the camera has failed.
        """
        self.wake()
        frame = self.frames.latest()
        if self.frames.failure is not None:
            raise self._failed()
        age = float("inf") if frame is None else time.perf_counter() - frame.stamp
        if frame is None or age > max_age:
            got = "no frame yet" if frame is None else f"a latest frame that is {age:.2f} s old"
            raise self._error("It is frozen.", got, f"frames not older than {max_age:.2f} s")
        return frame

    def frame_after(self, stamp: float, timeout: float = MAX_AGE) -> Frame:
        """Returns a frame exposed after ``stamp`` (`time.perf_counter()`, [s]), e.g. after the arm came to rest.

        Raises:
            RobotError: no frame came within ``timeout`` [s], or the camera has failed.
        """
        self.wake(new=True)
        return self._require(self.frames.after(stamp, timeout), timeout)

    # LeRobot's read methods: colour (H, W, 3), depth (H, W, 1) [mm]. All raise `RobotError`.

    def read(self) -> NDArray[np.uint8]:
        """Returns the colour of a frame exposed after this call."""
        return self._color(self.frame_after(time.perf_counter(), timeout=2 * MAX_AGE))

    def read_depth(self, timeout_ms: float = 2e3 * MAX_AGE) -> NDArray[np.uint16]:
        """Returns the depth of a frame exposed after this call."""
        return self._depth(self.frame_after(time.perf_counter(), timeout_ms / 1e3))

    def read_latest(self, max_age_ms: float = 1e3 * MAX_AGE) -> NDArray[np.uint8]:
        """Returns the colour of `latest_frame`."""
        return self._color(self.latest_frame(max_age_ms / 1e3))

    def read_latest_depth(self, max_age_ms: float = 1e3 * MAX_AGE) -> NDArray[np.uint16]:
        """Returns the depth of `latest_frame`."""
        return self._depth(self.latest_frame(max_age_ms / 1e3))

    def async_read(self, timeout_ms: float = 200) -> NDArray[np.uint8]:
        """Returns the colour of a frame that no async method has returned yet."""
        return self._color(self._next_frame(timeout_ms / 1e3))

    def async_read_depth(self, timeout_ms: float = 200) -> NDArray[np.uint16]:
        """Returns the depth of a frame that no async method has returned yet."""
        return self._depth(self._next_frame(timeout_ms / 1e3))

    def _next_frame(self, timeout: float) -> Frame:
        self.wake(new=True)
        return self._require(self.frames.next(timeout), timeout)

    def _require(self, frame: Frame | None, timeout: float) -> Frame:
        if self.frames.failure is not None:
            raise self._failed()
        if frame is not None:
            return frame
        raise self._error("It is frozen.", f"no new frame for {timeout:.2f} s", "frames at its rate")

    def _color(self, frame: Frame) -> NDArray[np.uint8]:
        if frame.color is None:
            raise self._error("It takes no colour.", "use_rgb=false", "use_rgb=true")
        return frame.color

    def _depth(self, frame: Frame) -> NDArray[np.uint16]:
        if frame.depth is None:
            raise self._error("It takes no depth.", "use_depth=false", "use_depth=true")
        return frame.depth[..., None]

    def _failed(self) -> RobotError:
        error = self._error("It has failed.", self.frames.failure, "a camera that stays connected")
        error.__cause__ = self.frames.failure
        return error

    def _error(self, what: str, got: object, allowed: str) -> RobotError:
        hint = "check cable and port, then connect again; `lerobot-find-cameras` lists connected cameras"
        return RobotError(f"Camera {self.name}: {what}", got=got, allowed=allowed, hint=hint)

    def _deliver(self, take: Callable[[threading.Event], Frame | None], stop: threading.Event) -> None:
        """Runs in the thread: stores frames until ``stop`` is set. An exception becomes the failure."""
        try:
            while not stop.is_set():
                frame = take(stop)
                if frame is not None and not stop.is_set():
                    self.frames.put(frame)
        except Exception as error:  # any SDK may raise any type
            if not stop.is_set():
                self.frames.fail(error)


class ThreadedCamera(FrameReader, Camera):
    """A LeRobot camera with one reading thread from `connect` to `disconnect`.

    Args:
        config: LeRobot's camera configuration.
        name: camera name in errors.
    """

    warmup_seconds = 5.0
    """Maximum wait for the first frame [s]."""

    def __init__(self, config: CameraConfig, name: str) -> None:
        super().__init__(config)
        self.config, self.name = config, name
        self.use_rgb, self.use_depth = config.use_rgb, config.use_depth
        self.frames = LatestFrame()
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    @abc.abstractmethod
    def _open(self) -> None:
        """Opens the device and fills in unset ``width``, ``height`` and ``fps``. Raises `RobotError`."""

    @abc.abstractmethod
    def _take(self, stop: threading.Event) -> Frame | None:
        """Returns the next frame; None after some tenths of a second. May raise any exception."""

    @abc.abstractmethod
    def _close(self) -> None:
        """Closes the device. Idempotent."""

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Returns an empty list: cameras of this kind cannot be listed."""
        return []

    @property
    def is_connected(self) -> bool:
        """Whether the camera is open. A failed camera stays open until `disconnect`."""
        return self._thread is not None

    def connect(self, warmup: bool = True) -> None:
        """Opens the device and starts the thread. With ``warmup``, waits for the first frame. Raises `RobotError`."""
        if self.is_connected:
            raise self._error("It is connected already.", "a second connect()", "one, or disconnect() before")
        with closing_on_error(self.disconnect):
            self._open()
            self.frames.clear()
            self._stop = threading.Event()
            name = f"camera {self.name}"
            thread = threading.Thread(target=self._deliver, args=(self._take, self._stop), name=name, daemon=True)
            thread.start()
            self._thread = thread
            if warmup:
                self.frame_after(float("-inf"), timeout=self.warmup_seconds)

    def disconnect(self) -> None:
        """Stops the thread and closes the device. Idempotent."""
        thread, self._thread = self._thread, None
        self._stop.set()
        if thread is not None and thread is not threading.current_thread():
            thread.join(STOP_TIMEOUT)
        self.frames.clear()
        self._close()
