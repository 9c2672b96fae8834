"""Camera of the twin: requests pictures from the twin process while they are read."""

from __future__ import annotations

import threading
import time

from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.base import MAX_AGE, ThreadedCamera
from lerobot_adamanip.util.errors import ConfigurationError, RobotError
from lerobot_env_adamanip.twin.config_devices import AdamanipTwinConfig

CAMERA_HZ = 10
"""Default rate in real time [Hz]."""
WANTED_FOR = 1.0
"""Time without a read after which the camera stops taking pictures [s]."""
LOOK_TIME = 120.0
"""Time limit for a picture [s]. The first one compiles shaders."""


class AdamanipTwin(ThreadedCamera):
    """A camera of the twin's scene.

    In real time its thread takes pictures at ``fps`` while they are read; the first read after a pause waits for one.
    In lockstep each read takes a picture, at most one per step, so that equal steps give equal data.
    """

    config_class = AdamanipTwinConfig
    config: AdamanipTwinConfig
    warmup_seconds = LOOK_TIME

    def __init__(self, config: AdamanipTwinConfig) -> None:
        super().__init__(config, "twin")
        self._client: ArmClient | None = None
        self._view = ""
        self._lockstep = False
        self._wanted = self._due = 0.0
        self._seen_at: float | None = None

    def attach(self, client: ArmClient, view: str, *, size: int, lockstep: bool) -> None:
        """Attaches the camera to a view of the twin process, before `connect`.

        Raises `ConfigurationError` for another size.
        """
        if any(side not in (None, size) for side in (self.config.width, self.config.height)):
            raise ConfigurationError(
                "The camera's size differs from the twin's image size.",
                got=f"{self.config.width} x {self.config.height} px",
                allowed=f"{size} x {size}, or none",
                hint="--robot.image_size=256",
            )
        self._client, self._view, self._lockstep = client, view, lockstep
        self.width = self.height = size
        self.fps = self.config.fps or CAMERA_HZ

    def wake(self, *, new: bool = False) -> None:
        """Requests a frame. In lockstep, takes one if this step has none or ``new`` is set."""
        self._wanted = time.perf_counter()
        if self._lockstep and self.is_connected:
            assert self._client is not None
            reading = self._client.status().reading
            now = None if reading is None else reading.robot_time
            if new or self._seen_at is None or now != self._seen_at:
                self.frames.put(self._look())
                self._seen_at = now

    def latest_frame(self, max_age: float = MAX_AGE) -> Frame:
        """Returns the last frame; in lockstep, the frame of this step; after a pause, a new one."""
        now = time.perf_counter()
        if self._lockstep and self.is_connected:
            return super().latest_frame(float("inf"))
        return self.frame_after(now - max_age) if now - self._wanted > WANTED_FOR else super().latest_frame(max_age)

    def frame_after(self, stamp: float, timeout: float = MAX_AGE) -> Frame:
        """Returns a frame exposed after ``stamp``; in lockstep, a new one. Waits `LOOK_TIME` or longer."""
        stamp = float("-inf") if self._lockstep and self.is_connected else stamp
        return super().frame_after(stamp, max(timeout, LOOK_TIME))

    def _open(self) -> None:
        if self._client is None or not self._client.is_connected:
            raise RobotError(
                "The twin's camera has no twin.",
                got="a camera without its robot",
                allowed="a camera of --robot.type=adamanip_franka_sim",
                hint="lerobot-find-cameras does not show it",
            )
        self._seen_at = None
        self._wanted = self._due = time.perf_counter()

    def _take(self, stop: threading.Event) -> Frame | None:
        now = time.perf_counter()
        if self._lockstep or now - self._wanted > WANTED_FOR or now < self._due:
            stop.wait(WANTED_FOR if self._lockstep else 0.005 if now < self._due else 0.02)
            return None
        self._due = max(self._due + 1.0 / (self.fps or CAMERA_HZ), now)
        return self._look()

    def _look(self) -> Frame:
        """Takes a picture. In lockstep its stamp is that of the last reading."""
        assert self._client is not None
        self._client.request("look", {"camera": self._view, "depth": self.use_depth}, time_limit=LOOK_TIME)
        latest = self._client.frame(self._view)
        if latest is None:
            raise RobotError("The twin has taken no picture.")
        frame: Frame = latest[1]
        arrival = time.perf_counter()
        reading = self._client.status().reading if self._lockstep else None
        stamp = frame.stamp if reading is None else reading.stamp
        return Frame(stamp, arrival, frame.color if self.use_rgb else None, frame.depth, frame.number)

    def _close(self) -> None:
        self._seen_at = None
