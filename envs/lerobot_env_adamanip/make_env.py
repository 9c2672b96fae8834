"""Builds environments for workers, in processes of their own."""

from __future__ import annotations

from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.rollout import SimulatedEnvironment


def make_keyframe_env(options: EnvironmentOptions) -> SimulatedEnvironment:
    """Returns a `KeyframeEnv` of options. A function of a module, so that spawned workers can be given it.

    The simulator is imported here: what a command is given wrongly is found before.
    """
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    return KeyframeEnv(options=options)
