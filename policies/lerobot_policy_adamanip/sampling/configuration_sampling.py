"""Configuration of ``sampling``."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs.policies import PreTrainedConfig

from lerobot_policy_adamanip.affordance.config import AffordanceConfig


@PreTrainedConfig.register_subclass("sampling")
@dataclass
class SamplingConfig(AffordanceConfig):
    """Options of ``sampling``. The comment above a field is its help in ``--policy.type=sampling --help``."""

    # Typical motions of the demonstrations; each is in the set forwards and backwards.
    num_motions: int = 6
    # Size of the latent vector of grasps at a point.
    latent_dim: int = 8
    # Grasps are drawn at points whose likelihood is at least this share of the best point's.
    likely_share: float = 0.3
    # Weight of the grasps' divergence from their prior, relative to an error in units of 5 cm.
    divergence_weight: float = 0.01

    def check(self) -> None:
        """Raises `ConfigurationError` for values that do not go together."""
        super().check()
        self.require_positive("num_motions", "latent_dim", "likely_share")
