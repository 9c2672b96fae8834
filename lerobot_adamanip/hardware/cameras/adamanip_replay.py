"""A camera that plays a recording in real time, to try a set-up without its camera."""

from __future__ import annotations

import threading
import time

from lerobot_adamanip.hardware.camera_frames import Frame, Intrinsics
from lerobot_adamanip.hardware.cameras.base import ThreadedCamera
from lerobot_adamanip.hardware.cameras.config_adamanip_replay import AdamanipReplayConfig
from lerobot_adamanip.hardware.cameras.recording import Recording
from lerobot_adamanip.util.errors import ConfigurationError

MAX_WAIT = 0.2
"""[s]"""


class AdamanipReplay(ThreadedCamera):
    """Delivers the frames of a recording as far apart as they were taken; late ones are dropped."""

    config: AdamanipReplayConfig

    def __init__(self, config: AdamanipReplayConfig) -> None:
        super().__init__(config, config.path.name)
        self._recording: Recording | None = None
        self._start, self._next = 0.0, 0

    def depth_intrinsics(self) -> Intrinsics:
        """Returns the recording's."""
        found = None if self._recording is None else self._recording.intrinsics
        return found if found is not None else super().depth_intrinsics()

    def _open(self) -> None:
        self._recording = recording = Recording.open(self.config.path)
        wanted = (self.config.fps, self.config.width, self.config.height)
        held = (recording.fps, recording.width, recording.height)
        if any(each is not None and each != known for each, known in zip(wanted, held, strict=True)):
            raise ConfigurationError(
                f"Camera {self.name} cannot play at another rate or size.",
                got="fps {}, width {}, height {}".format(*wanted),
                allowed="fps {}, width {}, height {}".format(*held),
                hint="none of the three",
            )
        recording.require(color=self.use_rgb, depth=self.use_depth)
        self.fps, self.width, self.height = held
        self._start, self._next = time.perf_counter(), 0

    def _take(self, stop: threading.Event) -> Frame | None:
        recording = self._recording
        assert recording is not None
        count = len(recording.stamps)
        if self._next >= count and not self.config.loop:
            stop.wait(MAX_WAIT)
            return None
        due = self._due(recording, self._next)
        if (left := due - time.perf_counter()) > 0:
            stop.wait(min(left, MAX_WAIT))
            if time.perf_counter() < due:
                return None
        number = self._next
        while time.perf_counter() > self._due(recording, number + 1):
            number += 1  # a late frame is dropped
        if number >= count and not self.config.loop:
            number = count - 1
        self._next = number + 1
        color, depth = recording.pictures(number % count, color=self.use_rgb, depth=self.use_depth)
        return Frame(self._due(recording, number), time.perf_counter(), color, depth, number)

    def _due(self, recording: Recording, number: int) -> float:
        """Returns when a frame is exposed [s]; rounds follow each other without a pause."""
        rounds, index = divmod(number, len(recording.stamps))
        return self._start + rounds * recording.duration + recording.stamps[index]

    def _close(self) -> None:
        self._recording = None
