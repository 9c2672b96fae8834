"""Configuration of ``sampling``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs.policies import PreTrainedConfig

from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.affordance.config import AffordanceConfig


@PreTrainedConfig.register_subclass("sampling")
@dataclass
class SamplingConfig(AffordanceConfig):
    """Options of ``sampling``. The comment above a field is its help in ``--policy.type=sampling --help``."""

    FREE_OPTIONS: ClassVar[frozenset[str]] = AffordanceConfig.FREE_OPTIONS | {"likely_share", "divergence_weight"}

    # Number of typical motions of the demonstrations; the set contains each one and its reverse.
    num_motions: int = 6
    # Size of the latent vector of grasps at a point.
    latent_dim: int = 8
    # Least likelihood of a grasp point, as a share of the best point's.
    likely_share: float = 0.3
    # Weight of the KL divergence of grasps from their prior; the error's unit is 5 cm.
    divergence_weight: float = 0.01

    def check(self) -> None:
        """Raises `ConfigurationError` for options that do not fit together."""
        super().check()
        self.require_positive("num_motions", "latent_dim", "likely_share")
        if self.likely_share > 1:
            raise ConfigurationError(
                "No point is likely enough.",
                got=f"likely_share={self.likely_share}",
                allowed="above 0, at most 1",
                hint="--policy.likely_share=0.3",
            )
