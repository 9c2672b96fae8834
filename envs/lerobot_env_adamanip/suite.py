"""``--env.type=adamanip``: all nine categories as one suite, for one policy that does them all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium as gym
from lerobot.envs.configs import EnvConfig

from lerobot_adamanip.categories import ALL, CATEGORIES
from lerobot_adamanip.errors import ConfigurationError
from lerobot_env_adamanip.config import AdaManipEnvConfig, make_vector_env


@EnvConfig.register_subclass("adamanip")
@dataclass
class AdaManipSuiteEnvConfig(AdaManipEnvConfig):
    """One vector environment per category; ``lerobot-eval`` reports each, and all together.

    A category's simulators start when its turn comes and end after it, so the suite needs no more memory than one.
    """

    category: ClassVar[str] = ALL

    # Which categories: names separated by commas, or all.
    categories: str = ALL

    def __post_init__(self) -> None:
        """Fills features, and rejects categories that there are not."""
        super().__post_init__()
        self.chosen()

    def chosen(self) -> tuple[str, ...]:
        """Returns the names of the categories; raises `ConfigurationError` for one that there is not."""
        if self.categories == ALL:
            return tuple(CATEGORIES)
        names = tuple(name.strip() for name in self.categories.split(",") if name.strip())
        if not names or len(set(names)) != len(names) or not set(names) <= set(CATEGORIES):
            raise ConfigurationError(
                "Unknown categories.",
                got=repr(self.categories),
                allowed=f"{ALL}, or of {', '.join(CATEGORIES)}",
                hint="--env.categories=safe,microwave",
            )
        return names

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv[Any, Any, Any]]]:
        """Returns ``{category: {0: vector environment}}``."""
        kwargs = self.evaluation_kwargs()
        return {name: {0: make_vector_env(name, kwargs, n_envs, use_async_envs)} for name in self.chosen()}
