"""Ended environments wait: without a simulator."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from lerobot_env_adamanip.vector import FreezeAfterEpisodeEnd


def make_counter(length: int = 2) -> gym.Env[Any, Any]:
    """An environment that observes how many steps it has made, and ends after ``length`` of them."""

    class Counter(gym.Env[Any, Any]):
        observation_space = gym.spaces.Box(0, 100, (1,), np.float32)
        action_space = gym.spaces.Box(-1, 1, (1,), np.float32)
        steps = 0

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            self.steps = 0
            return np.zeros(1, np.float32), {}

        def step(self, action: Any) -> Any:
            self.steps += 1
            return np.full(1, self.steps, np.float32), 1.0, self.steps >= length, False, {}

    return Counter()


def test_an_ended_episode_is_repeated_until_a_rollout_resets() -> None:
    env = FreezeAfterEpisodeEnd(make_counter())
    action = np.zeros(1, np.float32)
    env.reset(seed=0)
    assert [env.step(action)[1:3] for _ in range(4)] == [(1.0, False), (1.0, True), (0.0, True), (0.0, True)]
    assert env.reset()[0][0] == 2  # Gymnasium's own reset
    assert env.step(action)[0][0] == 2
    for started in ({"seed": 1}, {"options": {"lerobot_new_rollout": True}}):
        assert env.reset(**started)[0][0] == 0
        assert env.step(action)[0][0] == 1
        env.step(action)
