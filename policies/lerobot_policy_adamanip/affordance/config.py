"""Options that the point-level methods share: vat_mart, adaafford, sampling."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import NormalizationMode, PolicyFeature
from lerobot.optim.schedulers import DiffuserSchedulerConfig

from lerobot_adamanip.contract.schema import POINT_CLOUD, STATE
from lerobot_adamanip.util.errors import ConfigurationError, shown_by_parsers
from lerobot_policy_adamanip.common.contract import has_pose_layout, keep_inputs, names_are_poses, require_action
from lerobot_policy_adamanip.common.optimizer import FusedAdamWConfig


@dataclass
class AffordanceConfig(PreTrainedConfig):
    """Base of configurations: a cloud and a tool pose in metres, a pose out. The comment above a field is its help."""

    # Set by itself: names and shapes of the inputs, from the dataset.
    input_features: dict[str, PolicyFeature] | None = field(default_factory=dict)
    # Set by itself: name and shape of the action, from the dataset.
    output_features: dict[str, PolicyFeature] | None = field(default_factory=dict)

    # Points used: the first of the dataset's, of which any first are a farthest-point sample.
    num_points: int = 1024
    # Of those, so many tell what the cloud is; the others what is around a place.
    context_points: int = 256
    # Widths of the encoder of the whole cloud.
    encoder_dims: tuple[int, ...] = (64, 128)
    # Features of a place.
    feature_dim: int = 128
    # Points within this distance are around a place [m].
    patch_radius: float = 0.08
    # The nearest so many of them.
    patch_points: int = 64

    # Set by itself: whether state and action are poses, from the dataset's names.
    pose_layout: bool | None = None
    # Set by itself: names of the action's numbers, from the dataset; lerobot-rollout maps them to a robot's.
    action_feature_names: list[str] | None = None

    # How each kind of feature is normalised: not at all, what is near and far is said in metres.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(("STATE", "ENV", "VISUAL", "ACTION"), NormalizationMode.IDENTITY)
    )
    # Publish the policy on the Hub when the training ends, under repo_id.
    push_to_hub: bool = True
    # Where on the Hub: user/name.
    repo_id: str | None = None
    # Licence of a published policy, as the Hub names it.
    license: str | None = "apache-2.0"

    # Learning rate of AdamW.
    optimizer_lr: float = 1e-3
    # Weight decay of AdamW.
    optimizer_weight_decay: float = 1e-5
    # Steps until the full learning rate, which then falls to 0 as a cosine.
    scheduler_warmup_steps: int = 50

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for values that do not go together."""
        with shown_by_parsers():
            self.check()
        super().__post_init__()

    def check(self) -> None:
        """Raises `ConfigurationError` for values that do not go together."""
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
        """The present alone; what has been is looked up where labels are made."""
        return None

    @property
    def action_delta_indices(self) -> None:
        """Actions come from where labels are made, a whole episode at a time."""
        return None

    @property
    def reward_delta_indices(self) -> None:
        """Rewards are not used."""
        return None

    def validate_features(self) -> None:
        """Keeps cloud and state as inputs.

        Raises:
            ConfigurationError: one is missing, clouds have fewer points than ``num_points``, or state and action are
                no poses.
        """
        keep_inputs(self, (POINT_CLOUD, STATE), self.num_points)
        require_action(self)
        if not has_pose_layout(self, self.pose_layout):
            raise ConfigurationError(
                f"{self.type} moves a tool, and these actions are no poses of one.",
                got=f"action {tuple(self.action_feature.shape)}, named as poses: {self.pose_layout}",
                allowed="the ten pose numbers of the contract, in action and in state",
                hint="adamanip collect, or --policy.type=dp3_adaptive --policy.preset=diffusion",
            )

    def set_dataset_feature_metadata(self, features: dict[str, dict[str, Any]]) -> None:
        """Learns from a dataset's names whether states and actions are poses. LeRobot calls this before training."""
        named = names_are_poses(features)
        self.pose_layout = self.pose_layout if named is None else named

    def get_optimizer_preset(self) -> FusedAdamWConfig:
        """AdamW."""
        return FusedAdamWConfig(lr=self.optimizer_lr, betas=(0.9, 0.999), weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Cosine with warm-up."""
        return DiffuserSchedulerConfig(name="cosine", num_warmup_steps=self.scheduler_warmup_steps)
