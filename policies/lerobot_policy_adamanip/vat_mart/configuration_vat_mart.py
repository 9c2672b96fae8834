"""Configuration of ``vat_mart``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs.policies import PreTrainedConfig

from lerobot_policy_adamanip.affordance.config import AffordanceConfig

FREE = {
    "proposals", "training_proposals", "best_proposals", "divergence_weight", "free_divergence", "grasp_weight",
    "rotation_weight",
}  # fmt: skip
"""Options of training, and of draws at run time, see `CloudPolicyConfig.FREE_OPTIONS`."""


@PreTrainedConfig.register_subclass("vat_mart")
@dataclass
class VatMartConfig(AffordanceConfig):
    """Options of ``vat_mart``. The comment above a field is its help in ``--policy.type=vat_mart --help``."""

    FREE_OPTIONS: ClassVar[frozenset[str]] = AffordanceConfig.FREE_OPTIONS | FREE

    # Number of key frames of a plan after the hand has closed.
    waypoints: int = 8
    # Number of trajectories proposed at a contact point; the best one is executed.
    proposals: int = 100
    # Training only: number of proposals per point, for the target of its actionability.
    training_proposals: int = 20
    # Training only: number of best proposals whose mean score is the actionability.
    best_proposals: int = 2
    # Size of the latent vector of trajectories at a point.
    latent_dim: int = 8

    # Weight of the KL divergence of proposals from their prior [nats]; the L1 error's unit is 15 cm.
    divergence_weight: float = 0.3
    # Free bits: KL divergence without a cost [nats].
    free_divergence: float = 1.5
    # Weight of the grasp's error (L1, offsets in units of 5 cm).
    grasp_weight: float = 3.0
    # Weight of the angle between grasps [rad].
    rotation_weight: float = 1.5

    def check(self) -> None:
        """Raises `ConfigurationError` for options that do not fit together."""
        super().check()
        self.require_positive("waypoints", "proposals", "training_proposals", "best_proposals", "latent_dim")
