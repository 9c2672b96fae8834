"""AdaManip ($title) for LeRobot's EnvHub: ``make_env("$repo_id", trust_remote_code=True)``."""

from __future__ import annotations

from typing import Any

try:
    import lerobot_env_adamanip  # noqa: F401  (registers the environments with LeRobot)
except ModuleNotFoundError as error:
    # Another kind of error than the one caught: LeRobot would replace this text by the name of the module alone.
    raise ImportError(f"$install (no module {error.name})") from error


def make_env(n_envs: int = 1, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
    """Returns ``{suite: {task: vector environment}}`` with ``n_envs`` environments each, of validation scenes."""
    from lerobot.envs.factory import make_env as build
    from lerobot.envs.factory import make_env_config

    return build(make_env_config("$env_type"), n_envs=n_envs, use_async_envs=use_async_envs)
