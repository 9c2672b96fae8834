"""``--env.type=adamanip``: all nine categories as one suite, for one policy that does them all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lerobot.envs.configs import EnvConfig

from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.seeds import CATEGORY_STRIDE
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.config import AdaManipEnvConfig, VectorEnvs, make_vector_env


@EnvConfig.register_subclass("adamanip")
@dataclass
class AdaManipSuiteEnvConfig(AdaManipEnvConfig):
    """One vector environment per category; ``lerobot-eval`` reports each, and all together.

    A category's simulators start when its turn comes and end after it, so the suite needs no more memory than one.
    """

    category: ClassVar[str] = ALL

    # Which categories: names separated by commas, or all.
    categories: str = ALL

    def _check_options(self) -> None:
        for name in self.chosen():
            self._options(name)

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

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> VectorEnvs:
        """Returns ``{category: {0: vector environment}}``; one seed is another scene in each category."""
        offsets, run_id = {name: CATEGORY_STRIDE * k for k, name in enumerate(CATEGORIES)}, self._new_run_id()
        common = {"observe_images": self._observes_images(), "run_id": run_id}
        options = [self._options(name, seed_offset=offsets[name], **common) for name in self.chosen()]
        return {each.category: {0: make_vector_env(each, n_envs, use_async_envs)} for each in options}
