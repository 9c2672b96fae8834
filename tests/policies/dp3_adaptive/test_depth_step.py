"""Clouds from depth: the step itself, in checkpoints, and as lerobot-rollout runs it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.lerobot_types import TransitionKey
from lerobot.policies.factory import get_policy_class, make_policy, make_pre_post_processors
from lerobot.rollout.inference.sync import SyncInferenceEngine
from lerobot.utils.feature_utils import build_dataset_frame, hw_to_dataset_features
from toy_demos import REPO_ID

from lerobot_adamanip.contract import control, schema
from lerobot_adamanip.contract.control import FULL, STATES
from lerobot_adamanip.contract.observation import RepeatedPointsWarning
from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, transform
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics, save_calibration
from lerobot_adamanip.hardware.depth_cloud import depth_cloud
from lerobot_adamanip.hardware.robot_registry import ROBOTS
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.depth_to_cloud_step import DepthToCloudStep

HEIGHT, WIDTH, POINTS = 60, 80, 96
KEY, COLOR = "observation.images.front_depth", "observation.images.front"
INTRINSICS = Intrinsics(np.array([[70.0, 0, 39.5], [0, 70.0, 29.5], [0, 0, 1]]), np.zeros(0), WIDTH, HEIGHT)
ABOVE = transform((0.55, 0.0, 1.5), matrix_from_rotation_vector(np.array([np.pi, 0.0, 0.0])))
FRONT = CameraCalibration("looks down", INTRINSICS, ABOVE)
POSE = np.array([0.5, 0, 0.8, 1, 0, 0, 0, 1, 0, 1], np.float32)
STATE = torch.from_numpy(np.concatenate([POSE, np.zeros(schema.STATE_DIM - len(POSE), np.float32)]))


@pytest.fixture
def depth() -> np.ndarray[Any, np.dtype[np.uint16]]:
    return np.random.default_rng(0).integers(700, 718, (HEIGHT, WIDTH)).astype(np.uint16)


@pytest.fixture
def session() -> Iterator[Any]:
    made = ROBOTS.open("arm")
    made.calibrations["front"] = FRONT
    yield made
    ROBOTS.close("arm")


def given(**observation: Any) -> dict[Any, Any]:
    return {TransitionKey.OBSERVATION: {schema.STATE: STATE[None], **observation}, TransitionKey.ACTION: None}


def made(step: DepthToCloudStep, picture: torch.Tensor) -> dict[str, Any]:
    found: dict[str, Any] = step(given(**{KEY: picture, COLOR: torch.zeros(1, 3, HEIGHT, WIDTH)}))[
        TransitionKey.OBSERVATION
    ]
    return found


def test_every_form_of_a_depth_picture_makes_the_same_cloud(session: Any, depth: Any) -> None:
    """As lerobot-rollout has it, as datasets have it, with and without a batch."""
    step = DepthToCloudStep(POINTS)
    expected = torch.from_numpy(depth_cloud(depth, FRONT, POINTS))[None]
    whole = torch.from_numpy(depth)
    for picture in (
        whole[None, None],
        whole[None],
        whole[..., None],
        whole[None, ..., None],
        whole[None, None].float(),
    ):
        found = made(step, picture)
        assert torch.equal(found[schema.POINT_CLOUD], expected)
        assert not [name for name in found if name.startswith("observation.images")]
        assert torch.equal(found[schema.STATE], STATE[None])
    short = {schema.STATE: torch.zeros(1, len(STATES[control.POSE])), KEY: whole[None, None]}
    assert torch.equal(step(given(**short))[TransitionKey.OBSERVATION][schema.POINT_CLOUD], expected)
    several = torch.stack([whole, torch.zeros_like(whole)])
    state = torch.stack([STATE, STATE])
    with pytest.warns(RepeatedPointsWarning):
        found = step(given(**{KEY: several[:, None], schema.STATE: state}))[TransitionKey.OBSERVATION]
    assert found[schema.POINT_CLOUD].shape == (2, POINTS, 3)
    assert torch.equal(found[schema.POINT_CLOUD][0], expected[0])
    assert not found[schema.POINT_CLOUD][1].any()
    with pytest.warns(RepeatedPointsWarning):
        over_time = step(given(**{KEY: several[None, :, None], schema.STATE: state[None]}))[TransitionKey.OBSERVATION]
    assert torch.equal(over_time[schema.POINT_CLOUD][0], found[schema.POINT_CLOUD])


def test_what_has_a_cloud_or_no_depth_passes_as_it_is(depth: Any) -> None:
    step = DepthToCloudStep(POINTS)  # and nobody is asked for a calibration
    cloud = torch.rand(1, POINTS, 3)
    for observation in (
        {schema.POINT_CLOUD: cloud, KEY: torch.from_numpy(depth)[None]},
        {COLOR: torch.rand(1, 3, 8, 8)},
    ):
        transition = given(**observation)
        assert step(transition) is transition
    alone = {TransitionKey.ACTION: torch.zeros(1, 10)}
    assert step(alone) is alone


def test_a_file_in_the_configuration_comes_before_the_board(session: Any, depth: Any, tmp_path: Path) -> None:
    moved = CameraCalibration("moved", INTRINSICS, transform((0, 0.05, 0)) @ ABOVE)
    save_calibration(tmp_path / "c.json", "front", moved)
    step = DepthToCloudStep(POINTS, calibration=str(tmp_path / "c.json"))
    cloud = made(step, torch.from_numpy(depth)[None, None])[schema.POINT_CLOUD]
    assert torch.equal(cloud[0], torch.from_numpy(depth_cloud(depth, moved, POINTS)))
    save_calibration(tmp_path / "side.json", "side", moved)
    with pytest.raises(ConfigurationError, match=r"side\.json knows side"):
        made(DepthToCloudStep(POINTS, calibration=str(tmp_path / "side.json")), torch.from_numpy(depth)[None, None])


def test_a_missing_calibration_is_one_error_that_names_the_cameras_that_are_known(depth: Any) -> None:
    picture = torch.from_numpy(depth)[None, None]
    with pytest.raises(ConfigurationError, match=r"(?s)camera front.*adamanip calibrate"):
        made(DepthToCloudStep(POINTS), picture)
    ROBOTS.open("arm").calibrations["wrist"] = FRONT
    with pytest.raises(ConfigurationError, match="these cameras: wrist"):
        made(DepthToCloudStep(POINTS), picture)
    ROBOTS.close("arm")


def test_a_camera_on_the_hand_asks_the_state_where_the_tool_is(session: Any, depth: Any) -> None:
    tcp_in_base = transform(POSE[:3].astype(float))
    session.calibrations["front"] = CameraCalibration("wrist", INTRINSICS, None, np.linalg.inv(tcp_in_base) @ ABOVE)
    cloud = made(DepthToCloudStep(POINTS), torch.from_numpy(depth)[None, None])[schema.POINT_CLOUD]
    whole = depth_cloud(depth, FRONT, POINTS)
    assert np.abs(np.sort(cloud[0].numpy(), 0) - np.sort(whole, 0)).max() < 0.02
    assert np.abs(cloud[0, :, 2].numpy() - (1.5 - 0.709)).max() < 0.0095


@pytest.mark.parametrize(
    "picture", [torch.zeros(1, 3, HEIGHT, WIDTH), torch.zeros(1, 1, HEIGHT, WIDTH, dtype=torch.uint8)]
)
def test_what_is_no_depth_is_refused(session: Any, picture: torch.Tensor) -> None:
    with pytest.raises(ConfigurationError, match="picture is not depth"):
        made(DepthToCloudStep(POINTS), picture)


# In checkpoints -------------------------------------------------------------------------------------------------------


def saved(make: Any, folder: Path) -> tuple[Any, ...]:
    policy, before, after, dataset = make()
    for each in (policy, before, after):
        each.save_pretrained(folder)
    return policy, before, after, dataset


@pytest.mark.parametrize("method", ["dp3_adaptive", "sampling"])
def test_workspace_and_camera_of_the_dataset_reach_the_checkpoint(
    make_toy_policy: Callable[..., Any], toy_root: Path, tmp_path: Path, method: str
) -> None:
    root, box = tmp_path / "dataset", {"lower": [0.2, -0.5, -0.05], "upper": [0.9, 0.5, 0.6]}
    shutil.copytree(toy_root, root)
    info = json.loads((root / "meta" / "info.json").read_text())
    info["features"][schema.POINT_CLOUD]["info"] = {"workspace": box, "camera": "side"}
    (root / "meta" / "info.json").write_text(json.dumps(info))
    policy, *_, dataset = saved(lambda: make_toy_policy(method, root), tmp_path / "checkpoint")
    before, _ = make_pre_post_processors(policy.config, pretrained_path=str(tmp_path / "checkpoint"))
    step = next(step for step in before.steps if isinstance(step, DepthToCloudStep))
    expected = {"num_points": policy.config.num_points, "camera": "side", "calibration": None, "control_fps": None}
    assert step.get_config() == {**box, **expected}
    config = PreTrainedConfig.from_pretrained(tmp_path / "checkpoint")
    config.pretrained_path = tmp_path / "checkpoint"
    assert make_policy(config, ds_meta=dataset.meta).config.depth_camera == "side"
    other = LeRobotDataset(REPO_ID, root=toy_root)
    with pytest.raises(ConfigurationError, match=r"(?s)another workspace or camera.*camera front.*camera side"):
        make_policy(config, ds_meta=other.meta)


def test_lerobots_rollout_engine_acts_from_depth_as_from_the_cloud_of_it(
    make_tiny: Callable[..., Any], session: Any, depth: Any, tmp_path: Path
) -> None:
    """Frames as `lerobot.rollout` builds them of a robot's features; processors as it loads them of a checkpoint."""
    policy, *_ = saved(make_tiny, tmp_path)
    pictures = {"front": (HEIGHT, WIDTH, 3), "front_depth": (HEIGHT, WIDTH, 1)}
    scalars = STATES[FULL]
    features = hw_to_dataset_features({**dict.fromkeys(scalars, float), **pictures}, "observation")
    assert features[schema.STATE]["shape"] == (schema.STATE_DIM,)
    told = dict(zip(scalars, STATE.tolist(), strict=True))
    read = {**told, "front": np.zeros((HEIGHT, WIDTH, 3), np.uint8), "front_depth": depth[..., None]}
    frame = build_dataset_frame(features, read, prefix="observation")
    actions = hw_to_dataset_features(dict.fromkeys(schema.POSE_NAMES, float), "action")
    acted = []
    cloud = depth_cloud(depth, FRONT, policy.config.num_points)
    for observation in (frame, {schema.STATE: frame[schema.STATE], schema.POINT_CLOUD: cloud}):
        before, after = make_pre_post_processors(policy.config, pretrained_path=str(tmp_path))
        loaded = get_policy_class(policy.config.type).from_pretrained(tmp_path, config=policy.config)
        engine = SyncInferenceEngine(
            policy=loaded.eval(),
            preprocessor=before,
            postprocessor=after,
            dataset_features=actions,
            ordered_action_keys=list(schema.POSE_NAMES),
            task="open it",
            device="cpu",
            robot_type="panda",
        )
        engine.reset()
        torch.manual_seed(0)
        acted.append(engine.get_action(dict(observation)))
    assert acted[0].shape == (schema.ACTION_DIM,)
    assert torch.isfinite(acted[0]).all()
    assert torch.equal(acted[0], acted[1])
