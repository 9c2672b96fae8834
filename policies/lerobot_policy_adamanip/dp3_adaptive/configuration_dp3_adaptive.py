"""Configuration of ``dp3_adaptive``: a policy over point clouds with a history of its own actions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import NormalizationMode
from lerobot.optim.schedulers import DiffuserSchedulerConfig

from lerobot_adamanip.contract.schema import ACTION_DIM, EFFORT, POINT_CLOUD, STATE
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_policy_adamanip.common.config import CloudPolicyConfig, FusedAdamWConfig
from lerobot_policy_adamanip.dp3_adaptive.presets import PRESETS

CHOICES = {
    "head": ("anchors", "diffusion"),
    "encoder": ("mlp", "pointnet2"),
    "proprioception": ("pose", "full"),
    "noise_scheduler_type": ("DDPM", "DDIM"),
    "prediction_type": ("epsilon", "sample"),
}
ANCHOR_SIZES = ("num_anchors", "memory_dim", "trunk_dim", "training_points", "coarse_points", "refinement_points")
SIZES = ("down_dims", "n_groups", "kernel_size", "num_points", "encoder_dims", "num_inference_steps")
HORIZONS = ("horizon", "n_action_steps", "n_obs_steps", "n_action_history_steps", "down_dims")


def from_preset() -> Any:
    """Returns a field that is None until `DP3AdaptiveConfig.check` sets it from the preset."""
    return field(default=None)


@PreTrainedConfig.register_subclass("dp3_adaptive")
@dataclass
class DP3AdaptiveConfig(CloudPolicyConfig):
    """Options of ``dp3_adaptive``. Command-line options override the preset; a checkpoint saves the final values.

    Time axis, for ``n_obs_steps = 2``, ``n_action_history_steps = 3``, ``horizon = 4``, ``n_action_steps = 2``::

        step       t-3  t-2  t-1   t   t+1  t+2  t+3
        observed              o    o
        history     a    a    a
        generated                  a    a    a    a
        executed                   a    a

    The comment above a field is its help in ``lerobot-train --policy.type=dp3_adaptive --help``.
    """

    # Preset, the defaults of the options below: fast or diffusion (for two CPU cores), dp3 or paper (as published).
    preset: str = "fast"
    # Set automatically: the preset that the saved values come from.
    values_from: str | None = None

    # Head that draws actions: anchors (typical motions, refined) or diffusion, the paper's (fast anchors, diffusion
    # diffusion, dp3 diffusion, paper diffusion).
    head: str = from_preset()

    # Observed steps, including the present one; 1 for the head anchors (fast 1, diffusion 1, dp3 2, paper 4).
    n_obs_steps: int = from_preset()
    # Number of past actions in the policy's input; 0 for none (fast 16, diffusion 8, dp3 0, paper 4).
    n_action_history_steps: int = from_preset()
    # Number of actions per chunk (fast 1, diffusion 4, dp3 4, paper 4).
    horizon: int = from_preset()
    # Number of actions executed before the next chunk (fast 1, diffusion 1, dp3 3, paper 2).
    n_action_steps: int = from_preset()

    # Number of points used of each cloud: the first ones, as clouds are in farthest-point order (fast 1024, diffusion
    # 512, dp3 1024, paper 4096).
    num_points: int = from_preset()
    # Encoder of clouds: mlp (DP3's PointNet) or pointnet2 (the paper's) (fast mlp, diffusion mlp, dp3 mlp, paper
    # pointnet2).
    encoder: str = from_preset()
    # Widths of the encoder's layers (mlp) or levels (pointnet2) (fast 64 128 192, diffusion 64 128 192, dp3 64 128
    # 256, paper 64 128 256 512).
    encoder_dims: tuple[int, ...] = from_preset()
    # Number of features of a cloud (fast 128, diffusion 128, dp3 64, paper 128).
    encoder_out_dim: int = from_preset()
    # Add points relative to the tool, and use positions of actions relative to it (fast True, diffusion True, dp3
    # False, paper False). Needs states and actions that are poses, with the names of this project's datasets.
    tcp_relative: bool = from_preset()
    # Proprioception: pose (tool pose and gripper) or full (joints too) (fast pose, diffusion pose, dp3 full,
    # paper full).
    proprioception: str = from_preset()
    # Use the external joint torques as an input.
    use_effort: bool = False

    # Use the instruction as an input, for one policy of several tasks.
    use_instruction: bool = False
    # Training only: weight rows so that all tasks have the same weight.
    balance_tasks: bool = False

    # Head anchors: use results of past actions as inputs: the undone motion, and the reached gripper opening.
    use_feedback: bool = True
    # Head anchors: number of anchors, typical motions of the demonstrations.
    num_anchors: int = 32
    # Head anchors: size of the memory of past actions.
    memory_dim: int = 64
    # Head anchors: width of the layers after cloud and memory.
    trunk_dim: int = 256
    # Head anchors: number of first points used to choose an anchor; refinement uses all points.
    coarse_points: int = 512
    # Head anchors: refinement steps of the pose that an open hand approaches; 0 for none.
    num_refinements: int = 3
    # Head anchors: number of nearest points used by a refinement step.
    refinement_points: int = 128
    # Head anchors, training only: size of a random subset of coarse_points.
    training_points: int = 320
    # Head anchors, training only: standard deviation of noise on points [m].
    point_noise_std: float = 0.002

    # Channels of the U-Net's levels; the chunk is halved between levels (fast 128 256, diffusion 128 256, dp3 512
    # 1024 2048, paper 256 512 1024).
    down_dims: tuple[int, ...] = from_preset()
    # Kernel of the U-Net's convolutions over time, odd (fast 3, diffusion 3, dp3 5, paper 5).
    kernel_size: int = from_preset()
    # Groups of the U-Net's group normalisation; must divide all down_dims.
    n_groups: int = 8
    # Size of the diffusion step's embedding (fast 64, diffusion 64, dp3 128, paper 256).
    diffusion_step_embed_dim: int = from_preset()
    # FiLM with scale: the condition scales and shifts features, instead of only shifting them.
    use_film_scale_modulation: bool = True
    # Recompute the U-Net's activations in the backward pass: less memory, more time.
    gradient_checkpointing: bool = False

    # Sampler: DDPM or DDIM (fast DDIM, diffusion DDIM, dp3 DDIM, paper DDPM).
    noise_scheduler_type: str = from_preset()
    # Diffusion steps in training.
    num_train_timesteps: int = 100
    # Denoising steps per chunk at run time (fast 10, diffusion 10, dp3 10, paper 100).
    num_inference_steps: int = from_preset()
    # Noise schedule, by its name in diffusers.
    beta_schedule: str = "squaredcos_cap_v2"
    # Target of the U-Net: epsilon (the noise) or sample (the clean action) (fast sample, diffusion sample, dp3 sample,
    # paper epsilon).
    prediction_type: str = from_preset()
    # Bound of an action while sampling, in normalised units, or in 0.15 m with tcp_relative (fast 6.0, diffusion
    # 6.0, dp3 1.0, paper 1.0).
    clip_sample_range: float = from_preset()

    # Exponent of the averaged weights' decay, which is 1 - (1 + n)^-ema_power at step n.
    ema_power: float = 0.75
    # Largest decay of the averaged weights.
    ema_max: float = 0.9999

    # Training only: largest shift of scenes along each axis [m] (fast 0.0, diffusion 0.03, dp3 0.0, paper 0.0).
    augmentation_translation: float = from_preset()
    # Training only: largest turn of scenes about the vertical [rad]; joint positions do not change (fast 0.0, diffusion
    # 0.1, dp3 0.0, paper 0.0).
    augmentation_yaw: float = from_preset()
    # Point on the vertical of augmentation_yaw: x, y, z [m], robot base frame.
    augmentation_center: tuple[float, float, float] = (0.55, 0.0, 0.0)
    # Training only: share of scenes mirrored left to right; joint positions and torques do not change. Not for objects
    # that always turn the same way, such as lids and portafilters.
    augmentation_mirror: float = 0.0
    # Training only: standard deviation of noise on past actions [normalised units] (fast 0.0, diffusion 0.02, dp3 0.0,
    # paper 0.0).
    history_noise_std: float = from_preset()

    # Normalisation of each kind of feature. Default: IDENTITY for the head anchors, else MIN_MAX of STATE and ACTION.
    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=dict)
    # Learning rate of AdamW (fast 0.001, diffusion 0.0005, dp3 0.0001, paper 0.0001).
    optimizer_lr: float = from_preset()
    # Weight decay of AdamW (fast 0.0001, diffusion 1e-06, dp3 1e-06, paper 1e-06).
    optimizer_weight_decay: float = from_preset()
    # Decay rates (betas) of AdamW's averages.
    optimizer_betas: tuple[float, float] = (0.95, 0.999)
    # Schedule of the learning rate, by its name in diffusers.
    scheduler_name: str = "cosine"
    # Warm-up steps to the full learning rate (fast 100, diffusion 100, dp3 500, paper 500).
    scheduler_warmup_steps: int = from_preset()

    def check(self) -> None:
        """Sets the preset's values; raises `AdaManipError` for options that do not fit together."""
        self._take_preset()
        for name, choices in CHOICES.items():
            require_choice(name, getattr(self, name), choices)
        self._check_sizes()
        self._check_horizon()
        self._check_mapping()

    def _take_preset(self) -> None:
        values = PRESETS[require_choice("preset", self.preset, PRESETS)]
        if self.values_from not in (None, self.preset):
            raise ConfigurationError(
                "A checkpoint's preset cannot be changed: its network has the sizes it was trained with.",
                got=f"preset={self.preset}, for values of {self.values_from}",
                allowed=f"preset={self.values_from}",
                hint=f"a new training with --policy.type=dp3_adaptive --policy.preset={self.preset}",
            )
        for name, value in values.items():
            if getattr(self, name) is None:
                setattr(self, name, value)
        self.values_from = self.preset
        if not self.normalization_mapping:
            mode = NormalizationMode.IDENTITY if self.head == "anchors" else NormalizationMode.MIN_MAX
            none = NormalizationMode.IDENTITY
            self.normalization_mapping = {"STATE": mode, "ENV": none, "VISUAL": none, "ACTION": mode}

    def _check_sizes(self) -> None:
        widths = tuple(self.down_dims)
        fits = widths and all(width > 0 and width % self.n_groups == 0 for width in widths) and self.kernel_size % 2
        fits = fits and all(getattr(self, name) >= 1 for name in (*ANCHOR_SIZES, "num_points"))
        fits = fits and self.num_refinements >= 0 and len(self.encoder_dims) > 0
        if not fits or not 1 <= self.num_inference_steps <= self.num_train_timesteps:
            raise self._error(
                "Sizes do not fit.",
                (*SIZES, *ANCHOR_SIZES, "num_refinements"),
                "down_dims that n_groups divides, an odd kernel_size, num_points >= 1, some encoder_dims, "
                f"{', '.join(ANCHOR_SIZES)} >= 1, num_refinements >= 0, "
                f"1 <= num_inference_steps <= num_train_timesteps={self.num_train_timesteps}",
                "--policy.preset=fast, and none of these",
            )
        if not 0.0 <= self.augmentation_mirror <= 1.0:
            hint = "--policy.augmentation_mirror=0.5"
            raise self._error("Not a share of scenes.", ("augmentation_mirror",), "0 to 1", hint)

    def _check_horizon(self) -> None:
        factor = 1 if self.head == "anchors" else 2 ** (len(self.down_dims) - 1)
        fits = self.horizon % factor == 0 and 1 <= self.n_action_steps <= self.horizon
        if not fits or self.n_action_history_steps < 0 or self.n_obs_steps < 1:
            raise self._error(
                "Horizons do not fit.",
                HORIZONS,
                f"horizon a multiple of {factor}, 1 <= n_action_steps <= horizon, "
                "n_obs_steps >= 1, n_action_history_steps >= 0",
                "--policy.horizon=4 --policy.n_action_steps=1",
            )
        if self.head == "anchors" and (self.n_obs_steps, self.horizon) != (1, 1):
            raise self._error(
                "The head anchors uses one cloud and draws one action.",
                ("n_obs_steps", "horizon"),
                "n_obs_steps=1, horizon=1; n_action_history_steps sets the length of the history",
                "--policy.preset=diffusion",
            )

    def _check_mapping(self) -> None:
        """Checks that STATE and ACTION have the one normalisation under which poses can be related to clouds."""
        modes = [self.normalization_mapping.get(kind) for kind in ("STATE", "ACTION")]
        anchors = self.head == "anchors"
        wanted = NormalizationMode.IDENTITY if anchors else NormalizationMode.MIN_MAX
        if (anchors or self.tcp_relative) and any(mode is not wanted for mode in modes):
            raise ConfigurationError(
                f"{'The head anchors' if anchors else 'tcp_relative'} does not work with this normalisation.",
                got=", ".join(map(str, modes)),
                allowed=f"{wanted.name} for STATE and for ACTION",
                hint="--policy.preset=diffusion --policy.tcp_relative=false",
            )

    def _error(self, what: str, names: tuple[str, ...], allowed: str, hint: str) -> ConfigurationError:
        got = ", ".join(f"{name}={getattr(self, name)}" for name in names)
        return ConfigurationError(what, got=got, allowed=allowed, hint=hint)

    @property
    def observation_delta_indices(self) -> list[int] | None:
        """Observation steps relative to the present; None for the present only, which LeRobot reads fastest."""
        return list(range(1 - self.n_obs_steps, 1)) if self.n_obs_steps > 1 else None

    @property
    def observed_steps(self) -> int:
        """Observation steps kept at run time; the head anchors also needs the poses before past actions."""
        return max(self.n_obs_steps, 1 + self.n_action_history_steps if self.head == "anchors" else 1)

    def validate_features(self) -> None:
        """Keeps cloud, state and, with ``use_effort``, effort as inputs; see `CloudPolicyConfig.keep_inputs`."""
        self.keep_inputs(POINT_CLOUD, STATE, *([EFFORT] if self.use_effort else []))

    @property
    def state_dim(self) -> int:
        """Number of state values that the policy uses."""
        return ACTION_DIM if self.proprioception == "pose" and self.has_pose_layout else self.feature_size(STATE)

    def feature_size(self, key: str) -> int:
        """Returns the size of an input."""
        return int((self.input_features or {})[key].shape[0])

    def get_optimizer_preset(self) -> FusedAdamWConfig:
        """Returns AdamW."""
        decay, betas = self.optimizer_weight_decay, self.optimizer_betas
        return FusedAdamWConfig(lr=self.optimizer_lr, betas=betas, weight_decay=decay)

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Returns a schedule with warm-up."""
        return DiffuserSchedulerConfig(name=self.scheduler_name, num_warmup_steps=self.scheduler_warmup_steps)
