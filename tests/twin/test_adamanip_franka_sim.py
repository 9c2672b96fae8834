"""The twin as LeRobot's robot, without a simulator: its options, seeds of episodes, what it logs, when it is over."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.cameras import CAMERAS, PIXEL_CONVENTION
from lerobot_adamanip.contract.control import POSE, STATES
from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import pose_from_vector, transform
from lerobot_adamanip.contract.schema import POSE_NAMES, SUCCESS
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, ArmStatus, Execution, ServerOptions
from lerobot_adamanip.hardware.calibration.on_hand import CameraOnHand
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.features import ARM, ARM_NAMES, STAMP_NAME
from lerobot_adamanip.hardware.robot_registry import OPERATOR_SUCCESS, RESET_WANTED, ROBOTS
from lerobot_adamanip.lerobot_patches.episode_signals import EpisodicRobot
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.objects.base import Motion
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_env_adamanip.twin import twin_camera
from lerobot_env_adamanip.twin.config_devices import AdamanipFrankaSimConfig, AdamanipTwinConfig
from lerobot_env_adamanip.twin.franka_sim import AdamanipFrankaSim
from lerobot_env_adamanip.twin.process import SUCCESS_BOX

PARTS = {
    "handle": PartAnnotation(
        "handle", transform((0.6, 0.1, 0.7)), (Motion("door", "revolute", np.zeros(3), np.array([0.0, 0.0, 1.0])),)
    )
}


class FakeProcess:
    """The client of a twin that is always where it was sent, one step of time on."""

    server = ServerOptions(lockstep_fps=30.0)

    def __init__(self) -> None:
        seven = np.zeros(7)
        pose = transform((0.5, 0.0, 0.7))
        self.reading = ArmReading(0.0, 0.0, pose, 1.0, seven, seven, seven, ArmMode.IDLE, outcome=Outcome.REACHED)
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.is_connected, self.success, self.looks, self.with_depth = False, False, 0, False

    def connect(self) -> dict[str, Any]:
        self.is_connected = True
        return self.told(1000)

    def close(self) -> None:
        self.is_connected = False

    def told(self, seed: int) -> dict[str, Any]:
        camera = {"intrinsics": np.eye(3).tolist(), "extrinsics": np.eye(4).tolist(), "width": 16, "height": 16}
        camera["convention"] = PIXEL_CONVENTION
        return {"seed": seed, "category": "microwave", "annotations": PARTS, "camera": camera}

    def status(self) -> ArmStatus:
        return ArmStatus(0.0, self.reading, accepted=1)

    healthy = status

    def send(self, pose: Any, execution: Execution) -> int:
        self.asked.append(("send", {}))
        goal = pose_from_vector(pose)[0]
        self.reading = replace(self.reading, tcp_in_base=goal, robot_time=self.reading.robot_time + 1 / 30)
        return 1

    def wait(self, number: int, time_limit: float) -> ArmStatus:
        return self.status()

    def request(self, ask: str, values: dict[str, Any] | None = None, *, time_limit: float = 10.0) -> dict[str, Any]:
        self.asked.append((ask, dict(values or {})))
        if ask == "look":
            assert values is not None
            self.looks, self.with_depth = self.looks + 1, values["depth"]
        if ask == "reset":
            self.success = False
        return self.told((values or {}).get("seed", 0)) if ask == "reset" else {"success": self.success}

    def frame(self, name: str) -> tuple[int, Any]:
        if name == SUCCESS_BOX:
            return 1, self.success
        color = np.full((16, 16, 3), self.looks, np.uint8)
        depth = color[..., 0].astype(np.uint16) if self.with_depth else None
        now = time.perf_counter()
        return self.looks, Frame(now, now, color, depth, self.looks)

    @property
    def resets(self) -> list[int]:
        return [values["seed"] for ask, values in self.asked if ask == "reset"]


@pytest.fixture
def process() -> FakeProcess:
    return FakeProcess()


@pytest.fixture
def make(process: FakeProcess, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    made: list[AdamanipFrankaSim] = []

    def robot(**options: Any) -> AdamanipFrankaSim:
        options = {"clock": "lockstep", **options}
        config = AdamanipFrankaSimConfig(id="twin", seed=1000, image_size=16, **options)
        monkeypatch.setattr(AdamanipFrankaSim, "_make_client", lambda _: process)
        made.append(AdamanipFrankaSim(config))
        made[-1].connect()
        return made[-1]

    yield robot
    for each in made:
        each.disconnect()


def action(robot: AdamanipFrankaSim, dx: float = 0.0) -> dict[str, float]:
    seen = robot.get_observation()
    return {name: seen[name] + (dx if name == "ee.x.pos" else 0.0) for name in POSE_NAMES}


def recorded(robot: AdamanipFrankaSim) -> dict[str, float]:
    """What the recorder stores of the present observation, and success after the latest action."""
    seen = robot.get_observation()
    row = robot.session.rows.find(np.array([seen[name] for name in STATES[robot.interface.state]], np.float32))
    return {**dict(zip(ARM_NAMES, row[ARM].tolist(), strict=True)), SUCCESS: bool(row[SUCCESS][0])}


def test_it_brings_its_cameras_and_tells_features_before_it_is_connected() -> None:
    robot = AdamanipFrankaSim(AdamanipFrankaSimConfig(image_size=48))
    pictures = {name: shape for name, shape in robot.observation_features.items() if shape is not float}
    assert pictures == dict.fromkeys(CAMERAS, (48, 48, 3))
    robot = AdamanipFrankaSim(AdamanipFrankaSimConfig(image_size=48, depth=True))
    assert robot.observation_features["front_depth"] == (48, 48, 1)
    robot = AdamanipFrankaSim(AdamanipFrankaSimConfig(execution="keyframe"))
    pictures = {name: shape for name, shape in robot.observation_features.items() if shape is not float}
    assert pictures == {"front": (256, 256, 3), "front_depth": (256, 256, 1)}
    with pytest.raises(AdaManipError, match="camera of the twin"):
        AdamanipFrankaSimConfig(cameras={"side": AdamanipTwinConfig()})
    assert "front" not in AdamanipFrankaSim(AdamanipFrankaSimConfig(camera=False)).observation_features
    assert isinstance(robot, EpisodicRobot)


@pytest.mark.parametrize("wrong", [{"clock": "fast"}, {"category": "fridge"}, {"seed": -1}, {"objects": "none"}])
def test_options_that_cannot_be_meant_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(AdaManipError, match="allowed:"):
        AdamanipFrankaSimConfig(**wrong)


def test_an_episode_has_the_seed_of_its_number_whatever_came_between(make: Any, process: FakeProcess) -> None:
    robot = make()
    robot.begin_episode(0)
    assert process.resets == []  # the scene stands there untouched
    robot.send_action(action(robot))
    robot.begin_episode(0)
    assert process.resets == [1000]  # recorded again
    robot.begin_episode(7)  # a session that goes on
    assert process.resets == [1000, 1007]
    session = ROBOTS.find("twin")
    assert session is not None
    assert session.details["seed"] == 1007
    assert session.calibrations["front"].depth.width == 16


def test_lockstep_tells_time_by_steps_and_looks_once_a_step(make: Any, process: FakeProcess) -> None:
    robot = make(cameras={"front": AdamanipTwinConfig(use_depth=True)}, depth=True)
    before = process.looks
    stamps = []
    for number in range(4):
        seen = robot.get_observation()
        robot.get_observation()  # nothing has moved
        assert seen["front"][0, 0, 0] == seen["front_depth"][0, 0, 0] == process.looks
        stamps.append(recorded(robot)[STAMP_NAME])
        robot.send_action(action(robot, 0.001 * number))
    np.testing.assert_allclose(np.diff(stamps), 1 / 30, atol=1e-9)
    assert process.looks - before <= 4


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_the_first_picture_of_a_scene_is_not_of_the_scene_before(make: Any, process: FakeProcess, clock: str) -> None:
    robot = make(clock=clock)
    robot.get_observation()
    robot.put_up(1001)
    before = process.looks
    assert robot.get_observation()["front"][0, 0, 0] > before


def test_after_a_pause_the_next_observation_has_a_new_picture(
    make: Any, process: FakeProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While an episode is saved or a policy compiles, the camera takes no pictures."""
    monkeypatch.setattr(twin_camera, "WANTED_FOR", 0.05)
    robot = make(clock="realtime", camera_age=0.1)
    robot.get_observation()
    time.sleep(0.3)
    before = process.looks
    time.sleep(0.2)
    assert process.looks == before
    assert robot.get_observation()["front"][0, 0, 0] > before


def test_depth_corrects_the_calibration_until_the_scene_changes(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    moved, depths = transform((0.0, 0.01, 0.0)), list[Any]()

    def update(camera: CameraOnHand, depth: Any, reading: ArmReading) -> bool:
        depths.append(depth.shape)
        camera.estimate.correction = moved @ camera.estimate.correction
        return True

    monkeypatch.setattr(CameraOnHand, "update", update)
    for wanted in (False, True):
        robot = make(cameras={"front": AdamanipTwinConfig(use_depth=True)}, depth=True, self_calibration=wanted)
        positions = []
        for _ in range(2):
            robot.get_observation()
            positions.append(robot.session.calibrations["front"].depth_in_base[1, 3])
        assert positions == pytest.approx([0.01, 0.02] if wanted else [0.0, 0.0])
        robot.put_up(7)
        assert robot.session.calibrations["front"].depth_in_base[1, 3] == 0.0
        robot.disconnect()
    assert depths == [(16, 16)] * 2


def test_success_after_an_action_is_a_label_of_the_twin_or_the_operator(make: Any, process: FakeProcess) -> None:
    robot = make()

    def success() -> bool:
        """Whether the row of an observation and the action after it is one of success."""
        seen = robot.get_observation()
        robot.send_action({name: seen[name] for name in POSE_NAMES})
        state = np.array([seen[name] for name in STATES[POSE]], np.float32)
        return bool(robot.session.rows.find(state)[SUCCESS][0])

    assert not success()
    process.success = True
    assert success()
    process.success = False
    robot.session.details[OPERATOR_SUCCESS] = True
    assert success()
    robot.put_up(1001)
    assert not success()


def test_the_operators_key_puts_the_scene_up_anew(make: Any, process: FakeProcess) -> None:
    robot = make()
    robot.send_action(action(robot))
    robot.session.details[RESET_WANTED] = True
    robot.get_observation()
    assert process.resets == [1000]
    assert robot.session.episodes == 1
    robot.get_observation()
    assert process.resets == [1000]


def test_an_episode_is_logged_beside_its_dataset_and_not_in_it(make: Any, process: FakeProcess, tmp_path: Path) -> None:
    robot = make()
    robot.send_action(action(robot))
    process.success = True
    robot.end_episode(3, tmp_path / "recorded")
    (line,) = (tmp_path / "recorded.episodes.jsonl").read_text().splitlines()
    assert json.loads(line) == {"episode": 3, "success": True, "key_frames": 1}


def test_key_frames_end_with_the_episode_and_so_does_the_command(
    make: Any, process: FakeProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raised: list[int] = []
    monkeypatch.setattr(signal, "raise_signal", raised.append)
    log = tmp_path / "rolled.jsonl"
    robot = make(execution="keyframe", max_key_frames=3, end_when_done=True, episode_log=str(log))
    assert robot.config.environment().max_key_frames == 3, "the log ends there too"
    for number in range(5):
        robot.send_action(action(robot, 0.01 * (number + 1)))
    assert sum(ask == "send" for ask, _ in process.asked) == 3
    assert raised == [signal.SIGINT]
    robot.disconnect()
    robot.disconnect()
    assert [json.loads(line)["episode"] for line in log.read_text().splitlines()] == [None]


@pytest.mark.parametrize("ends", [False, True])
def test_a_stream_ends_the_command_at_success(
    make: Any, process: FakeProcess, monkeypatch: pytest.MonkeyPatch, ends: bool
) -> None:
    raised: list[int] = []
    monkeypatch.setattr(signal, "raise_signal", raised.append)
    robot = make(end_when_done=ends)
    for number in range(6):
        process.success = number >= 3
        robot.send_action(action(robot))
        assert raised == [signal.SIGINT] * (ends and number >= 3)  # once: a second Ctrl-C would abort the shutdown
