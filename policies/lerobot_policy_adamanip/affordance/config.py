"""Shared options of the point-level methods vat_mart, adaafford and sampling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lerobot.optim.schedulers import DiffuserSchedulerConfig

from lerobot_adamanip.contract.schema import POINT_CLOUD, STATE
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.config import CloudPolicyConfig, FusedAdamWConfig


@dataclass
class AffordanceConfig(CloudPolicyConfig):
    """Base configuration: a cloud and a tool pose in metres in, a pose out."""

    FREE_OPTIONS: ClassVar[frozenset[str]] = CloudPolicyConfig.FREE_OPTIONS | {
        "optimizer_lr",
        "optimizer_weight_decay",
        "scheduler_warmup_steps",
    }

    # Number of points that describe the whole cloud (its first ones); places are described by all points.
    context_points: int = 256
    # Layer widths of the encoder of the whole cloud.
    encoder_dims: tuple[int, ...] = (64, 128)
    # Number of features of a place.
    feature_dim: int = 128
    # Radius of a place's surroundings [m].
    patch_radius: float = 0.08
    # Number of nearest points that describe a place.
    patch_points: int = 64

    # Learning rate of AdamW.
    optimizer_lr: float = 1e-3
    # Weight decay of AdamW.
    optimizer_weight_decay: float = 1e-5
    # Warm-up steps to the full learning rate, which then falls to 0 as a cosine.
    scheduler_warmup_steps: int = 50

    def check(self) -> None:
        """Raises `ConfigurationError` for options that do not fit together."""
        self.require_positive("num_points", "context_points", "feature_dim", "patch_points", "patch_radius")
        is_empty = min(self.encoder_dims, default=0) < 1
        if self.n_obs_steps != 1 or is_empty or self.context_points > self.num_points:
            raise ConfigurationError(
                f"Options of {self.type} do not fit together.",
                got=f"n_obs_steps={self.n_obs_steps}, encoder_dims={self.encoder_dims}, "
                f"context_points={self.context_points}",
                allowed=f"n_obs_steps=1, encoder_dims >= 1, context_points <= num_points={self.num_points}",
                hint="none of these options",
            )

    def require_positive(self, *names: str) -> None:
        """Raises `ConfigurationError` unless each of these options is above zero."""
        if any(getattr(self, name) <= 0 for name in names):
            raise ConfigurationError(
                f"An option of {self.type} must be positive.",
                got=", ".join(f"{name}={getattr(self, name)}" for name in names),
                allowed="above 0",
                hint="none of these options",
            )

    def validate_features(self) -> None:
        """Keeps cloud and state as inputs; raises `ConfigurationError` unless state and action are poses."""
        self.keep_inputs(POINT_CLOUD, STATE)
        self.require_poses()

    def get_optimizer_preset(self) -> FusedAdamWConfig:
        """Returns AdamW."""
        return FusedAdamWConfig(lr=self.optimizer_lr, betas=(0.9, 0.999), weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Returns a cosine schedule with warm-up."""
        return DiffuserSchedulerConfig(name="cosine", num_warmup_steps=self.scheduler_warmup_steps)
