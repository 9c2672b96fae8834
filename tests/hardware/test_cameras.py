from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from camera_helpers import HEIGHT, WIDTH, numbered_frame, write_numbered
from hypothesis import given
from hypothesis import strategies as st
from lerobot.cameras.utils import make_cameras_from_configs

from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.adamanip_realsense import DeviceClock
from lerobot_adamanip.hardware.cameras.adamanip_replay import AdamanipReplay
from lerobot_adamanip.hardware.cameras.base import MAX_AGE, LatestFrame, ThreadedCamera
from lerobot_adamanip.hardware.cameras.config_adamanip_replay import AdamanipReplayConfig
from lerobot_adamanip.hardware.cameras.recording import FILE, Recording
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError, RobotError


class ScriptedCamera(ThreadedCamera):
    """Delivers a frame whenever a test says so."""

    def __init__(self) -> None:
        super().__init__(AdamanipReplayConfig(path=Path("none")), "bench")
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
def camera() -> ScriptedCamera:
    camera = ScriptedCamera()
    camera.connect(warmup=False)
    return camera


def test_a_frame_after_a_moment_was_exposed_after_it(camera: ScriptedCamera) -> None:
    camera.due.release()
    first = camera.frame_after(0.0, 2.0)
    rest = time.perf_counter()
    threading.Timer(0.05, camera.due.release).start()
    second = camera.frame_after(rest, 2.0)
    assert (first.number, second.number) == (1, 2)
    assert first.stamp < rest < second.stamp
    camera.disconnect()


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
    camera.disconnect()


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
    camera.disconnect()


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


@given(
    st.lists(st.tuples(st.floats(0.001, 0.1), st.floats(0.0, 0.05)), min_size=1, max_size=40),
    st.floats(-1e3, 1e3),
)
def test_device_stamps_are_never_early_nor_later_than_the_arrival(
    steps: list[tuple[float, float]], offset: float
) -> None:
    """Delays are 10 ms and more; the clock finds the quickest, so a stamp is late by what the quickest took."""
    clock, true = DeviceClock(), 100.0
    for step, delay in steps:
        true += step
        stamp = clock.stamp(true - offset, true + 0.01 + delay)
        assert true + 0.01 - 1e-9 <= stamp <= true + 0.01 + delay + 1e-9


# A recording, and the camera that plays it ----------------------------------------------------------------------------


def test_a_recording_is_read_as_it_was_written(tmp_path: Path) -> None:
    recording = write_numbered(tmp_path / "r", 4, fps=10)
    assert recording.stamps == pytest.approx([0, 0.1, 0.2, 0.3])
    assert (recording.camera, recording.fps, recording.width, recording.height) == ("numbered", 10, WIDTH, HEIGHT)
    assert recording.duration == pytest.approx(0.4)
    for number in range(4):
        color, depth = recording.pictures(number)
        frame = numbered_frame(number, 0.0)
        assert np.array_equal(color, frame.color)
        assert np.array_equal(depth, frame.depth)


@pytest.mark.parametrize(
    "change",
    [
        {"stamps": [0.0, 0.1, 0.1]},
        {"stamps": []},
        {"fps": 0},
        {"unknown": 1},
        {"intrinsics": {"matrix": [[1, 0, 0], [0, -1, 0], [0, 0, 1]], "distortion": [], "width": 2, "height": 2}},
        {"intrinsics": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "distortion": [0.1], "width": 2, "height": 2}},
    ],
)
def test_a_recording_that_is_none_is_refused(tmp_path: Path, change: dict[str, object]) -> None:
    write_numbered(tmp_path, 3)
    told = json.loads((tmp_path / FILE).read_text())
    (tmp_path / FILE).write_text(json.dumps({**told, **change}))
    with pytest.raises(DatasetError, match="No recording"):
        Recording.open(tmp_path)


def test_a_missing_picture_is_named(tmp_path: Path) -> None:
    recording = write_numbered(tmp_path, 3)
    (tmp_path / "depth_000001.png").unlink()
    with pytest.raises(DatasetError, match=r"depth_000001\.png"):
        recording.pictures(1)
    assert recording.pictures(1, depth=False)[0] is not None


def test_lerobot_makes_the_replay_camera_and_it_keeps_the_rate(tmp_path: Path) -> None:
    write_numbered(tmp_path, 10, fps=50)
    made = make_cameras_from_configs({"front": AdamanipReplayConfig(path=tmp_path)})["front"]
    assert isinstance(made, AdamanipReplay)
    made.connect()
    assert (made.fps, made.width, made.height) == (50, WIDTH, HEIGHT)
    assert made.depth_intrinsics().matrix[0, 0] == 30
    start = made.frame_after(time.perf_counter(), 5.0)
    stamp, frames = start.stamp, [start]
    for _ in range(15):
        frames.append(made.frame_after(stamp, 5.0))
        stamp = frames[-1].stamp
    made.disconnect()
    for frame in frames:
        assert frame.stamp <= frame.arrival
        assert frame.depth is not None
        assert frame.depth[0, 0] == 500 + frame.number % 10  # plays round and round, whatever was dropped
        assert frame.stamp - start.stamp == pytest.approx((frame.number - start.number) / 50, abs=1e-6)
    assert [f.number for f in frames] == sorted({f.number for f in frames})


def test_another_rate_or_what_was_not_recorded_is_refused(tmp_path: Path) -> None:
    write_numbered(tmp_path, 3, fps=30)
    with pytest.raises(ConfigurationError, match="another rate"):
        AdamanipReplay(AdamanipReplayConfig(path=tmp_path, fps=15)).connect()
    told = json.loads((tmp_path / FILE).read_text())
    (tmp_path / FILE).write_text(json.dumps({**told, "depth": False}))
    with pytest.raises(DatasetError, match="no depth"):
        AdamanipReplay(AdamanipReplayConfig(path=tmp_path)).connect()
    camera = AdamanipReplay(AdamanipReplayConfig(path=tmp_path, use_depth=False))
    camera.connect()
    with pytest.raises(RobotError, match="takes no depth"):
        camera.read_depth()
    camera.disconnect()
