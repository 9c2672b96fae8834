"""Builds environments for workers, in processes of their own."""

from __future__ import annotations

from typing import Any

from lerobot_adamanip.options import EnvironmentOptions
from lerobot_adamanip.rollout import KeyframeEnvironment
from lerobot_env_adamanip.keyframe_env import KeyframeEnv


def make_keyframe_env(
    category: str | EnvironmentOptions, num_points: int | None = None, image_size: int = 256, **values: Any
) -> KeyframeEnv:
    """Returns a `KeyframeEnv` of options; or of a category and values as there, with training scenes."""
    if isinstance(category, EnvironmentOptions):
        return KeyframeEnv(options=category)
    values.setdefault("split", "train")
    if num_points is not None:
        values["num_points"] = num_points
    return KeyframeEnv(category, image_size=image_size, **values)


def as_keyframe_environment(env: KeyframeEnv) -> KeyframeEnvironment:
    """Returns ``env`` as what rollouts take: the type checker's proof that it is that."""
    return env
