"""Configuration of ``sampling``."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs.policies import PreTrainedConfig

from lerobot_policy_adamanip.affordance.config import AffordanceConfig


@PreTrainedConfig.register_subclass("sampling")
@dataclass
class SamplingConfig(AffordanceConfig):
    """Options of ``sampling``. The comment above a field is its help in ``--policy.type=sampling --help``."""

    # Typical motions of the demonstrations that are told apart; each is in the set forwards and backwards.
    num_motions: int = 6
    # Size of what tells grasps at one point apart.
    latent_dim: int = 8
    # Points at which a grasp is at least this share as likely as at the best one are drawn alike.
    likely_share: float = 0.3
    # Weight of the grasps' divergence from their prior, beside an error in units of 5 cm.
    divergence_weight: float = 0.01

    def check(self) -> None:
        """Raises `ConfigurationError` for values that do not go together."""
        super().check()
        self.require_positive("num_motions", "latent_dim", "likely_share")
