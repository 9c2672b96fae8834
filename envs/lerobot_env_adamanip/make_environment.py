"""Factory of environments for worker processes."""

from __future__ import annotations

from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.rollout import SimulatedEnvironment


def make_environment(options: EnvironmentOptions) -> SimulatedEnvironment:
    """Returns a `KeyframeEnv` or `DenseEnv` with these options.

    Module-level, so that it can be sent to workers. The simulator is imported here, after the options are checked.
    """
    from lerobot_env_adamanip.dense_env import DenseEnv
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    return DenseEnv(options=options) if options.is_dense else KeyframeEnv(options=options)
