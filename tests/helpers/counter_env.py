"""An environment without a simulator, for vector environments in processes of their own."""

from __future__ import annotations

import functools
import multiprocessing
import os
import signal
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from lerobot.envs.utils import freeze_after_episode_end

from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.vector import FailMalformedActions


class Counter(gym.Env[Any, Any]):
    """Observes how many steps it has made, and ends after two; each reset starts an episode."""

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012
    observation_space = gym.spaces.Box(0, 100, (1,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    render_mode = "rgb_array"
    steps = episodes = 0
    limit = ""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.steps, self.limit = 0, ""
        self.episodes += 1
        return np.zeros(1, np.float32), {"limit": ""}

    def step(self, action: Any) -> Any:
        self.steps += 1
        return np.full(1, self.steps, np.float32), 1.0, self.steps >= 2, False, {"limit": ""}

    def end_episode(self, limit: str) -> Any:
        return np.full(1, self.steps, np.float32), 0.0, False, True, {"limit": limit}

    def render(self) -> Any:
        return np.zeros((4, 4, 3), np.uint8)

    def pid(self) -> int:
        return os.getpid()

    def limits(self) -> tuple[str | None, bool]:
        return os.environ.get("OMP_NUM_THREADS"), multiprocessing.current_process().daemon

    def refuse(self) -> None:
        raise ConfigurationError("Impossible direction.", got=5, allowed="-1 or 1", hint="leave it out")

    def die(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


def make() -> gym.Env[Any, Any]:
    return FailMalformedActions(Counter())


def makers(count: int = 2) -> list[Callable[[], gym.Env[Any, Any]]]:
    return [freeze_after_episode_end(functools.partial(make))] * count
