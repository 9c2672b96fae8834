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
from lerobot_policy_adamanip.dp3_adaptive.presets import CHOICES, COUNTS, FIXED, OPTIONS, PRESETS

SHARES = ("augmentation_mirror", "failed_below", "min_probability")
SIZES = (*COUNTS, "down_dims", "n_groups", "kernel_size", "encoder_dims", "num_refinements")
HORIZONS = ("horizon", "n_action_steps", "n_obs_steps", "n_action_history_steps", "down_dims")


def from_preset() -> Any:
    """Returns a field that is None until `DP3AdaptiveConfig.check` sets it from the preset."""
    return field(default=None)


@PreTrainedConfig.register_subclass("dp3_adaptive")
@dataclass
class DP3AdaptiveConfig(CloudPolicyConfig):
    """Options of ``dp3_adaptive``. Command-line options override the preset; a checkpoint saves the final values.

    The comment above a field is its help in ``lerobot-train --policy.type=dp3_adaptive --help``.
    """

    # Preset, the defaults of the options below: fast or diffusion (for two CPU cores), dp3 or paper (as published).
    preset: str = "fast"
    # Set automatically: the preset that the saved values come from.
    values_from: str | None = None
    # Not used: checkpoints before 0.3 have it and are refused.
    tcp_relative: bool | None = None

    # Set by the preset, not to be changed: what draws actions, anchors (typical motions, refined) or diffusion, the
    # paper's (fast anchors, diffusion diffusion, dp3 diffusion, paper diffusion).
    head: str = from_preset()
    # Set by the preset, not to be changed: the frame of clouds and actions, the tool's or the robot's base (fast tool,
    # diffusion tool, dp3 base, paper base).
    frame: str = from_preset()
    # Observed steps, including the present one; 1 in the tool's frame (fast 1, diffusion 1, dp3 2, paper 4).
    n_obs_steps: int = from_preset()
    # Number of past actions in the policy's input; 0 for none (fast 16, diffusion 16, dp3 0, paper 4).
    n_action_history_steps: int = from_preset()
    # Number of actions per chunk (fast 1, diffusion 4, dp3 4, paper 4).
    horizon: int = from_preset()
    # Number of actions executed before the next chunk (fast 1, diffusion 1, dp3 3, paper 2).
    n_action_steps: int = from_preset()
    # Number of points used of each cloud: the first ones, as clouds are in farthest-point order (fast 1024, diffusion
    # 1024, dp3 1024, paper 4096).
    num_points: int = from_preset()
    # Encoder of clouds: mlp (DP3's PointNet) or pointnet2 (the paper's) (fast mlp, diffusion mlp, dp3 mlp, paper
    # pointnet2).
    encoder: str = from_preset()
    # Widths of the encoder's layers (mlp) or levels (pointnet2) (fast 64 128 192, diffusion 64 128 192, dp3 64 128 256,
    # paper 64 128 256 512).
    encoder_dims: tuple[int, ...] = from_preset()
    # Number of features of a cloud (fast 128, diffusion 128, dp3 64, paper 128).
    encoder_out_dim: int = from_preset()
    # Proprioception: pose (tool pose and gripper) or full (joints too) (dp3 full, paper full).
    proprioception: str = from_preset()
    # Use the external joint torques as an input.
    use_effort: bool = False
    # Use the instruction as an input, for one policy of several tasks.
    use_instruction: bool = False
    # Training only: weight rows so that all tasks have the same weight.
    balance_tasks: bool = False
    # Use results of past actions as inputs: the undone motion, and the reached gripper opening (fast True, diffusion
    # True).
    use_feedback: bool = from_preset()
    # Size of the memory of contact events (fast 64, diffusion 64).
    memory_dim: int = from_preset()
    # Do not repeat a failed motion until something has moved, nor undo a step untried (fast True, diffusion True).
    avoid_repeats: bool = from_preset()
    # A motion has failed if the arm did less than this share of it (fast 0.25, diffusion 0.25).
    failed_below: float = from_preset()
    # Number of draws of an action, while the drawn one leads to nothing: an approach without anything to hold at its
    # end, a motion that was never shown with such a hand, or (diffusion) a repeated failure (fast 4, diffusion 8).
    num_draws: int = from_preset()
    # Least probability of an anchor; less probable ones are not drawn (fast 0.03).
    min_probability: float = from_preset()
    # Number of anchors, typical motions of the demonstrations. The head diffusion uses them to know which poses to
    # refine (fast 32, diffusion 32).
    num_anchors: int = from_preset()
    # Width of the layers after the cloud (fast 256).
    trunk_dim: int = from_preset()
    # Number of first points used to choose a motion; refinement uses all points (fast 512, diffusion 512).
    coarse_points: int = from_preset()
    # Refinement steps of the pose that an open hand approaches; 0 for none (fast 3, diffusion 3).
    num_refinements: int = from_preset()
    # Number of nearest points used by a refinement step (fast 128, diffusion 128).
    refinement_points: int = from_preset()
    # Largest shift by refinement; a pose that would shift further has nothing to hold [m] (fast 0.1, diffusion 0.1).
    refinement_reach: float = from_preset()
    # Approaches are refined if the end points of their kind spread by more [m] (fast 0.006, diffusion 0.006).
    refinement_spread: float = from_preset()
    # Training only: size of a random subset of coarse_points (fast 320, diffusion 320).
    training_points: int = from_preset()
    # Training only: standard deviation of noise on points [m] (fast 0.002, diffusion 0.002).
    point_noise_std: float = from_preset()
    # Channels of the U-Net's levels; the chunk is halved between levels (diffusion 128 256, dp3 512 1024 2048, paper
    # 256 512 1024).
    down_dims: tuple[int, ...] | None = from_preset()
    # Kernel of the U-Net's convolutions over time, odd (diffusion 3, dp3 5, paper 5).
    kernel_size: int = from_preset()
    # Groups of the U-Net's group normalisation; must divide all down_dims (diffusion 8, dp3 8, paper 8).
    n_groups: int = from_preset()
    # Size of the diffusion step's embedding (diffusion 64, dp3 128, paper 256).
    diffusion_step_embed_dim: int = from_preset()
    # FiLM with scale: the condition scales and shifts features, instead of only shifting them (diffusion True, dp3
    # True, paper True).
    use_film_scale_modulation: bool = from_preset()
    # Recompute the U-Net's activations in the backward pass: less memory, more time (diffusion False, dp3 False, paper
    # False).
    gradient_checkpointing: bool = from_preset()
    # Sampler: DDPM or DDIM (diffusion DDIM, dp3 DDIM, paper DDPM).
    noise_scheduler_type: str = from_preset()
    # Diffusion steps in training (diffusion 100, dp3 100, paper 100).
    num_train_timesteps: int = from_preset()
    # Denoising steps per chunk at run time (diffusion 10, dp3 10, paper 100).
    num_inference_steps: int = from_preset()
    # Noise schedule, by its name in diffusers (diffusion squaredcos_cap_v2, dp3 squaredcos_cap_v2, paper
    # squaredcos_cap_v2).
    beta_schedule: str = from_preset()
    # Target of the U-Net: epsilon (the noise) or sample (the clean action) (diffusion sample, dp3 sample, paper
    # epsilon).
    prediction_type: str = from_preset()
    # Bound of an action while sampling, in units of the denoised values (diffusion 4.0, dp3 1.0, paper 1.0).
    clip_sample_range: float = from_preset()
    # Exponent of the averaged weights' decay, which is 1 - (1 + n)^-ema_power at step n.
    ema_power: float = 0.75
    # Largest decay of the averaged weights.
    ema_max: float = 0.9999
    # Training only: largest shift of scenes along each axis [m] (dp3 0.0, paper 0.0).
    augmentation_translation: float = from_preset()
    # Training only: largest turn of scenes about the vertical [rad]; joint positions do not change (dp3 0.0, paper
    # 0.0).
    augmentation_yaw: float = from_preset()
    # Point on the vertical of augmentation_yaw: x, y, z [m], robot base frame (dp3 0.55 0.0 0.0, paper 0.55 0.0 0.0).
    augmentation_center: tuple[float, float, float] | None = from_preset()
    # Training only: share of scenes mirrored left to right; joint positions and torques do not change. Not for objects
    # that always turn the same way, such as lids and portafilters.
    augmentation_mirror: float = 0.0
    # Training only: standard deviation of noise on past actions [normalised units] (dp3 0.0, paper 0.0).
    history_noise_std: float = from_preset()
    # Normalisation of each kind of feature. Default: IDENTITY in the tool's frame, else MIN_MAX of STATE and ACTION.
    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=dict)
    # Learning rate of AdamW (fast 0.001, diffusion 0.001, dp3 0.0001, paper 0.0001).
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
        if self.tcp_relative is not None:
            what = "This is an option or a checkpoint of a version before 0.3, whose networks differ."
            hint = "train again with this version, or use the commit that the checkpoint's card names"
            raise self._error(what, ("tcp_relative",), "checkpoints that this version has trained", hint)
        self._take_preset()
        for name, choices in CHOICES.items():
            if self.uses(name):
                require_choice(name, getattr(self, name), choices)
        self._check_sizes()
        self._check_horizon()
        self._check_mapping()

    def uses(self, name: str) -> bool:
        """Returns whether the preset uses an option of `OPTIONS`."""
        return name in PRESETS[self.preset]

    def _take_preset(self) -> None:
        values = PRESETS[require_choice("preset", self.preset, PRESETS)]
        if self.values_from not in (None, self.preset):
            raise ConfigurationError(
                "A checkpoint's preset cannot be changed: its network has the sizes it was trained with.",
                got=f"preset={self.preset}, for values of {self.values_from}",
                allowed=f"preset={self.values_from}",
                hint=f"a new training with --policy.type=dp3_adaptive --policy.preset={self.preset}",
            )
        for name in OPTIONS:
            given = getattr(self, name)
            if given is not None and (name not in values or (name in FIXED and given != values[name])):
                raise self._foreign(name, given)
            if given is None:
                setattr(self, name, values.get(name))
        self.values_from = self.preset
        if not self.normalization_mapping:
            mode = NormalizationMode.IDENTITY if self.frame == "tool" else NormalizationMode.MIN_MAX
            none = NormalizationMode.IDENTITY
            self.normalization_mapping = {"STATE": mode, "ENV": none, "VISUAL": none, "ACTION": mode}

    def _foreign(self, name: str, given: Any) -> ConfigurationError:
        """Returns the error for an option or value of another preset."""
        others = [each for each, used in PRESETS.items() if name in used and (name not in FIXED or used[name] == given)]
        others = others or [self.preset]
        return self._error(
            f"The preset {self.preset} does not use this option or value.",
            (name,),
            f"{name} with preset={' or '.join(others)}",
            f"--policy.preset={others[0]}, or without --policy.{name}",
        )

    def _check_sizes(self) -> None:
        fits = all(getattr(self, name) >= 1 for name in COUNTS if self.uses(name)) and len(self.encoder_dims) > 0
        fits = fits and (self.num_refinements or 0) >= 0
        if self.head == "diffusion":
            widths = tuple(self.down_dims or ())
            fits = fits and all(width > 0 and width % self.n_groups == 0 for width in widths) and len(widths) > 0
            fits = fits and self.kernel_size % 2 == 1 and self.num_inference_steps <= self.num_train_timesteps
        if not fits:
            raise self._error(
                "Sizes do not fit.",
                tuple(name for name in SIZES if self.uses(name)),
                f"down_dims that n_groups divides, an odd kernel_size, some encoder_dims, {', '.join(COUNTS)} >= 1, "
                f"num_refinements >= 0, num_inference_steps <= num_train_timesteps={self.num_train_timesteps}",
                f"--policy.preset={self.preset}, and none of these",
            )
        shares = tuple(name for name in SHARES if not 0.0 <= (getattr(self, name) or 0.0) <= 1.0)
        if shares:
            raise self._error("Not a share.", shares, "0 to 1", f"--policy.{shares[0]}=0.5")

    def _check_horizon(self) -> None:
        factor = 2 ** (len(self.down_dims or ()) - 1) if self.head == "diffusion" else 1
        fits = self.horizon % factor == 0 and 1 <= self.n_action_steps <= self.horizon
        if not fits or self.n_action_history_steps < 0 or self.n_obs_steps < 1:
            raise self._error(
                "Horizons do not fit.",
                tuple(name for name in HORIZONS if self.uses(name)),
                f"horizon a multiple of {factor}, 1 <= n_action_steps <= horizon, "
                "n_obs_steps >= 1, n_action_history_steps >= 0",
                "--policy.horizon=4 --policy.n_action_steps=1",
            )
        if self.frame == "tool" and (self.n_obs_steps != 1 or (self.head == "anchors" and self.horizon != 1)):
            raise self._error(
                "The tool's frame uses one cloud, and the head anchors draws one action.",
                ("n_obs_steps", "horizon"),
                "n_obs_steps=1, and horizon=1 for anchors; n_action_history_steps sets the length of the history",
                "--policy.preset=dp3",
            )

    def _check_mapping(self) -> None:
        """Checks that poses stay in metres where they are related to clouds."""
        modes = [self.normalization_mapping.get(kind) for kind in ("STATE", "ACTION")]
        if self.frame == "tool" and any(mode is not NormalizationMode.IDENTITY for mode in modes):
            raise ConfigurationError(
                "The tool's frame does not work with this normalisation.",
                got=", ".join(map(str, modes)),
                allowed="IDENTITY for STATE and for ACTION",
                hint="without --policy.normalization_mapping, or --policy.preset=dp3",
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
        """Observation steps kept at run time; the tool's frame also needs the poses before past actions."""
        return 1 + self.n_action_history_steps if self.frame == "tool" else self.n_obs_steps

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
