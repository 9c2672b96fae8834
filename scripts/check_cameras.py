"""Records two cameras with depth through LeRobot's own loop and counts the ticks that come late.

Two recordings of 256 x 256 pixels, colour and depth, are made and played at 30 Hz; ``record_loop`` of lerobot-record
takes both into a dataset, with 41 numbers of an arm that stands still. A tick is late if it begins more than 5 ms after
it was due. Then one camera freezes, which has to end the recording with its name, before a picture older than
``--max-age`` is taken. Run it on an idle machine: it measures that, too.

Returns 1 if 1 % of the ticks are late, or if their 99th percentile is above 40 ms, or if the frozen camera is not
named. For example: ``python scripts/check_cameras.py --seconds 60 --json``.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from check_common import count, header

from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.cameras.adamanip_replay import AdamanipReplay
from lerobot_adamanip.hardware.cameras.base import MAX_AGE
from lerobot_adamanip.hardware.cameras.config_adamanip_replay import AdamanipReplayConfig
from lerobot_adamanip.hardware.cameras.recording import write_recording
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, SCALAR_NAMES
from lerobot_adamanip.util.errors import RobotError

SIZE, FPS, FRAMES = 256, 30, 90
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


def timing(folder: Path, seconds: float, max_age: float) -> dict[str, Any]:
    """Records, and counts."""
    stand = Stand(cameras(folder, freezes=False), max_age)
    try:
        frames = record(stand, seconds, folder / "timed")
    finally:
        for camera in stand.cameras.values():
            camera.disconnect()
    intervals = 1e3 * np.diff(stand.ticks)
    return {
        "frames": frames,
        "late_share": float((intervals > 1e3 / FPS + LATE_MS).mean()),
        "mean_ms": float(intervals.mean()),
        "p99_ms": float(np.percentile(intervals, 99)),
        "age_p95_ms": float(1e3 * np.percentile(stand.ages, 95)),
    }


def freezing(folder: Path, seconds: float, max_age: float) -> dict[str, Any]:
    """Records until a camera freezes; returns what was said, and how old the oldest picture was."""
    stand, said = Stand(cameras(folder, freezes=True), max_age), ""
    try:
        record(stand, seconds, folder / "frozen")
    except RobotError as error:
        said = str(error).splitlines()[0]
    finally:
        for camera in stand.cameras.values():
            camera.disconnect()
    return {"said": said, "oldest_s": max(stand.ages), "named": "Camera side" in said and "frozen" in said}


def main() -> int:
    """Parses, runs, prints. Returns 0 if the rate was kept and the frozen camera named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=count, default=60)
    parser.add_argument("--max-age", type=float, default=MAX_AGE)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    with tempfile.TemporaryDirectory() as folder:
        timed = timing(Path(folder), options.seconds, options.max_age)
        frozen = freezing(Path(folder), FRAMES / FPS + 60, options.max_age)
    kept = timed["late_share"] < LATE_SHARE and timed["p99_ms"] <= P99_MS
    passed = kept and frozen["named"] and frozen["oldest_s"] <= options.max_age + 0.01
    if options.json:
        sys.stdout.write(json.dumps({**header(), **timed, **frozen, "passed": passed}) + "\n")
    else:
        sys.stdout.write(
            f"{timed['frames']} frames, {100 * timed['late_share']:.2f} % of ticks more than {LATE_MS:.0f} ms late, "
            f"p99 {timed['p99_ms']:.1f} ms, pictures p95 {timed['age_p95_ms']:.0f} ms old\n{frozen['said']}\n"
        )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
