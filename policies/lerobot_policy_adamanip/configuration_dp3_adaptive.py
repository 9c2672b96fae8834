"""Configuration of ``dp3_adaptive``: 3D diffusion policy conditioned on the history of its own actions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.optim.optimizers import AdamWConfig
from lerobot.optim.schedulers import DiffuserSchedulerConfig

from lerobot_adamanip.errors import ConfigurationError, explain, require_choice
from lerobot_adamanip.schema import ACTION_DIM, EFFORT, POINT_CLOUD, STATE

PRESETS: dict[str, dict[str, Any]] = {
    "fast": {
        "num_points": 512, "encoder": "mlp", "encoder_dims": (64, 128, 192), "encoder_out_dim": 128,
        "tcp_relative": True, "proprioception": "pose",
        "n_obs_steps": 1, "n_action_history_steps": 8, "horizon": 4, "n_action_steps": 1,
        "down_dims": (128, 256), "kernel_size": 3, "diffusion_step_embed_dim": 64,
        "noise_scheduler_type": "DDIM", "prediction_type": "sample", "num_inference_steps": 10,
        "augmentation_translation": 0.03, "augmentation_yaw": 0.1, "history_noise_std": 0.01,
        "optimizer_lr": 6e-4, "optimizer_weight_decay": 1e-6, "scheduler_warmup_steps": 100,
    },
    "paper": {
        "num_points": 4096, "encoder": "pointnet2", "encoder_dims": (64, 128, 256, 512), "encoder_out_dim": 128,
        "tcp_relative": False, "proprioception": "full",
        "n_obs_steps": 4, "n_action_history_steps": 4, "horizon": 4, "n_action_steps": 2,
        "down_dims": (256, 512, 1024), "kernel_size": 5, "diffusion_step_embed_dim": 256,
        "noise_scheduler_type": "DDPM", "prediction_type": "epsilon", "num_inference_steps": 100,
        "augmentation_translation": 0.0, "augmentation_yaw": 0.0, "history_noise_std": 0.0,
        "optimizer_lr": 1e-4, "optimizer_weight_decay": 1e-6, "scheduler_warmup_steps": 500,
    },
}  # fmt: skip
"""``paper``: Table 4 of the paper (batch size 64 is lerobot-train's ``--batch_size=64``). ``fast``: for two CPU cores."""


@PreTrainedConfig.register_subclass("dp3_adaptive")
@dataclass
class DP3AdaptiveConfig(PreTrainedConfig):
    """Fields left at None take the preset's value; a value given on the command line wins.

    Time axis, for ``n_obs_steps = 2``, ``n_action_history_steps = 3``, ``horizon = 4``, ``n_action_steps = 2``::

        step       t-3  t-2  t-1   t   t+1  t+2  t+3
        observed              o    o
        history     a    a    a
        generated                  a    a    a    a
        executed                   a    a
    """

    # fast, or paper: where fields left at None come from.
    preset: str = "fast"

    # Observation steps, the present one included.
    n_obs_steps: int = None  # type: ignore[assignment]
    # Past actions the policy is conditioned on; 0 is plain DP3.
    n_action_history_steps: int = None  # type: ignore[assignment]
    # Actions generated at once.
    horizon: int = None  # type: ignore[assignment]
    # Of those, executed before the next are generated.
    n_action_steps: int = None  # type: ignore[assignment]

    # Points used: the first of the dataset's, which are a farthest-point sample.
    num_points: int = None  # type: ignore[assignment]
    # mlp: DP3's PointNet. pointnet2: hierarchical, the paper's.
    encoder: str = None  # type: ignore[assignment]
    # Widths of the encoder's layers (mlp) or levels (pointnet2).
    encoder_dims: tuple[int, ...] = None  # type: ignore[assignment]
    # Features a cloud is condensed to.
    encoder_out_dim: int = None  # type: ignore[assignment]
    # Points also relative to the tool, and positions of history and chunk relative to it.
    tcp_relative: bool = None  # type: ignore[assignment]
    # pose: tool pose and gripper (the state's first ten). full: joint positions and velocities too.
    proprioception: str = None  # type: ignore[assignment]
    # Also look at the external joint torque.
    use_effort: bool = False

    # Channels of the U-Net's levels.
    down_dims: tuple[int, ...] = None  # type: ignore[assignment]
    kernel_size: int = None  # type: ignore[assignment]
    n_groups: int = 8
    diffusion_step_embed_dim: int = None  # type: ignore[assignment]
    use_film_scale_modulation: bool = True
    gradient_checkpointing: bool = False

    # DDPM or DDIM.
    noise_scheduler_type: str = None  # type: ignore[assignment]
    num_train_timesteps: int = 100
    num_inference_steps: int = None  # type: ignore[assignment]
    beta_schedule: str = "squaredcos_cap_v2"
    # epsilon (noise) or sample (the clean action, as DP3).
    prediction_type: str = None  # type: ignore[assignment]
    # Normalised actions are clipped to this while sampling; chunks may leave the demonstrations' range a little.
    clip_sample_range: float = 1.5

    # Exponential moving average of the weights: decay at step n is 1 - (1 + n)^-power, at most ema_max.
    ema_power: float = 0.75
    ema_max: float = 0.9999

    # Training only: each sample's scene is shifted by up to this [m] and turned about the vertical by up to this [rad].
    augmentation_translation: float = None  # type: ignore[assignment]
    augmentation_yaw: float = None  # type: ignore[assignment]
    # Training only: noise on the action history, normalised units.
    history_noise_std: float = None  # type: ignore[assignment]

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
        require_choice("encoder", str(self.encoder), ("mlp", "pointnet2"))
        require_choice("proprioception", str(self.proprioception), ("pose", "full"))
        require_choice("noise_scheduler_type", str(self.noise_scheduler_type), ("DDPM", "DDIM"))
        require_choice("prediction_type", str(self.prediction_type), ("epsilon", "sample"))
        self._check_horizon()

    def _check_horizon(self) -> None:
        factor = 2 ** (len(self.down_dims) - 1)
        if (
            self.horizon % factor
            or not 1 <= self.n_action_steps <= self.horizon
            or self.n_action_history_steps < 0
            or self.n_obs_steps < 1
        ):
            raise ConfigurationError(
                explain(
                    "Horizons do not fit.",
                    got=f"horizon={self.horizon}, n_action_steps={self.n_action_steps}, n_obs_steps={self.n_obs_steps}, "
                    f"n_action_history_steps={self.n_action_history_steps}, down_dims={tuple(self.down_dims)}",
                    allowed=f"horizon a multiple of {factor}, 1 <= n_action_steps <= horizon, n_obs_steps >= 1, history >= 0",
                    try_="--policy.horizon=4 --policy.n_action_steps=1",
                )
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

        LeRobot has no point-cloud type: as STATE it would be normalised slot by slot, which an unordered set is not.
        """
        inputs = dict(self.input_features or {})
        wanted = [POINT_CLOUD, STATE] + ([EFFORT] if self.use_effort else [])
        missing = [key for key in wanted if key not in inputs]
        if missing:
            raise ConfigurationError(
                explain(
                    f"dp3_adaptive needs {' and '.join(wanted)}.", got=", ".join(inputs) or "no inputs",
                    allowed="a dataset that has them", try_="adamanip collect",
                )
            )  # fmt: skip
        cloud = tuple(inputs[POINT_CLOUD].shape)
        if len(cloud) != 2 or cloud[1] < 3 or cloud[0] < self.num_points:
            raise ConfigurationError(
                explain(
                    "Wrong number of points.", got=f"clouds of shape {cloud}",
                    allowed=f"at least {self.num_points} points, the policy's num_points",
                    try_=f"--policy.num_points={cloud[0] if cloud else '?'}, or collect with --num-points {self.num_points}",
                )
            )  # fmt: skip
        self.input_features = {key: inputs[key] for key in wanted}
        self.input_features[POINT_CLOUD] = PolicyFeature(FeatureType.ENV, cloud)
        self.output_features = {
            key: value for key, value in (self.output_features or {}).items() if value.type is FeatureType.ACTION
        }

    @property
    def state_dim(self) -> int:
        """Dimensions of the state that are used."""
        full = int(self.input_features[STATE].shape[0])
        return min(full, ACTION_DIM) if self.proprioception == "pose" else full

    @property
    def has_pose_layout(self) -> bool:
        """Whether state and action start with the contract's ten numbers, so that poses can be moved and related."""
        action = self.action_feature
        state = (self.input_features or {}).get(STATE)
        return (
            action is not None
            and tuple(action.shape) == (ACTION_DIM,)
            and state is not None
            and state.shape[0] >= ACTION_DIM
        )

    def get_optimizer_preset(self) -> AdamWConfig:
        """AdamW."""
        return AdamWConfig(lr=self.optimizer_lr, betas=self.optimizer_betas, weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Cosine with warm-up."""
        return DiffuserSchedulerConfig(name=self.scheduler_name, num_warmup_steps=self.scheduler_warmup_steps)
