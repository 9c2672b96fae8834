"""`lerobot-record`, killed: every episode whose saving had ended is readable, and resuming continues the count."""

from __future__ import annotations

import contextlib
import os
import pty
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from lerobot.configs.video import DepthEncoderConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.video_utils import StreamingVideoEncoder
from recorded_robot import SAVED

from lerobot_adamanip import lerobot_patches
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import POSE, STATES
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.datasets.opening import read_info
from lerobot_adamanip.datasets.repair import repair
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics
from lerobot_adamanip.hardware.features import ARM, ARM_NAMES, CALIBRATIONS, STAMP_NAME, is_dense, recorded_features
from lerobot_adamanip.hardware.robot_registry import ROBOTS
from lerobot_adamanip.lerobot_patches.ordered_depth import in_order
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError, RobotError

HERE = Path(__file__).parent
ENCODINGS = (False, True)
PATIENCE = 280.0
WAIT = 0.05
FEATURES = recorded_features(
    {
        schema.STATE: {"dtype": "float32", "shape": (len(STATES[POSE]),), "names": list(STATES[POSE])},
        schema.ACTION: {"dtype": "float32", "shape": (schema.ACTION_DIM,), "names": list(schema.POSE_NAMES)},
    }
)
ROW = {key: np.zeros(feature["shape"], feature["dtype"]) for key, feature in FEATURES.items()}


@pytest.fixture(autouse=True)
def patched(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Recordings are durable here, also where the other tests run without patches."""
    monkeypatch.delenv(lerobot_patches.NO_PATCHES, raising=False)
    lerobot_patches.apply()
    yield
    lerobot_patches.restore()


def command(root: Path, *, resume: bool, streaming: bool, episodes: int) -> list[str]:
    options = {
        "robot.type": "recorded_robot", "teleop.type": "recorded_teleop",
        "robot.discover_packages_path": "recorded_robot",
        "dataset.repo_id": "local/killed", "dataset.no_stamp": "true", "dataset.root": str(root),
        "dataset.push_to_hub": "false", "dataset.single_task": "open it", "dataset.num_episodes": str(episodes),
        "dataset.episode_time_s": "0.4", "dataset.reset_time_s": "0", "play_sounds": "false", "dataset.fps": "30",
        "dataset.streaming_encoding": str(streaming).lower(), "dataset.encoder_threads": "1",
        "dataset.rgb_encoder.vcodec": "h264", "resume": str(resume).lower(),
    }  # fmt: skip
    record = "import sys; from lerobot.scripts.lerobot_record import main; sys.exit(main())"
    return [sys.executable, "-c", record, *(f"--{name}={value}" for name, value in options.items())]


class Recording:
    """A running `lerobot-record`, at a pseudo-terminal."""

    def __init__(self, folder: Path, *, resume: bool = False, streaming: bool = False, episodes: int = 500) -> None:
        self.saved = folder / "saved"
        self._begun = len(self.lines())
        self._terminal, slave = pty.openpty()
        path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
        with (folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                command(folder / "recording", resume=resume, streaming=streaming, episodes=episodes),
                stdin=slave,
                stdout=log,
                stderr=log,
                env={**os.environ, "PYTHONPATH": path, SAVED: str(self.saved)},
                start_new_session=True,
            )
        os.close(slave)

    def lines(self) -> list[tuple[int, int]]:
        """Episodes whose saving has ended, and their rows."""
        if not self.saved.exists():
            return []
        whole = self.saved.read_text().rpartition("\n")[0]
        return [(int(line.split()[0]), int(line.split()[1])) for line in whole.splitlines()]

    def wait_for(self, more: int) -> None:
        """Until so many episodes are saved by this process."""
        end = time.monotonic() + PATIENCE
        while len(self.lines()) < self._begun + more:
            assert self.process.poll() is None, self.told()
            assert time.monotonic() < end, self.told()
            time.sleep(WAIT)

    def told(self) -> str:
        return (self.saved.parent / "log").read_text(errors="replace")[-3000:]

    def kill(self) -> None:
        os.killpg(self.process.pid, signal.SIGKILL)  # its encoders too, which are its own
        self.process.wait()

    def end(self) -> None:
        assert self.process.wait(PATIENCE) == 0, self.told()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        """Leaves no process behind, however a test ends."""
        with contextlib.suppress(ProcessLookupError):
            self.kill()
        os.close(self._terminal)


def opened(root: Path) -> LeRobotDataset:
    return LeRobotDataset("local/killed", root=root, video_backend="pyav")


def require_readable(root: Path, saved: list[tuple[int, int]]) -> int:
    """Every saved episode is there with its rows and frames; returns how many episodes there are."""
    dataset = opened(root)
    lengths = [dataset.meta.episodes[number]["length"] for number in range(dataset.num_episodes)]
    for number, rows in saved:
        assert lengths[number] == rows
        first = dataset.meta.episodes[number]["dataset_from_index"]
        for row in (first, first + rows - 1):
            item = dataset[row]
            assert int(item["episode_index"]) == number
            assert int(item["frame_index"]) == row - first
            shade = float(item["observation.images.front"].mean()) * 255.0
            tick = float(item[ARM][ARM_NAMES.index(STAMP_NAME)]) * 30.0
            assert bool(item[schema.DONE]) == (row == first + rows - 1)
            assert abs(shade - tick % 200) < 4.0
            assert abs(float(item["observation.images.front_depth"].mean()) - (600 + tick % 200)) < 3.0
    assert len(dataset) == sum(lengths)
    return int(dataset.num_episodes)


def killed_again_and_again(folder: Path, kills: int, *, streaming: bool, seed: int) -> int:
    """Kills a recording at random moments, resuming it each time; returns its episodes in the end."""
    draw = random.Random(seed)
    root = folder / "recording"
    for number in range(kills):
        with Recording(folder, resume=number > 0, streaming=streaming) as recording:
            recording.wait_for(draw.randint(1, 3))
            time.sleep(draw.uniform(0.0, 1.5))
            recording.kill()
        saved = recording.lines()
        assert [number for number, _ in saved] == list(range(len(saved)))
        done = repair(root)
        assert done.left == [], done.left
        episodes = require_readable(root, saved)
        # An episode may be counted when its process is killed before it says so.
        assert len(saved) <= episodes <= len(saved) + 1
        if episodes > len(saved):
            with recording.saved.open("a") as file:
                file.write(f"{episodes - 1} {opened(root).meta.episodes[episodes - 1]['length']}\n")
    with Recording(folder, resume=True, streaming=streaming, episodes=1) as last:
        before = len(last.lines())
        last.end()
    assert [number for number, _ in last.lines()] == list(range(before + 1))
    return require_readable(root, last.lines())


def test_a_killed_recording_is_readable_and_goes_on(tmp_path: Path) -> None:
    episodes = killed_again_and_again(tmp_path, 1, streaming=True, seed=5)
    assert episodes >= 2
    info = read_info(tmp_path / "recording")
    assert is_dense(info["features"])
    assert info["data_files_size_in_mb"] == 100  # as LeRobot would have it


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("streaming", ENCODINGS)
def test_ten_kills(tmp_path: Path, streaming: bool) -> None:
    episodes = killed_again_and_again(tmp_path, 10, streaming=streaming, seed=11 + streaming)
    assert episodes >= 11


def test_of_other_robots_lerobot_keeps_the_writing(tmp_path: Path) -> None:
    features = {"observation.state": {"dtype": "float32", "shape": (2,), "names": ["a", "b"]}}
    dataset = LeRobotDataset.create("local/other", 30, features, root=tmp_path / "other")
    for _ in range(2):
        for _ in range(3):
            dataset.add_frame({"observation.state": np.zeros(2, np.float32), "task": "nothing"})
        dataset.save_episode()
    dataset.finalize()
    assert len(list((tmp_path / "other").glob("data/*/*.parquet"))) == 1


def test_depth_of_an_episode_that_ends_at_once_can_be_written(tmp_path: Path) -> None:
    """With LeRobot's own settings one video in four of one or two frames cannot be."""
    encoder = StreamingVideoEncoder(30, depth_encoder=in_order(DepthEncoderConfig()), encoder_threads=1)
    for number in range(30):
        encoder.start_episode(["depth"], tmp_path, ["depth"])
        for _ in range(1 + number % 2):
            encoder.feed_frame("depth", np.full((32, 32, 1), 600 + number, np.uint16))
        encoder.finish_episode()


def test_settings_of_ones_own_are_kept() -> None:
    assert in_order(DepthEncoderConfig()).extra_options == {"x265-params": "lossless=1:bframes=0"}
    for own in ({"x265-params": "lossless=1:bframes=2"}, {"x265-params": "bframes=0"}):
        assert in_order(DepthEncoderConfig(extra_options=own)).extra_options == own
    assert in_order(DepthEncoderConfig(extra_options={})).extra_options == {"x265-params": "bframes=0"}


def test_tasks_are_written_in_one_step_and_nobody_repairs_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "dense"
    dataset = LeRobotDataset.create("local/dense", 30, FEATURES, root=root)
    written: list[Path] = []
    write = files.write_atomically
    monkeypatch.setattr(files, "write_atomically", lambda path, content: (written.append(path), write(path, content)))
    for task in ("open it", "close it"):
        dataset.add_frame({**ROW, "task": task})
        dataset.save_episode()
    assert written.count(root / "meta" / "tasks.parquet") == 2
    with pytest.raises(DatasetError, match="Another command is at work"):
        repair(root)
    dataset.finalize()
    assert sorted(LeRobotDataset("local/dense", root=root).meta.tasks.index) == ["close it", "open it"]
    assert repair(root).mended == []


def test_an_episode_that_is_saved_or_discarded_is_counted_once(tmp_path: Path) -> None:
    """`lerobot-rollout` says no more of its episodes, and the robot's memory starts anew with each."""
    session = ROBOTS.open("arm")
    try:
        dataset = LeRobotDataset.create("local/dense", 30, FEATURES, root=tmp_path / "dense")
        for count, end in enumerate((dataset.save_episode, dataset.clear_episode_buffer), 1):
            dataset.add_frame({**ROW, "task": "open it"})
            assert session.episodes == count - 1
            end()
            assert session.episodes == count
        dataset.finalize()
    finally:
        ROBOTS.close("arm")


@pytest.mark.parametrize("robots", [0, 1, 2])
def test_a_frame_of_an_unknown_observation_is_refused(tmp_path: Path, robots: int) -> None:
    frame = {key: ROW[key] for key in (schema.STATE, schema.ACTION)}
    try:
        for number in range(robots):
            ROBOTS.open(f"arm {number}")
        dataset = LeRobotDataset.create("local/dense", 30, FEATURES, root=tmp_path / "dense")
        got = "no such state" if robots == 1 else "no single connected robot"
        with pytest.raises(RobotError, match=rf"(?s)cannot be recorded.*{got}.*ring_buffer_seconds"):
            dataset.add_frame({**frame, "task": "open it"})
        dataset.finalize()
    finally:
        for number in range(robots):
            ROBOTS.close(f"arm {number}")


def test_a_recording_is_resumed_with_a_moved_front_camera_and_not_with_another(tmp_path: Path) -> None:
    session, root = ROBOTS.open("arm"), tmp_path / "dense"

    def record(dataset: LeRobotDataset, moved_m: float, focal: float = 300.0) -> None:
        matrix = np.array([[focal, 0, 128], [0, focal, 128], [0, 0, 1]])
        imager, pose = Intrinsics(matrix, np.zeros(0), 256, 256), transform((0.0, moved_m, 0.0))
        session.calibrations["front"] = CameraCalibration("front", imager, pose)
        try:
            dataset.add_frame({**ROW, "task": "open it"})
            dataset.save_episode()
        finally:
            dataset.finalize()

    try:
        record(LeRobotDataset.create("local/dense", 30, FEATURES, root=root), 0.0)
        recorded = (root / CALIBRATIONS).read_bytes()
        with pytest.raises(ConfigurationError, match=r"(?s)camera front, moved by 21 mm.*a new --dataset\.root"):
            record(LeRobotDataset.resume("local/dense", root=root), 0.01, focal=290.0)
        record(LeRobotDataset.resume("local/dense", root=root), 0.01)
    finally:
        ROBOTS.close("arm")
    assert LeRobotDataset("local/dense", root=root).num_episodes == 2
    assert (root / CALIBRATIONS).read_bytes() == recorded
