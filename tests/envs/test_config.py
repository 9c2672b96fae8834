from __future__ import annotations

import dataclasses
from typing import Any

import draccus
import pytest
from lerobot.configs.types import FeatureType
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_config

import lerobot_env_adamanip  # noqa: F401  (registers the types)
from lerobot_adamanip import schema
from lerobot_adamanip.errors import ConfigurationError
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig
from lerobot_env_adamanip.keyframe_env import KeyframeEnv


@dataclasses.dataclass
class Command:
    """As LeRobot's commands hold it."""

    env: EnvConfig


def parsed(*arguments: str) -> EnvConfig:
    made: Command = draccus.parse(Command, args=["--env.type=adamanip_safe", *arguments])
    return made.env


def test_registered_under_its_name() -> None:
    config = make_env_config("adamanip_safe")
    assert isinstance(config, AdaManipSafeEnvConfig)
    assert config.type == "adamanip_safe"
    assert config.task == "safe"
    assert config.fps == schema.FPS


def test_command_line_reaches_the_environment() -> None:
    config = parsed("--env.objects=0:4", "--env.locked=true", "--env.num_points=512", "--env.pose_preset=paper")
    assert isinstance(config, AdaManipSafeEnvConfig)
    assert config.gym_kwargs["hidden_overrides"] == {"locked": True}
    assert config.gym_kwargs["objects"] == "0:4"
    assert config.features["point_cloud"].shape == (512, 3)
    env = KeyframeEnv("safe", **config.gym_kwargs)
    assert env.observation_space["point_cloud"].shape == (512, 3)


@pytest.mark.parametrize(
    ("given", "overrides"), [("false", {"locked": False}), ("true", {"locked": True}), (None, None)]
)
def test_locked_is_true_false_or_left_to_the_draw(given: str | None, overrides: dict[str, bool] | None) -> None:
    config = parsed(*([] if given is None else [f"--env.locked={given}"]))
    assert config.gym_kwargs["hidden_overrides"] == overrides


@pytest.mark.parametrize("images", [True, False])
def test_features_agree_with_map_space_and_dataset(images: bool) -> None:
    config = AdaManipSafeEnvConfig(observe_images=images, num_points=256, image_size=96)
    assert set(config.features) == set(config.features_map)
    assert ("pixels/front" in config.features) is images
    env = KeyframeEnv("safe", **config.gym_kwargs)
    dataset = schema.dataset_features(num_points=256, image_size=96)
    for key, feature in config.features.items():
        space: Any = env.observation_space if key != "action" else env.action_space
        for name in key.split("/") if key != "action" else ():
            space = space[name]
        assert tuple(feature.shape) == space.shape, key
        assert tuple(feature.shape) == tuple(dataset[config.features_map[key]]["shape"]), key
        assert (feature.type is FeatureType.ACTION) == (key == "action")
    assert ("pixels" in env.observation_space.spaces) is images


def test_nothing_hidden_is_a_feature() -> None:
    words = ("lock", "direction", "knob", "door", "hidden", "success")
    assert not [key for key in AdaManipSafeEnvConfig().features_map.values() if any(word in key for word in words)]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"objects": "drawer_000"}, "drawer_000"),
        ({"objects": "all"}, "all"),
        ({"objects": "4:4"}, "4:4"),
        ({"objects": ""}, "objects"),
        ({"num_points": 0}, "0"),
        ({"num_points": 20_000}, "20000"),
        ({"pose_preset": "fixed"}, "default, paper"),
        ({"image_size": 0}, "image size"),
        ({"episode_length": 0}, "key frames"),
    ],
)
def test_bad_options_are_refused_before_a_simulator_starts(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:") as caught:
        make_env(AdaManipSafeEnvConfig(**wrong), n_envs=1)
    assert said in str(caught.value)


def test_no_environments_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="number of environments"):
        AdaManipSafeEnvConfig().create_envs(0)


def test_building_starts_no_simulator() -> None:
    from envs_helpers import in_fresh_process

    code = """
import json, sys
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig
made = AdaManipSafeEnvConfig().create_envs(2)["adamanip_safe"][0]
print(json.dumps([made.num_envs, [name for name in ("sapien", "mani_skill") if name in sys.modules]]))
"""
    assert in_fresh_process(code) == [2, []]
