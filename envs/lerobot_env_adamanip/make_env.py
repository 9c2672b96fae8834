"""Factory of environments for worker processes."""

from __future__ import annotations

from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.rollout import SimulatedEnvironment


def make_keyframe_env(options: EnvironmentOptions) -> SimulatedEnvironment:
    """Returns a `KeyframeEnv` with these options. Module-level, so that it can be sent to spawned workers.

    The simulator is imported here, after the command has checked its options.
    """
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    return KeyframeEnv(options=options)
