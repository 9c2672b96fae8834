"""One contract for every registered environment: spaces, seeding, partial reset, success, Gymnasium's own checker."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from envs_helpers import SMALL, digest, expert_episode, stay
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
AT_ONCE = ("adamanip_lamp", "adamanip_safe")
some_at_once = pytest.mark.parametrize(
    "env_type", [pytest.param(name, marks=() if name in AT_ONCE else pytest.mark.nightly) for name in SINGLE]
)
"""For what hardly depends on the category: two with every change, the others at night."""


def config_of(env_type: str, **options: Any) -> Any:
    return EnvConfig.get_choice_class(env_type)(**{**SMALL, **options})


@pytest.fixture
def env(env_type: str, envs: Any) -> Any:
    return envs(env_type.removeprefix("adamanip_"))


@every_environment
def test_spaces_seeding_and_success_are_as_agreed(env: KeyframeEnv, env_type: str) -> None:
    first, info = env.reset(seed=5)
    assert env.observation_space.contains(first)
    assert info == {"is_success": False, "limit": ""}
    assert type(info["is_success"]) is bool
    category = CATEGORIES[env_type.removeprefix("adamanip_")]
    assert env.task == env.task_description == category.instruction
    step, reward, terminated, truncated, info = env.step(stay(env))
    assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
    assert set(info) == {"is_success", "limit"}
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
        # Poses are not bounded by the space (the driver clips them, and says what it reached).
        warnings.filterwarnings("ignore", message=".*(infinity|symmetric and normalized|spec).*")
        # A random pose may bring the arm before the camera.
        warnings.simplefilter("ignore", RepeatedPointsWarning)
        check_env(env, skip_render_check=True)


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
