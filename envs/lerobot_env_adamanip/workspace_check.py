"""Checks that the policy of a LeRobot command was trained on clouds of the environments' workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lerobot.configs import PreTrainedConfig, parser

from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from lerobot_env_adamanip.config import AdaManipEnvConfig


def require_same_workspace(environment: AdaManipEnvConfig) -> None:
    """Raises `ConfigurationError` if the policy of ``--policy.path`` tells another box of its clouds."""
    path = parser.get_path_arg("policy")
    if path is None:
        return
    policy: Any = PreTrainedConfig.from_pretrained(path)
    if not hasattr(policy, "workspace_lower"):
        return
    trained = tuple(policy.workspace_lower), tuple(policy.workspace_upper)
    offered = environment.workspace_lower, environment.workspace_upper
    if trained != offered:
        options = zip(("lower", "upper"), map(list, trained), strict=True)
        raise ConfigurationError(
            "The policy was trained on clouds of another workspace.",
            got=f"environments that crop clouds to {offered[0]} to {offered[1]} m",
            allowed=f"{trained[0]} to {trained[1]} m, as {path} was trained",
            hint=" ".join(f"--env.workspace_{name}='{corner}'" for name, corner in options),
        )
