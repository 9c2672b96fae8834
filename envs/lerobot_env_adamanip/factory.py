"""Builds environments by name: for workers that import a factory by string."""

from __future__ import annotations

from typing import Any

from lerobot_env_adamanip.keyframe_env import KeyframeEnv


def make_keyframe_env(category: str, num_points: int, image_size: int = 256, **options: Any) -> KeyframeEnv:
    """Returns a `KeyframeEnv`; options as there."""
    return KeyframeEnv(category, num_points=num_points, image_size=image_size, **options)
