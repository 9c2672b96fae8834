"""What an environment's observations look like."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from lerobot_adamanip.contract.schema import NUM_JOINTS, STATE_DIM
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_env_adamanip.cameras import CAMERAS


def observation_space(options: EnvironmentOptions) -> gym.spaces.Dict:
    """Returns the space of what `KeyframeEnv` observes: state, effort, cloud, and a picture if one is asked for."""
    shapes = {"agent_pos": (STATE_DIM,), "effort": (NUM_JOINTS,), "point_cloud": (options.num_points, 3)}
    spaces: dict[str, gym.Space[Any]] = {
        key: gym.spaces.Box(-np.inf, np.inf, shape, np.float32) for key, shape in shapes.items()
    }
    if options.observe_images:
        size = options.image_size
        spaces["pixels"] = gym.spaces.Dict(
            {name: gym.spaces.Box(0, 255, (size, size, 3), np.uint8) for name in CAMERAS}
        )
    return gym.spaces.Dict(spaces)
