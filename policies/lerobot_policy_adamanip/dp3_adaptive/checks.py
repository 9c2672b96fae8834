"""What a configuration of ``dp3_adaptive`` cannot be: found when it is made, each in one clear error."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lerobot.configs.types import NormalizationMode

from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.contract import require_action

if TYPE_CHECKING:
    from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig

ANCHOR_SIZES = ("num_anchors", "memory_dim", "trunk_dim", "training_points", "coarse_points", "refinement_points")


def check_sizes(config: DP3AdaptiveConfig) -> None:
    """Refuses sizes that do not fit each other."""
    widths = tuple(config.down_dims)
    fits = widths and all(width > 0 and width % config.n_groups == 0 for width in widths) and config.kernel_size % 2
    sampled = 1 <= config.num_inference_steps <= config.num_train_timesteps
    anchored = all(getattr(config, name) >= 1 for name in ANCHOR_SIZES) and config.num_refinements >= 0
    if not fits or not sampled or not anchored or config.num_points < 1 or not config.encoder_dims:
        got = [
            *("down_dims", "n_groups", "kernel_size", "num_points", "encoder_dims", "num_inference_steps"),
            *ANCHOR_SIZES,
            "num_refinements",
        ]
        raise ConfigurationError(
            "Sizes do not fit.",
            got=", ".join(f"{name}={getattr(config, name)}" for name in got),
            allowed="down_dims that n_groups divides, an odd kernel_size, num_points >= 1, some encoder_dims, "
            f"{', '.join(ANCHOR_SIZES)} >= 1, num_refinements >= 0, "
            f"1 <= num_inference_steps <= num_train_timesteps={config.num_train_timesteps}",
            hint="--policy.preset=fast, and none of these",
        )


def check_augmentation(config: DP3AdaptiveConfig) -> None:
    """Refuses a share that is none."""
    if not 0.0 <= config.augmentation_mirror <= 1.0:
        raise ConfigurationError(
            "Not a share of scenes.",
            got=f"augmentation_mirror={config.augmentation_mirror}",
            allowed="0 to 1",
            hint="--policy.augmentation_mirror=0.5",
        )


def check_normalization(config: DP3AdaptiveConfig) -> None:
    """Relating poses to clouds undoes the normalisation, and knows how to for one kind only."""
    modes = [config.normalization_mapping.get(kind) for kind in ("STATE", "ACTION")]
    anchors = config.head == "anchors"
    wanted = NormalizationMode.IDENTITY if anchors else NormalizationMode.MIN_MAX
    if (anchors or config.tcp_relative) and any(mode is not wanted for mode in modes):
        raise ConfigurationError(
            f"{'The head anchors' if anchors else 'tcp_relative'} does not go with this normalisation.",
            got=", ".join(map(str, modes)),
            allowed=f"{wanted.name} for STATE and for ACTION",
            hint="--policy.preset=diffusion --policy.tcp_relative=false",
        )


def check_horizon(config: DP3AdaptiveConfig) -> None:
    """Refuses horizons that the head cannot have."""
    factor = 1 if config.head == "anchors" else 2 ** (len(config.down_dims) - 1)
    fits = config.horizon % factor == 0 and 1 <= config.n_action_steps <= config.horizon
    if not fits or config.n_action_history_steps < 0 or config.n_obs_steps < 1:
        got = ("horizon", "n_action_steps", "n_obs_steps", "n_action_history_steps", "down_dims")
        raise ConfigurationError(
            "Horizons do not fit.",
            got=", ".join(f"{name}={getattr(config, name)}" for name in got),
            allowed=f"horizon a multiple of {factor}, 1 <= n_action_steps <= horizon, "
            "n_obs_steps >= 1, n_action_history_steps >= 0",
            hint="--policy.horizon=4 --policy.n_action_steps=1",
        )
    if config.head == "anchors" and (config.n_obs_steps, config.horizon) != (1, 1):
        raise ConfigurationError(
            "The head anchors looks at one cloud and draws one action.",
            got=f"n_obs_steps={config.n_obs_steps}, horizon={config.horizon}",
            allowed="n_obs_steps=1, horizon=1; n_action_history_steps says how far back it remembers",
            hint="--policy.preset=diffusion",
        )


def require_actions(config: DP3AdaptiveConfig) -> None:
    """Refuses a dataset without actions, or with such as the head cannot draw."""
    require_action(config)
    if config.head == "anchors" and not config.has_pose_layout:
        raise ConfigurationError(
            "The head anchors moves a tool, and these actions are no poses of one.",
            got=f"action {tuple(config.action_feature.shape)}",
            allowed="the ten pose numbers of the contract, in action and in state",
            hint="--policy.preset=diffusion",
        )
