"""Options that the point-level methods share: vat_mart, adaafford, sampling."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.configs.types import NormalizationMode
from lerobot.optim.schedulers import DiffuserSchedulerConfig

from lerobot_adamanip.contract.schema import POINT_CLOUD, STATE
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.config import CloudPolicyConfig, FusedAdamWConfig


@dataclass
class AffordanceConfig(CloudPolicyConfig):
    """Base of configurations: a cloud and a tool pose in metres in, a pose out."""

    # Points that describe the whole cloud, the first of it; all of them describe the surroundings of a place.
    context_points: int = 256
    # Widths of the encoder of the whole cloud.
    encoder_dims: tuple[int, ...] = (64, 128)
    # Features of a place.
    feature_dim: int = 128
    # Points within this distance are around a place [m].
    patch_radius: float = 0.08
    # Number of the nearest points around a place that are used.
    patch_points: int = 64

    # Normalisation of each kind of feature: none, since near and far are measured in metres.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("STATE", "ENV", "VISUAL", "ACTION"), NormalizationMode.IDENTITY)
    )

    # Learning rate of AdamW.
    optimizer_lr: float = 1e-3
    # Weight decay of AdamW.
    optimizer_weight_decay: float = 1e-5
    # Steps until the full learning rate, which then falls to 0 as a cosine.
    scheduler_warmup_steps: int = 50

    def check(self) -> None:
        """Raises `ConfigurationError` for options that do not go together."""
        self.require_positive("num_points", "context_points", "feature_dim", "patch_points", "patch_radius")
        others = [mode for mode in self.normalization_mapping.values() if mode is not NormalizationMode.IDENTITY]
        if others or self.n_obs_steps != 1 or not self.encoder_dims or self.context_points > self.num_points:
            raise ConfigurationError(
                f"{self.type} cannot be set up like this.",
                got=f"normalization_mapping={self.normalization_mapping}, n_obs_steps={self.n_obs_steps}, "
                f"encoder_dims={self.encoder_dims}, context_points={self.context_points}",
                allowed="IDENTITY for each kind of feature, n_obs_steps=1, some encoder_dims, "
                f"context_points <= num_points={self.num_points}",
                hint="none of these options",
            )

    def require_positive(self, *names: str) -> None:
        """Raises `ConfigurationError` unless each of these options is above zero."""
        if any(getattr(self, name) <= 0 for name in names):
            raise ConfigurationError(
                f"A size of {self.type} has to be positive.",
                got=", ".join(f"{name}={getattr(self, name)}" for name in names),
                allowed="above 0",
                hint="none of these options",
            )

    @property
    def observation_delta_indices(self) -> None:
        """None: the present observation alone."""
        return None

    def validate_features(self) -> None:
        """Keeps cloud and state as inputs; raises `ConfigurationError` unless state and action are poses."""
        self.keep_inputs(POINT_CLOUD, STATE)
        self.require_poses()

    def get_optimizer_preset(self) -> FusedAdamWConfig:
        """AdamW."""
        return FusedAdamWConfig(lr=self.optimizer_lr, betas=(0.9, 0.999), weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Cosine with warm-up."""
        return DiffuserSchedulerConfig(name="cosine", num_warmup_steps=self.scheduler_warmup_steps)
