"""Configuration of ``dp3_adaptive``: 3D diffusion policy conditioned on the history of its own actions."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.optim.optimizers import AdamWConfig
from lerobot.optim.schedulers import DiffuserSchedulerConfig

from lerobot_adamanip.errors import ConfigurationError, require_choice
from lerobot_adamanip.schema import ACTION, ACTION_DIM, EFFORT, POINT_CLOUD, POSE_NAMES, STATE

PRESETS: dict[str, dict[str, Any]] = {
    "fast": {
        "num_points": 512, "encoder": "mlp", "encoder_dims": (64, 128, 192), "encoder_out_dim": 128,
        "tcp_relative": True, "proprioception": "pose",
        "n_obs_steps": 1, "n_action_history_steps": 8, "horizon": 4, "n_action_steps": 1,
        "down_dims": (128, 256), "kernel_size": 3, "diffusion_step_embed_dim": 64,
        "noise_scheduler_type": "DDIM", "prediction_type": "sample", "num_inference_steps": 10,
        "augmentation_translation": 0.03, "augmentation_yaw": 0.1, "history_noise_std": 0.02,
        "clip_sample_range": 6.0, "optimizer_lr": 5e-4, "optimizer_weight_decay": 1e-6, "scheduler_warmup_steps": 100,
    },
    "paper": {
        "num_points": 4096, "encoder": "pointnet2", "encoder_dims": (64, 128, 256, 512), "encoder_out_dim": 128,
        "tcp_relative": False, "proprioception": "full",
        "n_obs_steps": 4, "n_action_history_steps": 4, "horizon": 4, "n_action_steps": 2,
        "down_dims": (256, 512, 1024), "kernel_size": 5, "diffusion_step_embed_dim": 256,
        "noise_scheduler_type": "DDPM", "prediction_type": "epsilon", "num_inference_steps": 100,
        "augmentation_translation": 0.0, "augmentation_yaw": 0.0, "history_noise_std": 0.0,
        "clip_sample_range": 1.0, "optimizer_lr": 1e-4, "optimizer_weight_decay": 1e-6, "scheduler_warmup_steps": 500,
    },
}  # fmt: skip
"""``fast``: trains and acts on two CPU cores. ``paper``: the paper's table of parameters; its batch size of 64 is not
the policy's to set: ``--batch_size=64``. What the table does not say (schedules, widths) is as in the paper's code."""


@PreTrainedConfig.register_subclass("dp3_adaptive")
@dataclass
class DP3AdaptiveConfig(PreTrainedConfig):
    """Fields that are None here take the preset's value; one given on the command line wins. Saved are the values.

    Time axis, for ``n_obs_steps = 2``, ``n_action_history_steps = 3``, ``horizon = 4``, ``n_action_steps = 2``::

        step       t-3  t-2  t-1   t   t+1  t+2  t+3
        observed              o    o
        history     a    a    a
        generated                  a    a    a    a
        executed                   a    a

    Args:
        preset: ``fast`` or ``paper``.
        n_obs_steps: observed steps, the present one included.
        n_action_history_steps: past actions that the policy is conditioned on; 0 is plain DP3.
        horizon: actions generated at once.
        n_action_steps: of those, executed before the next are generated.
        num_points: points used, the first of the dataset's (any first points are a farthest-point sample).
        encoder: ``mlp`` (DP3's PointNet) or ``pointnet2`` (hierarchical, the paper's).
        encoder_dims: widths of the encoder's layers (``mlp``) or levels (``pointnet2``).
        encoder_out_dim: features a cloud is condensed to.
        tcp_relative: points also relative to the tool; history and chunk in positions relative to it. Takes effect
            where state and action are the contract's poses.
        proprioception: ``pose`` (tool pose and gripper, the state's first ten) or ``full`` (joints too).
        use_effort: also look at the external joint torque.
        down_dims: channels of the U-Net's levels; it halves the chunk between levels.
        noise_scheduler_type: ``DDPM`` or ``DDIM``.
        prediction_type: ``epsilon`` (noise) or ``sample`` (the clean action, as DP3).
        clip_sample_range: bound of an action while sampling: normalised units, or 0.15 m where positions are relative.
        ema_power: the averaged weights' decay at step n is 1 - (1 + n)^-ema_power, at most ``ema_max``.
        augmentation_translation: training only: scenes are shifted by up to this along each axis [m] ...
        augmentation_yaw: ... and turned by up to this about the vertical [rad] ...
        augmentation_center: ... through this point (x, y, z) [m], robot base frame. Joint positions do not follow.
        history_noise_std: training only: noise on the action history, normalised units.
        pose_layout: whether state and action are named as the contract's poses; found from the dataset's names.
        action_feature_names: names of the action's numbers, from the dataset; lerobot-rollout maps them to a robot's.
    """

    preset: str = "fast"

    # As in the base class, whose types are not visible to type checkers.
    input_features: dict[str, PolicyFeature] | None = field(default_factory=dict)
    output_features: dict[str, PolicyFeature] | None = field(default_factory=dict)

    # None is "from the preset" until __post_init__ has run; the types are those after it.
    n_obs_steps: int = None  # type: ignore[assignment]
    n_action_history_steps: int = None  # type: ignore[assignment]
    horizon: int = None  # type: ignore[assignment]
    n_action_steps: int = None  # type: ignore[assignment]

    num_points: int = None  # type: ignore[assignment]
    encoder: str = None  # type: ignore[assignment]
    encoder_dims: tuple[int, ...] = None  # type: ignore[assignment]
    encoder_out_dim: int = None  # type: ignore[assignment]
    tcp_relative: bool = None  # type: ignore[assignment]
    proprioception: str = None  # type: ignore[assignment]
    use_effort: bool = False

    # Read by LeRobot's U-Net under these names.
    down_dims: tuple[int, ...] = None  # type: ignore[assignment]
    kernel_size: int = None  # type: ignore[assignment]
    n_groups: int = 8
    diffusion_step_embed_dim: int = None  # type: ignore[assignment]
    use_film_scale_modulation: bool = True
    gradient_checkpointing: bool = False

    noise_scheduler_type: str = None  # type: ignore[assignment]
    num_train_timesteps: int = 100
    num_inference_steps: int = None  # type: ignore[assignment]
    beta_schedule: str = "squaredcos_cap_v2"
    prediction_type: str = None  # type: ignore[assignment]
    clip_sample_range: float = None  # type: ignore[assignment]

    ema_power: float = 0.75
    ema_max: float = 0.9999

    augmentation_translation: float = None  # type: ignore[assignment]
    augmentation_yaw: float = None  # type: ignore[assignment]
    augmentation_center: tuple[float, float, float] = (0.55, 0.0, 0.0)
    history_noise_std: float = None  # type: ignore[assignment]

    pose_layout: bool | None = None
    action_feature_names: list[str] | None = None

    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "STATE": NormalizationMode.MIN_MAX,
            "ENV": NormalizationMode.IDENTITY,
            "VISUAL": NormalizationMode.IDENTITY,
            "ACTION": NormalizationMode.MIN_MAX,
        }
    )
    license: str | None = "apache-2.0"

    optimizer_lr: float = None  # type: ignore[assignment]
    optimizer_weight_decay: float = None  # type: ignore[assignment]
    optimizer_betas: tuple[float, float] = (0.95, 0.999)
    scheduler_name: str = "cosine"
    scheduler_warmup_steps: int = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Fills in the preset and rejects combinations that cannot work."""
        for name, value in PRESETS[require_choice("preset", self.preset, PRESETS)].items():
            if getattr(self, name) is None:
                setattr(self, name, value)
        super().__post_init__()
        require_choice("encoder", self.encoder, ("mlp", "pointnet2"))
        require_choice("proprioception", self.proprioception, ("pose", "full"))
        require_choice("noise_scheduler_type", self.noise_scheduler_type, ("DDPM", "DDIM"))
        require_choice("prediction_type", self.prediction_type, ("epsilon", "sample"))
        self._check_sizes()
        self._check_horizon()
        self._check_normalization()
        if "lerobot.datasets.lerobot_dataset" in sys.modules:
            # Whoever has datasets loaded is about to read one; who evaluates only does not pay for the import.
            from lerobot_adamanip import lerobot_compat

            lerobot_compat.apply()

    def _check_sizes(self) -> None:
        widths = tuple(self.down_dims)
        fits = widths and all(width > 0 and width % self.n_groups == 0 for width in widths) and self.kernel_size % 2
        sampled = 1 <= self.num_inference_steps <= self.num_train_timesteps
        if not fits or not sampled or self.num_points < 1 or not self.encoder_dims:
            got = ("down_dims", "n_groups", "kernel_size", "num_points", "encoder_dims", "num_inference_steps")
            raise ConfigurationError(
                "Sizes do not fit.",
                got=", ".join(f"{name}={getattr(self, name)}" for name in got),
                allowed="down_dims that n_groups divides, an odd kernel_size, num_points >= 1, some encoder_dims, "
                f"1 <= num_inference_steps <= num_train_timesteps={self.num_train_timesteps}",
                hint="--policy.preset=fast, and none of these",
            )

    def _check_normalization(self) -> None:
        """Relating poses to clouds undoes the normalisation, and knows how to for one kind only."""
        modes = [self.normalization_mapping.get(kind) for kind in ("STATE", "ACTION")]
        if self.tcp_relative and any(mode is not NormalizationMode.MIN_MAX for mode in modes):
            raise ConfigurationError(
                "tcp_relative does not go with this normalisation.",
                got=", ".join(map(str, modes)),
                allowed="MIN_MAX for STATE and for ACTION",
                hint="--policy.tcp_relative=false",
            )

    def _check_horizon(self) -> None:
        factor = 2 ** (len(self.down_dims) - 1)
        fits = self.horizon % factor == 0 and 1 <= self.n_action_steps <= self.horizon
        if not fits or self.n_action_history_steps < 0 or self.n_obs_steps < 1:
            got = ("horizon", "n_action_steps", "n_obs_steps", "n_action_history_steps", "down_dims")
            raise ConfigurationError(
                "Horizons do not fit.",
                got=", ".join(f"{name}={getattr(self, name)}" for name in got),
                allowed=f"horizon a multiple of {factor}, 1 <= n_action_steps <= horizon, "
                "n_obs_steps >= 1, n_action_history_steps >= 0",
                hint="--policy.horizon=4 --policy.n_action_steps=1",
            )

    @property
    def observation_delta_indices(self) -> list[int]:
        """Observation steps relative to the present."""
        return list(range(1 - self.n_obs_steps, 1))

    @property
    def action_delta_indices(self) -> list[int]:
        """History (negative) and chunk (from 0) in one window."""
        return list(range(-self.n_action_history_steps, self.horizon))

    @property
    def reward_delta_indices(self) -> None:
        """Rewards are not used."""
        return None

    def validate_features(self) -> None:
        """Keeps cloud and state (and effort if asked for) as inputs; the cloud becomes ENV, which is left as it is.

        LeRobot has no point-cloud type: as STATE it would be normalised under the state's mode. What the policy does
        not look at, images above all, is dropped, so that a checkpoint evaluates wherever clouds are.

        Raises:
            ConfigurationError: an input is missing, or clouds have fewer points than ``num_points``.
        """
        inputs: dict[str, PolicyFeature] = dict(self.input_features or {})
        wanted = [POINT_CLOUD, STATE] + ([EFFORT] if self.use_effort else [])
        if any(key not in inputs for key in wanted):
            raise ConfigurationError(
                "dp3_adaptive misses an input.",
                got=", ".join(inputs) or "no inputs",
                allowed=f"a dataset with {', '.join(wanted)}",
                hint="adamanip collect, or another --policy.type",
            )
        cloud = tuple(inputs[POINT_CLOUD].shape)
        if len(cloud) != 2 or cloud[1] < 3 or cloud[0] < self.num_points:
            raise wrong_number_of_points(cloud, self.num_points)
        outputs: dict[str, PolicyFeature] = self.output_features or {}
        self.input_features = {key: inputs[key] for key in wanted}
        self.input_features[POINT_CLOUD] = PolicyFeature(FeatureType.ENV, cloud)
        self.output_features = {key: value for key, value in outputs.items() if key == ACTION}

    def set_dataset_feature_metadata(self, features: dict[str, dict[str, Any]]) -> None:
        """Learns from a dataset's names whether states and actions are poses. LeRobot calls this before training."""
        action, state = (_flat_names(features.get(key, {}).get("names")) for key in (ACTION, STATE))
        if action and state:
            self.pose_layout = action == list(POSE_NAMES) and state[:ACTION_DIM] == list(POSE_NAMES)

    @property
    def state_dim(self) -> int:
        """Dimensions of the state that are used."""
        full = int((self.input_features or {})[STATE].shape[0])
        return ACTION_DIM if self.proprioception == "pose" and self.has_pose_layout else full

    @property
    def has_pose_layout(self) -> bool:
        """Whether action and the state's start are the contract's ten numbers, so that they can be moved and related.

        Names decide; where a dataset has none, sizes do.
        """
        action, state = self.action_feature, (self.input_features or {}).get(STATE)
        if self.pose_layout is False or action is None or state is None:
            return False
        return tuple(action.shape) == (ACTION_DIM,) and int(state.shape[0]) >= ACTION_DIM

    def get_optimizer_preset(self) -> AdamWConfig:
        """AdamW."""
        return AdamWConfig(lr=self.optimizer_lr, betas=self.optimizer_betas, weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Cosine with warm-up."""
        return DiffuserSchedulerConfig(name=self.scheduler_name, num_warmup_steps=self.scheduler_warmup_steps)


def wrong_number_of_points(shape: tuple[int, ...], num_points: int) -> ConfigurationError:
    """Returns the error for clouds of a shape (N, 3) that is too small for a policy that uses ``num_points``."""
    return ConfigurationError(
        "Wrong number of points.",
        got=f"clouds of shape {tuple(shape)}",
        allowed=f"at least {num_points} points (the policy's num_points) of at least 3 numbers",
        hint=f"clouds of {num_points} points (--num-points, --env.num_points), or a policy trained with fewer",
    )


def _flat_names(names: Any) -> list[str]:
    """A feature's names: LeRobot allows a list, a dict of lists, or nothing."""
    if isinstance(names, dict):
        return [name for group in names.values() for name in (group if isinstance(group, list) else [str(group)])]
    return list(names or [])
