"""Two cameras through LeRobot's recording loop: it keeps 30 Hz, and a frozen camera ends it with its name.

Pictures of 256 x 256 pixels, colour and depth, come at 30 Hz; ``record_loop`` of lerobot-record takes them into a
dataset, with the numbers of an arm that stands still.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.base import MAX_AGE, ThreadedCamera
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, SCALAR_NAMES
from lerobot_adamanip.util.errors import RobotError

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
