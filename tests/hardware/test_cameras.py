"""Frames of cameras, and two cameras in LeRobot's recording loop."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.base import MAX_AGE, LatestFrame, ThreadedCamera
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, SCALAR_NAMES
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


SIZE, FPS, FRAMES = 256, 30, 20
LATE_MS, LATE_SHARE, P99_MS = 5.0, 0.01, 40.0


class Played(ThreadedCamera):
    """Plays a textured surface that moves, as hard to encode as a real picture, round and round or once."""

    def __init__(self, seed: int, key: str, *, freezes: bool) -> None:
        super().__init__(SimpleNamespace(fps=FPS, width=SIZE, height=SIZE, use_rgb=True, use_depth=True), key)
        self.freezes, self.number = freezes, 0
        rng = np.random.default_rng(seed)
        rows, columns = np.mgrid[:SIZE, :SIZE]
        texture = rng.integers(0, 40, (SIZE // 8, SIZE // 8)).repeat(8, 0).repeat(8, 1)
        waves = [100 + 60 * np.sin((columns + 3 * n) / 20) * np.cos(rows / 25) + texture for n in range(FRAMES)]
        self.colors = [np.stack([each, 255 - each, np.roll(each, 40, 0)], axis=2).astype(np.uint8) for each in waves]
        self.depths = [(900 + each + rng.integers(-1, 2, (SIZE, SIZE))).astype(np.uint16) for each in waves]

    def _open(self) -> None:
        self.due = time.perf_counter()

    def _take(self, stop: threading.Event) -> Frame | None:
        stop.wait(max(0.0, self.due - time.perf_counter()))
        if self.freezes and self.number == FRAMES:
            stop.wait(0.1)
            return None
        stamp, self.due, self.number = self.due, self.due + 1 / FPS, self.number + 1
        place = self.number % FRAMES
        return Frame(stamp, time.perf_counter(), self.colors[place], self.depths[place], self.number)

    def _close(self) -> None: ...


class Stand:
    """An arm that stands still, with two cameras: what `record_loop` asks of a robot, and of a teleoperator."""

    name = "stand"
    action_features = dict.fromkeys(POSE_NAMES, float)

    def __init__(self, *, freezes: bool) -> None:
        self.cameras = {
            key: Played(seed, key, freezes=freezes and key == "side") for seed, key in enumerate(("front", "side"))
        }
        self.ticks: list[float] = []
        self.ages: list[float] = []

    def observation_features(self) -> dict[str, Any]:
        pictures = dict.fromkeys(self.cameras, (SIZE, SIZE, 3))
        depths = {f"{key}{DEPTH_SUFFIX}": (SIZE, SIZE, 1) for key in self.cameras}
        return {**dict.fromkeys(SCALAR_NAMES, float), **pictures, **depths}

    def get_observation(self) -> dict[str, Any]:
        self.ticks.append(time.perf_counter())
        told: dict[str, Any] = dict.fromkeys(SCALAR_NAMES, 0.0)
        for key, camera in self.cameras.items():
            frame = camera.latest_frame()
            self.ages.append(time.perf_counter() - frame.stamp)
            assert frame.depth is not None
            told[key], told[f"{key}{DEPTH_SUFFIX}"] = frame.color, frame.depth[..., None]
        return told

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        return action


def same_action() -> Any:
    """A teleoperator that always says the same."""
    from lerobot.teleoperators.teleoperator import Teleoperator

    def get_action(self: Any) -> dict[str, float]:
        return dict.fromkeys(POSE_NAMES, 0.5)

    own = {"__init__": lambda self: None, "get_action": get_action, "is_connected": False}
    return type("Same", (Teleoperator,), {**dict.fromkeys(Teleoperator.__abstractmethods__), **own})()


def recorded(root: Path, seconds: float, *, freezes: bool) -> tuple[Stand, int, str]:
    """Records, with a second camera that may freeze; returns the arm, the frames and the first line of an error."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.processor import make_default_processors
    from lerobot.scripts.lerobot_record import record_loop
    from lerobot.utils.feature_utils import hw_to_dataset_features

    stand, said = Stand(freezes=freezes), ""
    features = {
        **hw_to_dataset_features(stand.action_features, "action"),
        **hw_to_dataset_features(stand.observation_features(), "observation"),
    }
    dataset = LeRobotDataset.create("local/check_cameras", FPS, features, root=root, image_writer_threads=8)
    processors, events = make_default_processors(), {"exit_early": False}
    for camera in stand.cameras.values():
        camera.connect()
    try:
        record_loop(stand, events, FPS, *processors, dataset, same_action(), seconds, "stand still")
    except RobotError as error:
        said = str(error).splitlines()[0]
    finally:
        for camera in stand.cameras.values():
            camera.disconnect()
    frames = len(dataset.writer.episode_buffer["timestamp"]) if dataset.writer is not None else 0
    dataset.clear_episode_buffer()
    dataset.finalize()
    return stand, frames, said


def test_a_frozen_camera_ends_the_recording_with_its_name(tmp_path: Path) -> None:
    stand, _, said = recorded(tmp_path / "recorded", 60, freezes=True)
    assert "Camera side" in said
    assert "frozen" in said
    assert max(stand.ages) <= MAX_AGE + 0.1  # no stale picture is taken


@pytest.mark.nightly
@pytest.mark.timeout(400)
def test_two_cameras_keep_thirty_hertz_for_a_minute(tmp_path: Path) -> None:
    stand, frames, _ = recorded(tmp_path / "recorded", 60, freezes=False)
    intervals = 1e3 * np.diff(stand.ticks)
    assert frames >= 0.97 * 60 * FPS
    assert (intervals > 1e3 / FPS + LATE_MS).mean() < LATE_SHARE
    assert np.percentile(intervals, 99) <= P99_MS
