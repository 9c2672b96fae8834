"""Configuration of ``adaafford``."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs.policies import PreTrainedConfig

from lerobot_policy_adamanip.affordance.config import AffordanceConfig


@PreTrainedConfig.register_subclass("adaafford")
@dataclass
class AdaAffordConfig(AffordanceConfig):
    """Options of ``adaafford``. The comment above a field is its help in ``--policy.type=adaafford --help``."""

    # The nearest points around a place.
    patch_points: int = 32
    # Size of z, the summary of past interactions.
    hidden_dim: int = 64
    # Latest interactions that z summarises.
    num_interactions: int = 16
    # Training only: actions per row with a known outcome.
    num_candidates: int = 12
    # Training only: proposals per row, away from demonstrated contacts, taught to move nothing.
    num_astray: int = 4
    # Size of the latent vector of actions at a place.
    latent_dim: int = 4

    # Motions proposed for a held part.
    held_proposals: int = 48
    # Points of a new contact that are compared.
    contact_points: int = 8
    # Actions proposed at each of them, and in training at each of two points.
    contact_proposals: int = 8
    # Number of first interactions that are also chosen for their information.
    explorations: int = 4
    # Interactions with less predicted information than this [nats] are chosen for their success alone.
    least_information: float = 0.01
    # A held part is kept unless another promises this much more success: a new grasp costs five key frames.
    contact_margin: float = 0.1

    # Weight of a proposal's offset: a button missed by a centimetre is not pressed.
    offset_weight: float = 3.0
    # Weight of the proposals' divergence from their prior [nats], relative to an error in units of a typical motion.
    divergence_weight: float = 0.3
    # Free bits: divergence without a cost [nats], enough to distinguish some seven actions.
    free_divergence: float = 2.0

    def check(self) -> None:
        """Raises `ConfigurationError` for values that do not go together."""
        super().check()
        self.require_positive(
            *("hidden_dim", "num_interactions", "num_candidates", "latent_dim", "num_astray"),
            *("held_proposals", "contact_points", "contact_proposals", "offset_weight"),
        )
