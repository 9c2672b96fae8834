"""Environments for LeRobot's environment server: ``create_adamanip_envs``. Does not import LeRobot."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.control import KEYFRAME
from lerobot_adamanip.contract.seeds import category_offset
from lerobot_adamanip.episode.options import EnvironmentOptions, require_known
from lerobot_adamanip.evaluation.record import new_run_id
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.vector import FailMalformedActions, FlatCloud, check_repeats

PREVIEW = "preview"
"""Camera whose images are for people only: ray-cast without a Vulkan device, and unknown to policies."""


class ServedEnv(FlatCloud):
    """A `KeyframeEnv` with an image in every observation, because the server shows only observed images.

    Observation: ``agent_pos`` (24,), ``effort`` (7,), ``point_cloud`` (3 N,) [m] as in datasets, and ``pixels``:
        ``front`` (H, W, 3) if images are observed, otherwise `PREVIEW`, rendered or ray-cast.

    Args:
        options: options of the environment.
    """

    def __init__(self, options: EnvironmentOptions) -> None:
        env = KeyframeEnv(options=options)
        super().__init__(FailMalformedActions(env))
        self._max_episode_steps = env.max_key_frames
        size, seen = options.image_size, self.observation_space
        assert isinstance(seen, gym.spaces.Dict)
        pixels = gym.spaces.Dict({PREVIEW: gym.spaces.Box(0, 255, (size, size, 3), np.uint8)})
        self.observation_space = gym.spaces.Dict({"pixels": pixels, **seen})

    # The server reads `_max_episode_steps` and these attributes of the outermost object.

    @property
    def task(self) -> str:
        """The instruction of the episode."""
        task: str = self.env.get_wrapper_attr("task")
        return task

    @property
    def task_description(self) -> str:
        """The instruction, with the memory if it is text."""
        description: str = self.env.get_wrapper_attr("task_description")
        return description

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Adds the image and flattens the cloud."""
        seen = super().observation(observation)
        return seen if "pixels" in seen else {**seen, "pixels": {PREVIEW: self.env.render()}}


def create_adamanip_envs(
    task: str, n_envs: int, env_cls: Callable[[Sequence[Callable[[], ServedEnv]]], Any], **options: Any
) -> dict[str, dict[int, Any]]:
    """Returns ``{category: {0: env_cls(functions)}}``; simulators start with the first reset.

    Args:
        task: one category, several separated by commas, or ``all``.
        n_envs: number of parallel environments per category.
        env_cls: vector environment class; takes one function per environment, which creates its `ServedEnv`.
        options: fields of `EnvironmentOptions` by name.

    Raises:
        ConfigurationError: a category or option does not exist, or a value is invalid.
    """
    require_known(options)
    if options.get("control", KEYFRAME) != KEYFRAME:
        raise ConfigurationError(
            "Served environments act by key frames.",
            got=f"control={options['control']!r}",
            allowed=f"control={KEYFRAME!r}",
            hint="lerobot-eval --env.type=adamanip_safe --env.control=dense, which needs no server",
        )
    names = list(CATEGORIES) if task == ALL else [name.strip() for name in task.split(",")]
    common = {"run_id": new_run_id() if options.get("episode_log") else None, **options}
    chosen = [EnvironmentOptions(**{"category": name, **common}) for name in names]
    for one in chosen:
        check_repeats(one, n_envs)
    if len(names) > 1:
        chosen = [one.changed(seed_offset=category_offset(one.category)) for one in chosen]
    return {one.category: {0: env_cls([functools.partial(ServedEnv, one)] * n_envs)} for one in chosen}
