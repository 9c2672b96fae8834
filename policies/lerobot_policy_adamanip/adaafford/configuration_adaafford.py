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
    # Size of what is concluded from interactions, z.
    hidden_dim: int = 64
    # Interactions that conclusions are drawn from: the latest so many.
    num_interactions: int = 16
    # Training only: actions per row whose outcome is asked for.
    num_candidates: int = 12
    # Training only: proposals per row, away from where anybody has taken hold, that are taught to move nothing.
    num_astray: int = 4
    # Size of what tells actions at one place apart.
    latent_dim: int = 4

    # Motions proposed for what is held.
    held_proposals: int = 48
    # Points proposed to take hold of ...
    contact_points: int = 8
    # ... and actions at each; in training so many at each of two points.
    contact_proposals: int = 8
    # So many first interactions are also chosen for what they would tell.
    explorations: int = 4
    # An interaction that promises to tell less than this [nats] is chosen for its success alone.
    least_information: float = 0.01
    # What is held is kept unless something else promises this much more success: taking hold costs five key frames.
    contact_margin: float = 0.1

    # Weight of where a proposal takes hold beside the rest of it: a button missed by a centimetre is not pressed.
    offset_weight: float = 3.0
    # Weight of the proposals' divergence from their prior [nats], beside an error in units of a typical motion ...
    divergence_weight: float = 0.3
    # ... and how much of it costs nothing: enough to tell some seven actions apart.
    free_divergence: float = 2.0

    def check(self) -> None:
        """Raises `ConfigurationError` for values that do not go together."""
        super().check()
        self.require_positive(
            *("hidden_dim", "num_interactions", "num_candidates", "latent_dim", "num_astray"),
            *("held_proposals", "contact_points", "contact_proposals", "offset_weight"),
        )
