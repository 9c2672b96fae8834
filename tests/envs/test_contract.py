"""One contract for every registered environment: spaces, seeding, partial reset, success, Gymnasium's own checker."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from envs_helpers import SMALL, digest, expert_episode, stay
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env

import lerobot_env_adamanip  # noqa: F401  (registers the environments)
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.observation import RepeatedPointsWarning
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim
REGISTERED = sorted(name for name in EnvConfig.get_known_choices() if name.startswith("adamanip"))
SINGLE = [name for name in REGISTERED if name != "adamanip"]
every_environment = pytest.mark.parametrize("env_type", SINGLE)
AT_ONCE = ("adamanip_lamp",)
some_at_once = pytest.mark.parametrize(
    "env_type", [pytest.param(name, marks=() if name in AT_ONCE else pytest.mark.nightly) for name in SINGLE]
)
"""For what hardly depends on the category: one with every change, the others at night."""


def config_of(env_type: str, **options: Any) -> Any:
    return EnvConfig.get_choice_class(env_type)(**{**SMALL, **options})


@pytest.fixture
def env(env_type: str, envs: Any) -> Any:
    return envs(env_type.removeprefix("adamanip_"))


@every_environment
def test_spaces_seeding_and_success_are_as_agreed(env: KeyframeEnv, env_type: str) -> None:
    first, info = env.reset(seed=5)
    assert env.observation_space.contains(first)
    assert info == {"is_success": False, "limit": "", "goal_clipped": False}
    assert type(info["is_success"]) is bool
    category = CATEGORIES[env_type.removeprefix("adamanip_")]
    assert env.task == env.task_description == category.instruction
    step, reward, terminated, truncated, info = env.step(stay(env))
    assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
    assert set(info) == {"is_success", "limit", "goal_clipped"}
    for observation in (first, step):
        assert env.observation_space.contains(observation)
        assert all(np.isfinite(observation[key]).all() for key in ("agent_pos", "effort", "point_cloud"))
        assert env.workspace.contains(observation["point_cloud"]).all()
    assert len(np.unique(first["point_cloud"], axis=0)) == len(first["point_cloud"])
    again, other = digest(env.reset(seed=5)[0]), digest(env.reset(seed=6)[0])
    assert again == digest(first)
    assert other != again


@some_at_once
def test_gymnasiums_checker_has_nothing_to_say(env: KeyframeEnv, env_type: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Actions are metres, so that a policy's are those of the arm; `RescaleAction` normalises them.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        # A random pose may bring the arm before the camera.
        warnings.simplefilter("ignore", RepeatedPointsWarning)
        check_env(env, skip_close_check=True)


@every_environment
def test_an_id_makes_an_environment_that_its_spec_describes(env_type: str) -> None:
    category = CATEGORIES[env_type.removeprefix("adamanip_")]
    options = {"objects": "0:2", "num_points": 16, "observe_images": False, "hidden_overrides": {}}
    options["workspace"] = {"lower": (0.2, -0.4, 0.4), "upper": (0.9, 0.4, 1.1)}
    made = gym.make(category.keyframe_id, **options)
    direct = KeyframeEnv(category.name, **options)
    for spec in (made.spec, direct.spec):
        again = gym.make(EnvSpec.from_json(spec.to_json()))
        assert again.unwrapped.options == made.unwrapped.options == direct.options
        assert again.observation_space == made.observation_space == direct.observation_space
        again.close()
    for space in (made.action_space, *made.observation_space.spaces.values()):
        assert np.isfinite([space.low, space.high]).all()
    made.close()


def test_any_action_of_the_space_is_executed_and_info_keeps_its_keys(envs: Any) -> None:
    """As stable-baselines3's checker and Minari's collector require."""
    env = envs("lamp")
    _, first = env.reset(seed=5)
    env.action_space.seed(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RepeatedPointsWarning)
        for _ in range(8):
            observation, _, _, _, info = env.step(env.action_space.sample())
            assert env.observation_space.contains(observation)
            assert {key: type(value) for key, value in info.items()} == {
                key: type(value) for key, value in first.items()
            }


@pytest.mark.parametrize("mode", ["sync", pytest.param("async", marks=pytest.mark.nightly)])
@pytest.mark.usefixtures("no_vulkan")
def test_gymnasium_makes_several_where_nothing_renders(mode: str) -> None:
    made = gym.make_vec("AdaManipKeyframe-Lamp-v0", 2, mode, objects="0:2", num_points=16, max_key_frames=1)
    try:
        observations, _ = made.reset(seed=[5, 6])
        assert observations["point_cloud"].shape == (2, 16, 3)
        assert "pixels" not in observations
        made.action_space.seed(0)
        assert made.step(made.action_space.sample())[3].all()
        assert not made.step(made.action_space.sample())[3].any()  # the next episode
    finally:
        made.close()


@every_environment
def test_the_adaptive_expert_ends_an_episode_with_success(env: KeyframeEnv, env_type: str) -> None:
    hashes, phases, info = expert_episode(env, 17)
    assert info["is_success"] is True
    record = env.episode_record()
    assert (record["success"], record["key_frames"]) == (True, len(phases))
    assert record["category"] == env_type.removeprefix("adamanip_")
    assert expert_episode(env, 17)[0] == hashes


def test_the_suite_holds_every_category_and_starts_none() -> None:
    config = config_of("adamanip")
    made = make_env(config, n_envs=2, use_async_envs=True)
    assert list(made) == list(CATEGORIES)
    assert all(list(group) == [0] for group in made.values())
    chosen = make_env(config_of("adamanip", categories="lamp, safe"), n_envs=1)
    assert list(chosen) == ["lamp", "safe"]
    vector = chosen["lamp"][0]
    try:
        assert vector.single_observation_space["point_cloud"].shape == (3 * SMALL["num_points"],)
        assert vector.call("task_description") == (CATEGORIES["lamp"].instruction,)
    finally:
        vector.close()
