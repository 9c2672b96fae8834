from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.base import MAX_AGE, LatestFrame, ThreadedCamera
from lerobot_adamanip.util.errors import RobotError

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


def test_a_frame_without_depth_says_so(camera: ScriptedCamera) -> None:
    frame = numbered_frame(1, time.perf_counter())
    camera.frames.put(Frame(frame.stamp, frame.stamp, frame.color, None, 1))
    with pytest.raises(RobotError, match="takes no depth"):
        camera.async_read_depth()


def test_color_and_depth_that_are_read_together_are_of_one_frame() -> None:
    """Hammered from another thread."""
    slot, done = LatestFrame(), threading.Event()

    def put() -> None:
        number = 0
        while not done.is_set():
            number = number % 60_000 + 1  # depth has sixteen bits
            slot.put(numbered_frame(number, time.perf_counter(), 2, 2))

    thread = threading.Thread(target=put)
    thread.start()
    for _ in range(300):
        frame = slot.after(0.0, 5.0)
        assert frame is not None
        assert frame.color is not None
        assert frame.depth is not None
        assert frame.color[0, 0, 0] == (frame.depth[0, 0] - 500) % 256
    done.set()
    thread.join()
