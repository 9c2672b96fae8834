from __future__ import annotations

import dataclasses
import json
from typing import Any

import draccus
import numpy as np
import pytest
from lerobot.configs.types import FeatureType
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_config

import lerobot_env_adamanip  # noqa: F401  (registers the types)
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import CAMERAS
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.seeds import MAX_SEED, scene_seed
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim import render_device
from lerobot_env_adamanip.twin.config_devices import AdamanipFrankaSimConfig
from lerobot_env_adamanip.vector import FlatCloud


@dataclasses.dataclass
class Command:
    """As LeRobot's commands hold it."""

    env: EnvConfig


def parsed(*arguments: str) -> EnvConfig:
    made: Command = draccus.parse(Command, args=["--env.type=adamanip_safe", *arguments])
    return made.env


def test_command_line_reaches_the_environment() -> None:
    config = parsed(
        "--env.objects=0:4",
        "--env.locked=true",
        "--env.num_points=512",
        "--env.poses=fixed",
        "--env.workspace_lower=[0.2,-0.5,0.4]",
        "--env.split=train",
        "--env.render_backend=cpu",
        "--env.observe_images=true",
    )
    assert isinstance(config, AdaManipSafeEnvConfig)
    assert (config.type, config.task, config.fps) == ("adamanip_safe", "safe", None)
    assert config.features["point_cloud"].shape == (1536,)
    env = KeyframeEnv(**config.gym_kwargs)
    assert env.observation_space["point_cloud"].shape == (512, 3)
    assert env.options.changed(workspace=DEFAULT_WORKSPACE) == EnvironmentOptions(
        category="safe",
        objects="0:4",
        num_points=512,
        poses="fixed",
        hidden_overrides={"locked": True},
        split="train",
        render_backend="cpu",
        observe_images=True,
    )
    assert env.workspace.lower == (0.2, -0.5, 0.4)


@pytest.mark.parametrize(("typed", "value"), [("2", 2), ("best", "best"), (None, None)])
def test_the_limit_of_failed_tries_is_a_number_or_best(typed: str | None, value: int | str | None) -> None:
    assert AdaManipSafeEnvConfig(max_failed_tries=typed).options.max_failed_tries == value


def test_every_option_of_an_environment_can_be_typed() -> None:
    """A new option of `EnvironmentOptions` must not be forgotten in LeRobot's configuration."""
    elsewhere = {
        "max_key_frames": "episode_length",
        "max_steps": "episode_length",
        "workspace": "workspace_lower",
        "hidden_overrides": "locked",
        "category": "type",
        "seed_offset": "type",
        "run_id": "type",
    }
    names = {item.name for item in dataclasses.fields(AdaManipSafeEnvConfig)} | {"type"}
    assert {elsewhere.get(item.name, item.name) for item in dataclasses.fields(EnvironmentOptions)} <= names


def test_parallel_tasks_are_refused_because_they_share_a_policy() -> None:
    with pytest.raises(AdaManipError, match=r"(?s)Parallel tasks.*got: .*max_parallel_tasks=2.*try:"):
        make_env_config("adamanip", max_parallel_tasks=2)


def test_reading_the_options_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render_device, "can_render", lambda: False)
    config = AdaManipSafeEnvConfig()
    before = dict(config.features)
    assert config.options.observe_images is None
    assert config.gym_kwargs["options"] == config.options
    assert config.features == before


@pytest.mark.parametrize(("given", "overrides"), [("false", {"locked": False}), ("true", {"locked": True}), (None, {})])
def test_locked_is_true_false_or_left_to_the_draw(given: str | None, overrides: dict[str, bool]) -> None:
    config = parsed(*([] if given is None else [f"--env.locked={given}"]))
    assert isinstance(config, AdaManipSafeEnvConfig)
    assert config.options.hidden_overrides == overrides


@pytest.mark.parametrize("images", [True, False])
def test_features_agree_with_map_space_and_dataset(images: bool) -> None:
    config = AdaManipSafeEnvConfig(observe_images=images, num_points=256, image_size=96, cameras=list(CAMERAS))
    assert set(config.features) == set(config.features_map)
    assert not any("/" in name for name in config.features), "lerobot-eval's recordings take them for columns"
    pictures = {"observation.images.front", "observation.images.wrist"}
    assert {name for name in config.features if "images" in name} == (pictures if images else set())
    env = FlatCloud(KeyframeEnv(**config.gym_kwargs))
    dataset = schema.dataset_features(num_points=256, image_size=96, cameras=CAMERAS)
    for key, feature in config.features.items():
        space: Any = env.observation_space if key != "action" else env.action_space
        for name in key.replace("observation.images.", "pixels/").split("/") if key != "action" else ():
            space = space[name]
        assert tuple(feature.shape) == space.shape, key
        assert tuple(feature.shape) == tuple(dataset[config.features_map[key]]["shape"]), key
        assert (feature.type is FeatureType.ACTION) == (key == "action")
    assert ("pixels" in env.env.observation_space.spaces) is images
    assert env.observation({"point_cloud": np.zeros((256, 3))})["point_cloud"].shape == (768,)


@pytest.mark.parametrize("control", ["keyframe", "dense"])
def test_a_checkpoint_names_the_cameras(control: str) -> None:
    config = parsed(
        f"--env.control={control}",
        "--env.cameras=[front,wrist]",
        "--env.camera_names=[camera1,camera2]",
        "--env.image_source=raycast",
    )
    (group,) = config.create_envs(1).values()
    space: Any = group[0].single_observation_space["pixels"]
    assert list(space) == ["camera1", "camera2"]
    names = {f"observation.images.{name}" for name in ("camera1", "camera2")}
    assert {key for key in config.features if "images" in key} == names <= set(config.features_map.values())


def test_a_stored_configuration_can_be_changed() -> None:
    """What was not chosen follows from what is: the rate, and the steps of 30 seconds."""
    stored = draccus.decode(EnvConfig, json.loads(json.dumps(draccus.encode(AdaManipSafeEnvConfig(), EnvConfig))))
    dense = dataclasses.replace(stored, control="dense")
    assert (dense.options.fps, dense.options.step_limit) == (10, 300)
    assert dataclasses.replace(dense, fps=25).options.step_limit == 750
    assert dataclasses.replace(dense, control="keyframe").options == AdaManipSafeEnvConfig().options


@pytest.mark.parametrize("names", ["ab", ["camera1"], ["a", "a"], ["a", "b/c"], ["a", ""], ["a", "b", "c"]])
def test_wrong_names_of_cameras_are_refused(names: list[str]) -> None:
    with pytest.raises(AdaManipError, match=r"(?s)names of cameras.*got:.*try: +--env.cameras="):
        AdaManipSafeEnvConfig(cameras=["front", "wrist"], camera_names=names)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"objects": "drawer_000"}, "drawer_000"),
        ({"workspace_upper": (0.1, 0.1, 0.1)}, "workspace"),
        ({"episode_length": 0}, "key frames"),
        ({"logged_seeds": (5, 5)}, "logged_seeds=(5, 5)"),
        ({"fps": 0, "control": "dense"}, "rate"),
        ({"workspace_lower": (0.1, 0.1)}, "tuple[float, float, float]"),
    ],
)
def test_bad_options_are_refused_before_a_simulator_starts(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(AdaManipError, match=r"(?s)got:.*allowed:.*try:") as caught:
        AdaManipSafeEnvConfig(**wrong)
    assert said in str(caught.value)


@pytest.mark.parametrize("seed", [MAX_SEED + 1, 2**70])
def test_a_seed_that_no_log_holds_is_refused_before_a_simulator_starts(seed: int) -> None:
    with pytest.raises(ConfigurationError, match=rf"(?s)got: +{seed}.*allowed: +0 ... {MAX_SEED}.*try:"):
        KeyframeEnv().reset(seed=seed)


def test_no_environments_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="number of environments"):
        AdaManipSafeEnvConfig().create_envs(0)


TYPES = sorted(name for name in EnvConfig.get_known_choices() if name.startswith("adamanip"))


# Splits -----------------------------------------------------------------------------------------------------------


def split_of_envs(config: AdaManipSafeEnvConfig) -> str:
    vector = make_env(config, n_envs=1)["adamanip_safe"][0]
    try:
        return str(vector.call("get_wrapper_attr", "options")[0].split)
    finally:
        vector.close()


def test_a_script_gets_no_test_scenes_unless_it_asks() -> None:
    assert split_of_envs(make_env_config("adamanip_safe", split="test")) == "test"
    assert {make_env_config(each).split for each in TYPES} == {"validation"}
    assert EnvironmentOptions().split == KeyframeEnv("safe").options.split == "validation"
    assert AdamanipFrankaSimConfig().environment().split == "validation"


def test_the_suites_categories_have_scenes_of_their_own() -> None:
    made = make_env(make_env_config("adamanip", categories="lamp,safe,bottle"), n_envs=1)
    assert list(made) == ["lamp", "safe", "bottle"]
    options = {name: group[0].call("get_wrapper_attr", "options")[0] for name, group in made.items()}
    assert {name: each.category for name, each in options.items()} == {name: name for name in made}
    seeds = {scene_seed(seed + each.seed_offset, each.split) for each in options.values() for seed in range(1000, 1050)}
    assert len(seeds) == 150
    for group in made.values():
        group[0].close()
