"""Frames of cameras, and pictures of an observation."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.hardware.adamanip_franka.observed import (
    check_cameras,
    pictures,
)
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.base import MAX_AGE, FrameReader, LatestFrame, ThreadedCamera, max_latency
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

HEIGHT, WIDTH = 24, 32


def numbered_frame(number: int, stamp: float, height: int = HEIGHT, width: int = WIDTH) -> Frame:
    """A frame of which every pixel of colour and depth says its number."""
    color = np.full((height, width, 3), number % 256, np.uint8)
    return Frame(stamp, stamp, color, np.full((height, width), 500 + number, np.uint16), number)


class ScriptedCamera(ThreadedCamera):
    """Delivers a frame whenever a test says so."""

    def __init__(self) -> None:
        super().__init__(SimpleNamespace(fps=30, width=WIDTH, height=HEIGHT, use_rgb=True, use_depth=True), "bench")
        self.due = threading.Semaphore(0)
        self.trouble: Exception | None = None
        self.number, self.closed = 0, 0

    def _open(self) -> None:
        self.number = 0

    def _take(self, stop: threading.Event) -> Frame | None:
        if not self.due.acquire(timeout=0.05):
            return None
        if self.trouble is not None:
            raise self.trouble
        self.number += 1
        return numbered_frame(self.number, time.perf_counter())

    def _close(self) -> None:
        self.closed += 1


@pytest.fixture
def camera() -> Iterator[ScriptedCamera]:
    camera = ScriptedCamera()
    camera.connect(warmup=False)
    yield camera
    camera.disconnect()


def test_a_frame_after_a_moment_was_exposed_after_it(camera: ScriptedCamera) -> None:
    camera.due.release()
    first = camera.frame_after(0.0, 2.0)
    rest = time.perf_counter()
    threading.Timer(0.05, camera.due.release).start()
    second = camera.frame_after(rest, 2.0)
    assert (first.number, second.number) == (1, 2)
    assert first.stamp < rest < second.stamp


def test_a_frozen_camera_is_named_and_its_last_frame_never_given(camera: ScriptedCamera) -> None:
    camera.due.release()
    frame = camera.frame_after(0.0, 2.0)
    for read in (
        lambda: camera.frame_after(frame.stamp, 0.1),
        lambda: camera.read_latest(max_age_ms=0),
        lambda: camera.latest_frame(max_age=0.0),
        lambda: camera.read_latest_depth(max_age_ms=0),
    ):
        with pytest.raises(RobotError, match="Camera bench: It is frozen") as caught:
            read()
        assert "try:" in str(caught.value)
    assert camera.async_read(timeout_ms=100)[0, 0, 0] == 1  # not read this way before
    with pytest.raises(RobotError, match=r"bench.*frozen"):
        camera.async_read(timeout_ms=100)
    now = time.perf_counter()  # exposed long ago, and arrived just now
    late = numbered_frame(7, now - MAX_AGE - 1)
    camera.frames.put(Frame(late.stamp, now, late.color, late.depth, 7))
    with pytest.raises(RobotError, match="frozen"):
        camera.latest_frame()


def test_a_camera_that_fails_says_why_at_once(camera: ScriptedCamera) -> None:
    camera.trouble = OSError("device gone")
    threading.Timer(0.05, camera.due.release).start()
    start = time.perf_counter()
    with pytest.raises(RobotError, match="bench: It has failed") as caught:
        camera.frame_after(start, timeout=20.0)
    assert time.perf_counter() - start < 5
    assert "device gone" in str(caught.value)
    assert isinstance(caught.value.__cause__, OSError)
    with pytest.raises(RobotError, match="device gone"):
        camera.latest_frame()
    camera.disconnect()
    camera.trouble = None
    camera.connect(warmup=False)
    camera.due.release()
    assert camera.frame_after(0.0, 2.0).number == 1


def test_connecting_waits_for_the_first_frame_and_closes_where_none_comes() -> None:
    camera = ScriptedCamera()
    camera.warmup_seconds = 0.2
    with pytest.raises(RobotError, match="bench"):
        camera.connect()
    assert not camera.is_connected
    assert camera.closed >= 1
    camera.due.release()
    camera.connect()
    assert camera.read_latest_depth().shape == (HEIGHT, WIDTH, 1)
    with pytest.raises(RobotError, match="connected already"):
        camera.connect()
    camera.disconnect()
    camera.disconnect()


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


DELAY = max_latency(OpenCVCamera.fps)
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
