"""Configuration of ``adaafford``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs.policies import PreTrainedConfig

from lerobot_policy_adamanip.affordance.config import AffordanceConfig

FREE = {
    "num_candidates", "num_astray", "held_proposals", "contact_points", "contact_proposals", "explorations",
    "least_information", "contact_margin", "offset_weight", "divergence_weight", "free_divergence",
}  # fmt: skip
"""Options of training, and of draws at run time, see `CloudPolicyConfig.FREE_OPTIONS`."""


@PreTrainedConfig.register_subclass("adaafford")
@dataclass
class AdaAffordConfig(AffordanceConfig):
    """Options of ``adaafford``. The comment above a field is its help in ``--policy.type=adaafford --help``."""

    FREE_OPTIONS: ClassVar[frozenset[str]] = AffordanceConfig.FREE_OPTIONS | FREE

    # Number of nearest points that describe a place.
    patch_points: int = 32
    # Size of z, the summary of past interactions.
    hidden_dim: int = 64
    # Latest interactions that z summarises.
    num_interactions: int = 16
    # Training only: actions per row with a known outcome.
    num_candidates: int = 12
    # Training only: proposals per row away from demonstrated contacts, as examples that move nothing.
    num_astray: int = 4
    # Size of the latent vector of actions at a place.
    latent_dim: int = 4

    # Number of motions proposed for a held part.
    held_proposals: int = 48
    # Number of points compared for a new contact.
    contact_points: int = 8
    # Actions proposed at each of these points; in training at each of two points.
    contact_proposals: int = 8
    # Number of first interactions that are chosen for information as well as success.
    explorations: int = 4
    # Least predicted information [nats] that counts; below it an interaction is chosen for its success only.
    least_information: float = 0.01
    # Least gain in success for which a held part is released: a new grasp costs five key frames.
    contact_margin: float = 0.1

    # Weight of a proposal's position error: a push that misses a button by 1 cm fails.
    offset_weight: float = 3.0
    # Weight of the KL divergence of proposals from their prior [nats]; the error's unit is a typical motion.
    divergence_weight: float = 0.3
    # Free bits: KL divergence without a cost [nats]; 2.0 suffices to distinguish about seven actions.
    free_divergence: float = 2.0

    def check(self) -> None:
        """Raises `ConfigurationError` for options that do not fit together."""
        super().check()
        self.require_positive(
            *("hidden_dim", "num_interactions", "num_candidates", "latent_dim", "num_astray"),
            *("held_proposals", "contact_points", "contact_proposals", "offset_weight"),
        )
