"""Policies, datasets and the arm's execution mode: a wrong pair is refused before the arm's process is started."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, EE_POSE, FULL, POSE, STATES
from lerobot_adamanip.hardware.adamanip_franka.adamanip_franka import AdamanipFranka
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
from lerobot_adamanip.hardware.adamanip_franka.execution_check import execution_of_data, execution_of_policy
from lerobot_adamanip.hardware.adamanip_franka.interface import adopt_training_rate
from lerobot_adamanip.hardware.arm import Execution
from lerobot_adamanip.hardware.features import INTERVENTION, recorded_features
from lerobot_adamanip.hardware.robot_registry import ROBOTS
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.twin.config_devices import AdamanipFrankaSimConfig
from lerobot_env_adamanip.twin.franka_sim import AdamanipFrankaSim

KEY_FRAMES = schema.dataset_features()
TICKS: dict[str, Any] = {
    schema.STATE: {"names": list(STATES[POSE])},
    schema.ACTION: {"names": list(schema.POSE_NAMES)},
    "observation.images.front_depth": {},
}
"""A recording."""
ROLLOUT = {**TICKS, schema.STATE: {"names": list(schema.STATE_NAMES)}, INTERVENTION: {}}
SIMULATED = schema.dense_features(ACTION_NAMES[EE_POSE], STATES[FULL], num_points=16)
RECORDED = recorded_features(schema.dense_features(ACTION_NAMES[EE_DELTA], STATES[POSE]))
PAIRS = [("stream", KEY_FRAMES, "keyframe"), *(("keyframe", data, "stream") for data in (TICKS, SIMULATED, RECORDED))]


class ReachedError(Exception):
    """The robot would start its process now."""


@pytest.fixture(params=[(AdamanipFranka, AdamanipFrankaConfig), (AdamanipFrankaSim, AdamanipFrankaSimConfig)])
def make(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], Any]:
    """Builds the real robot or the twin. Connecting gets as far as the arm's process."""
    robot_class, config_class = request.param

    def start(_: Any) -> Any:
        raise ReachedError

    monkeypatch.setattr(robot_class, "_make_client", start)
    box = {"box_lower": (0.2, -0.5, 0.0), "box_upper": (0.9, 0.5, 0.8)}
    return lambda execution: robot_class(config_class(calibration_dir=tmp_path, execution=execution, **box))


def checkpoint(folder: Path, features: dict[str, Any]) -> SimpleNamespace:
    """The configuration of a stock policy that was saved after training on a dataset with these columns."""
    folder.mkdir(exist_ok=True)
    save_file({f"{key}.mean": np.zeros(1) for key in features}, folder / "stats.safetensors")
    steps = '[{"registry_name": "rename"}, {"registry_name": "normalizer", "state_file": "stats.safetensors"}]'
    (folder / "policy_preprocessor.json").write_text(f'{{"steps": {steps}}}')
    return SimpleNamespace(pretrained_path=folder, input_features={schema.STATE: None})


def rollout(cfg: Any, robot: Any) -> None:
    robot.connect()  # as `build_rollout_context`, whose configuration is called `cfg`


def replay(cfg: Any, robot: Any, dataset: Any) -> None:
    robot.connect()


@pytest.mark.parametrize(("execution", "data", "needed"), PAIRS)
def test_a_rollout_of_the_other_kind_is_refused_before_anything_starts(
    make: Callable[[str], Any], tmp_path: Path, execution: str, data: dict[str, Any], needed: str
) -> None:
    policy = checkpoint(tmp_path / "policy", data)
    robot = make(execution)
    with pytest.raises(ConfigurationError, match=rf"(?s)do not fit.*try: +--robot\.execution={needed}"):
        rollout(SimpleNamespace(robot=robot.config, policy=policy), robot)
    assert not robot.is_connected
    robot = make(needed)
    with pytest.raises(ReachedError):
        rollout(SimpleNamespace(robot=robot.config, policy=policy), robot)


@pytest.mark.parametrize(("execution", "data", "needed"), PAIRS)
def test_a_replay_of_the_other_kind_is_refused(
    make: Callable[[str], Any], execution: str, data: dict[str, Any], needed: str
) -> None:
    dataset = SimpleNamespace(features=data)
    for mode, raised in ((execution, ConfigurationError), (needed, ReachedError)):
        robot = make(mode)
        cfg = SimpleNamespace(robot=robot.config, dataset=SimpleNamespace(repo_id="local/x"))
        with pytest.raises(raised):
            replay(cfg, robot, dataset)


@pytest.mark.parametrize("execution", ["stream", "keyframe"])
def test_teleoperation_and_other_robots_of_the_process_are_free(make: Callable[[str], Any], execution: str) -> None:
    dataset, robot = SimpleNamespace(features=TICKS), make(execution)
    with pytest.raises(ReachedError):  # as `record`, which has its new dataset before the robot
        replay(SimpleNamespace(robot=robot.config, teleop=None, dataset=SimpleNamespace(repo_id="x")), robot, dataset)
    with pytest.raises(ReachedError):
        replay(SimpleNamespace(robot=object(), dataset=SimpleNamespace(repo_id="x")), robot, dataset)
    with pytest.raises(ReachedError):
        robot.connect()


@pytest.mark.parametrize(
    "options", [{"strategy": SimpleNamespace(type="dagger")}, {"interpolation_multiplier": 2}], ids=str
)
def test_a_rollout_that_sends_deltas_again_is_refused(make: Callable[[str], Any], options: dict[str, Any]) -> None:
    robot = make("stream")
    assert robot.interface.action == EE_DELTA
    with pytest.raises(ConfigurationError, match=r"(?s)each repeated ee_delta.*--robot\.action=ee_pose"):
        rollout(SimpleNamespace(robot=robot.config, **options), robot)
    robot.config.action = EE_POSE
    for absolute in (type(robot)(robot.config), make("keyframe")):
        with pytest.raises(ReachedError):
            rollout(SimpleNamespace(robot=absolute.config, **options), absolute)


@pytest.mark.parametrize(("option", "stored"), [("", 10), ("--dataset.fps=30", 30)])
def test_a_rollout_and_its_recording_have_the_rate_of_the_training(
    option: str, stored: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text('{"fps": 10}')
    (tmp_path / "train_config.json").write_text(json.dumps({"dataset": {"root": str(tmp_path), "repo_id": "x/y"}}))
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", option])
    robot, policy = SimpleNamespace(execution="stream"), SimpleNamespace(pretrained_path=str(tmp_path))
    cfg = SimpleNamespace(robot=robot, policy=policy, fps=30.0, dataset=SimpleNamespace(fps=30))
    adopt_training_rate(robot)
    assert (cfg.fps, cfg.dataset.fps) == (10.0, stored)


@pytest.mark.parametrize(
    ("execution", "slides", "raised"),
    [("keyframe", True, ConfigurationError), ("keyframe", False, ReachedError), ("stream", True, ReachedError)],
)
def test_the_arm_does_not_slide_to_a_person_by_key_frames(
    make: Callable[[str], Any], execution: str, slides: bool, raised: type[Exception]
) -> None:
    robot = make(execution)
    robot.config.action = EE_POSE
    strategy = SimpleNamespace(type="dagger", smooth_handover=slides)
    new = type(robot)(robot.config)
    with pytest.raises(raised):
        rollout(SimpleNamespace(robot=new.config, strategy=strategy, teleop=object()), new)


@pytest.mark.parametrize("execution", ["stream", "keyframe"])
def test_a_policy_that_needs_the_effort_is_refused_at_creation(make: Callable[[str], Any], execution: str) -> None:
    def create(cfg: Any, robot: Any) -> Any:
        return type(robot)(cfg.robot)

    robot = make(execution)
    policy = SimpleNamespace(pretrained_path="x", input_features={schema.STATE: None})
    create(SimpleNamespace(robot=robot.config, policy=policy), robot)
    policy.input_features[schema.EFFORT] = None
    with pytest.raises(ConfigurationError, match=r"(?s)hold no effort.*--policy\.use_effort=false"):
        create(SimpleNamespace(robot=robot.config, policy=policy), robot)


def test_what_cannot_be_known_is_not_refused(tmp_path: Path) -> None:
    assert execution_of_policy(checkpoint(tmp_path, KEY_FRAMES)) is Execution.KEYFRAME
    assert execution_of_policy(checkpoint(tmp_path, TICKS)) is Execution.STREAM
    assert execution_of_policy(checkpoint(tmp_path, ROLLOUT)) is None  # recorded in either mode
    assert execution_of_data(ROLLOUT) is None
    (tmp_path / "stats.safetensors").write_bytes(b"broken")
    bare = checkpoint(tmp_path / "bare", {})
    assert execution_of_policy(bare) is None
    bare.input_features = {schema.POINT_CLOUD: None}
    assert execution_of_policy(bare) is Execution.KEYFRAME


@pytest.mark.parametrize("content", ["[]", "{", '{"steps": [{"state_file": "../none"}]}', '{"steps": [1]}'])
def test_a_broken_checkpoint_is_left_to_lerobot(tmp_path: Path, content: str) -> None:
    policy = checkpoint(tmp_path, TICKS)
    (tmp_path / "policy_preprocessor.json").write_text(content)
    assert execution_of_policy(policy) is None


def test_lerobots_own_rollout_and_replay_are_recognised(tmp_path: Path) -> None:
    """The names and the order of calls in LeRobot's code that the check relies on."""
    from lerobot.rollout.context import build_rollout_context
    from lerobot.rollout.inference import SyncInferenceConfig
    from lerobot.scripts import lerobot_record, lerobot_replay

    from lerobot_adamanip.lerobot_patches.episode_signals import undecorated

    config = AdamanipFrankaConfig(calibration_dir=tmp_path, box_lower=(0.2, -0.5, 0.0), box_upper=(0.9, 0.5, 0.8))
    policy = checkpoint(tmp_path / "policy", KEY_FRAMES)
    policy.type = "act"
    cfg = SimpleNamespace(inference=SyncInferenceConfig(), policy=policy, robot=config, device="cpu")
    cfg.use_torch_compile, cfg.teleop = False, None
    monkey = pytest.MonkeyPatch()
    with monkey.context() as patch:
        patch.setattr("lerobot.rollout.context._load_pretrained_policy", lambda _: torch.nn.Identity())
        with pytest.raises(ConfigurationError, match=r"--robot\.execution=keyframe"):
            build_rollout_context(cfg, Event())
        patch.setattr(lerobot_replay, "LeRobotDataset", lambda *_, **__: Replayed())
        patch.setattr(lerobot_replay, "asdict", lambda _: {})
        replayed = SimpleNamespace(repo_id="local/x", root=None, episode=0)
        with pytest.raises(ConfigurationError, match=r"dataset local/x"):
            undecorated(lerobot_replay.replay)(SimpleNamespace(robot=config, dataset=replayed))
    assert "teleop" in lerobot_record.RecordConfig.__dataclass_fields__


class Replayed:
    features = KEY_FRAMES

    def select_columns(self, _: str) -> None:
        return None


@pytest.fixture
def streaming() -> Iterator[None]:
    ROBOTS.open("test").execution = Execution.STREAM
    yield
    ROBOTS.close("test")


@pytest.mark.usefixtures("streaming")
def test_the_preprocessor_of_our_policies_refuses_a_stream() -> None:
    """For programs that call robot and policy themselves."""
    from lerobot_policy_adamanip.common.depth_to_cloud_step import DepthToCloudStep

    depth = {"observation.images.front_depth": torch.zeros(8, 8, 1)}
    with pytest.raises(ConfigurationError, match=r"--robot\.execution=keyframe"):
        DepthToCloudStep()({"observation": depth})  # type: ignore[typeddict-item,typeddict-unknown-key]
    with pytest.raises(ConfigurationError, match="calibration of camera"):  # the mode fits
        DepthToCloudStep(control_fps=10)({"observation": depth})  # type: ignore[typeddict-item,typeddict-unknown-key]
