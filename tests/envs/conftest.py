"""One simulator per category and worker: tests reset it, and none closes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from envs_helpers import SMALL

from lerobot_env_adamanip.keyframe_env import KeyframeEnv


@pytest.fixture(scope="session")
def envs() -> Iterator[Callable[[str], KeyframeEnv]]:
    """Returns a category's environment: `SMALL`, without pictures."""
    made: dict[str, KeyframeEnv] = {}

    def get(category: str) -> KeyframeEnv:
        if category not in made:
            made[category] = KeyframeEnv(category, **SMALL, observe_images=False)
        return made[category]

    yield get
    for env in made.values():
        env.close()


@pytest.fixture
def tasks(envs: Callable[[str], KeyframeEnv]) -> Callable[[str], Any]:
    """Returns a category's ManiSkill task, that of its environment."""

    def get(category: str) -> Any:
        env = envs(category)
        env.reset(seed=0)  # starts the simulator
        task = env.episode.task
        task.holds_joints = True
        return task

    return get
