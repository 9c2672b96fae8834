"""Pictures of an observation: after a key frame they are newer than the arm's rest, from any class of camera."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.hardware.adamanip_franka.observed import (
    DRIVER_DELAY_S,
    QUEUED_PICTURES,
    check_cameras,
    pictures,
)
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.base import FrameReader, LatestFrame
from lerobot_adamanip.util.errors import ConfigurationError, RobotError


class StampedCamera(FrameReader):
    """A camera of this project without a thread."""

    name, use_rgb, use_depth = "bench", True, True

    def __init__(self, *exposed: float) -> None:
        self.frames = LatestFrame()
        for number, stamp in enumerate(exposed):
            self.expose(stamp, number)

    def expose(self, stamp: float, number: int) -> None:
        depth = np.full((2, 2), number, np.uint16)
        self.frames.put(Frame(stamp, time.perf_counter(), np.full((2, 2, 3), number, np.uint8), depth, number))


class OpenCVCamera:
    """LeRobot's camera as far as its pictures are read: their only time is that of their arrival."""

    use_rgb, fps = True, 30

    def __init__(self, arrived: float) -> None:
        self.latest_timestamp: float | None = arrived
        self.number = 1

    def read_latest(self, max_age_ms: int) -> Any:
        return np.full((2, 2, 3), self.number, np.uint8)

    def async_read(self) -> Any:
        raise AssertionError("it returns a picture that may have waited since before the key frame")

    def deliver(self) -> None:
        self.latest_timestamp, self.number = time.perf_counter(), 2


DELAY = DRIVER_DELAY_S + QUEUED_PICTURES / OpenCVCamera.fps
"""Time from rest until a picture of this camera counts as exposed after it [s]."""


def later(seconds: float, call: Any, *arguments: Any) -> None:
    threading.Timer(seconds, call, arguments).start()


def test_a_picture_from_before_the_rest_is_never_returned() -> None:
    rest = time.perf_counter()
    ours = StampedCamera(rest - 0.05)
    later(0.1, lambda: ours.expose(time.perf_counter(), 5))
    seen = pictures("front", ours, max_age=5.0, after=rest)  # type: ignore[arg-type]
    assert {key: int(image.flat[0]) for key, image in seen.items()} == {"front": 5, "front_depth": 5}

    stock = OpenCVCamera(arrived=rest + DELAY - 0.01)  # it arrived after the rest, and may be exposed before it
    later(DELAY + 0.1, stock.deliver)
    assert pictures("side", stock, max_age=5.0, after=rest)["side"].flat[0] == 2  # type: ignore[arg-type]
    assert pictures("side", stock, max_age=5.0, after=None)["side"].flat[0] == 2  # type: ignore[arg-type]


@pytest.mark.parametrize("camera", [StampedCamera(0.0), OpenCVCamera(0.0)])
def test_the_robots_camera_age_is_how_long_it_waits(camera: Any) -> None:
    for age in (0.05, 1.0):
        began = time.perf_counter()
        with pytest.raises(RobotError, match="frozen"):
            pictures("front", camera, max_age=age, after=began)
        assert age <= time.perf_counter() - began < age + DELAY + 0.5


def test_a_picture_of_after_the_rest_still_grows_too_old() -> None:
    now = time.perf_counter()
    camera: Any = StampedCamera(now - 1.0)
    assert pictures("front", camera, max_age=2.0, after=now - 1.5)["front"].flat[0] == 0
    with pytest.raises(RobotError, match="frozen"):
        pictures("front", camera, max_age=0.2, after=now - 1.5)


def test_a_failed_camera_has_no_last_picture() -> None:
    camera: Any = StampedCamera(time.perf_counter())
    camera.frames.fail(OSError("unplugged"))
    with pytest.raises(RobotError, match="unplugged"):
        pictures("front", camera, max_age=5.0, after=0.0)


def test_cameras_that_cannot_keep_the_promise_are_refused() -> None:
    ours, webcam, network = StampedCamera(), OpenCVCamera(0.0), SimpleNamespace()
    counts = SimpleNamespace(use_depth=True)  # LeRobot's RealSense class, of any unit
    good: Any = {"front": ours, "side": webcam}
    check_cameras(good, key_frames=True)
    check_cameras({**good, "far": network}, key_frames=False)  # type: ignore[dict-item]
    with pytest.raises(ConfigurationError, match=r"(?s)Camera far .*execution=stream"):
        check_cameras({**good, "far": network}, key_frames=True)  # type: ignore[dict-item]
    for key in ("front", "wrist"):
        with pytest.raises(ConfigurationError, match=rf"(?s)depth of camera {key} .*adamanip_realsense"):
            check_cameras({key: counts}, key_frames=False)  # type: ignore[dict-item]


def test_the_stamped_cameras_are_lerobots() -> None:
    from lerobot.cameras.opencv.camera_opencv import OpenCVCamera as Stock
    from lerobot.cameras.opencv.configuration_opencv import OpenCVCameraConfig

    camera = Stock(OpenCVCameraConfig(0))
    assert camera.latest_timestamp is None
    check_cameras({"side": camera}, key_frames=True)
