"""Two cameras through LeRobot's recording loop: it keeps 30 Hz, and a frozen camera ends it with its name.

Two recordings of 256 x 256 pixels, colour and depth, are played at 30 Hz; ``record_loop`` of lerobot-record takes both
into a dataset, with the numbers of an arm that stands still.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.adamanip_replay import AdamanipReplay
from lerobot_adamanip.hardware.cameras.config_adamanip_replay import AdamanipReplayConfig
from lerobot_adamanip.hardware.cameras.recording import write_recording
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, SCALAR_NAMES
from lerobot_adamanip.util.errors import RobotError

SIZE, FPS, FRAMES = 256, 30, 90
MAX_AGE = 0.5
LATE_MS, LATE_SHARE, P99_MS = 5.0, 0.01, 40.0


def scene(seed: int) -> Iterator[Frame]:
    """A textured surface that moves: as hard to encode as a real picture, not as noise."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:SIZE, :SIZE]
    texture = rng.integers(0, 40, (SIZE // 8, SIZE // 8)).repeat(8, 0).repeat(8, 1)
    for number in range(FRAMES):
        waves = 100 + 60 * np.sin((columns + 3 * number) / 20) * np.cos(rows / 25) + texture
        color = np.stack([waves, 255 - waves, np.roll(waves, 40, 0)], axis=2).astype(np.uint8)
        depth = (900 + 80 * np.sin((columns + 2 * number) / 40) + rng.integers(-1, 2, (SIZE, SIZE))).astype(np.uint16)
        yield Frame(number / FPS, number / FPS, color, depth, number)


@dataclass
class Stand:
    """An arm that stands still, with cameras: what `record_loop` asks of a robot.

    Attributes:
        cameras: connected.
        max_age: of a picture that is taken [s].
        ticks: when each observation began [s].
        ages: of the pictures that were given [s].
    """

    cameras: dict[str, AdamanipReplay]
    max_age: float
    ticks: list[float] = field(default_factory=list)
    ages: list[float] = field(default_factory=list)
    name = "stand"

    def observation_features(self) -> dict[str, Any]:
        """As robots declare them."""
        pictures = dict.fromkeys(self.cameras, (SIZE, SIZE, 3))
        depths = {f"{key}{DEPTH_SUFFIX}": (SIZE, SIZE, 1) for key in self.cameras}
        return {**dict.fromkeys(SCALAR_NAMES, float), **pictures, **depths}

    def get_observation(self) -> dict[str, Any]:
        """Numbers, and the latest frame of each camera."""
        self.ticks.append(time.perf_counter())
        told: dict[str, Any] = dict.fromkeys(SCALAR_NAMES, 0.0)
        for key, camera in self.cameras.items():
            frame = camera.latest_frame(self.max_age)
            self.ages.append(time.perf_counter() - frame.stamp)
            assert frame.depth is not None
            told[key], told[f"{key}{DEPTH_SUFFIX}"] = frame.color, frame.depth[..., None]
        return told

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        """Nothing moves."""
        return action


def teleoperator() -> Any:
    """A device that always says the same."""
    from lerobot.teleoperators.teleoperator import Teleoperator

    class Same(Teleoperator):  # type: ignore[misc]
        action_features = dict.fromkeys(POSE_NAMES, float)
        feedback_features = dict.fromkeys((), float)
        is_connected = is_calibrated = False

        def __init__(self) -> None:
            pass

        def get_action(self) -> dict[str, float]:
            return dict.fromkeys(POSE_NAMES, 0.5)

        def connect(self, calibrate: bool = True) -> None: ...
        def calibrate(self) -> None: ...
        def configure(self) -> None: ...
        def send_feedback(self, feedback: dict[str, Any]) -> None: ...
        def disconnect(self) -> None: ...

    return Same()


def record(stand: Stand, seconds: float, root: Path) -> int:
    """Records so long; returns the frames in the episode."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.processor import make_default_processors
    from lerobot.scripts.lerobot_record import record_loop
    from lerobot.utils.feature_utils import hw_to_dataset_features

    features = {
        **hw_to_dataset_features(dict.fromkeys(POSE_NAMES, float), "action"),
        **hw_to_dataset_features(stand.observation_features(), "observation"),
    }
    threads = 4 * len(stand.cameras)
    dataset = LeRobotDataset.create("local/check_cameras", FPS, features, root=root, image_writer_threads=threads)
    try:
        record_loop(
            stand,
            {"exit_early": False},
            FPS,
            *make_default_processors(),
            dataset,
            teleoperator(),
            seconds,
            "stand still",
        )
    finally:
        frames = len(dataset.writer.episode_buffer["timestamp"]) if dataset.writer is not None else 0
        dataset.clear_episode_buffer()
        dataset.finalize()
    return frames


def cameras(folder: Path, *, freezes: bool) -> dict[str, AdamanipReplay]:
    """Two of them, connected; the second may end with its recording."""
    made = {}
    for seed, key in enumerate(("front", "side")):
        if not (folder / key).exists():
            write_recording(folder / key, scene(seed), camera=key, fps=FPS)
        made[key] = AdamanipReplay(AdamanipReplayConfig(path=folder / key, loop=not (freezes and key == "side")))
        made[key].connect()
    return made


def recorded(folder: Path, seconds: float, *, freezes: bool) -> tuple[Stand, int, str]:
    """Records, with a second camera that may freeze; returns the arm, the frames and the first line of an error."""
    stand, frames, said = Stand(cameras(folder, freezes=freezes), MAX_AGE), 0, ""
    try:
        frames = record(stand, seconds, folder / "recorded")
    except RobotError as error:
        said = str(error).splitlines()[0]
    finally:
        for camera in stand.cameras.values():
            camera.disconnect()
    return stand, frames, said


def test_a_frozen_camera_ends_the_recording_with_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "FRAMES", 20)
    stand, _, said = recorded(tmp_path, 60, freezes=True)
    assert "Camera side" in said
    assert "frozen" in said
    assert max(stand.ages) <= MAX_AGE + 0.01  # no stale picture is taken


@pytest.mark.nightly
@pytest.mark.timeout(400)
def test_two_cameras_keep_thirty_hertz_for_a_minute(tmp_path: Path) -> None:
    stand, frames, _ = recorded(tmp_path, 60, freezes=False)
    intervals = 1e3 * np.diff(stand.ticks)
    assert frames >= 0.97 * 60 * FPS
    assert (intervals > 1e3 / FPS + LATE_MS).mean() < LATE_SHARE
    assert np.percentile(intervals, 99) <= P99_MS
