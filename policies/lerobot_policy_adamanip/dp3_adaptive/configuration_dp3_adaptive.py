"""Configuration of ``dp3_adaptive``: a policy over point clouds with a history of its own actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import NormalizationMode
from lerobot.optim.schedulers import DiffuserSchedulerConfig

from lerobot_adamanip.contract.control import DENSE, KEYFRAME
from lerobot_adamanip.contract.schema import EFFORT, POINT_CLOUD, STATE
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_policy_adamanip.common.config import MEMORY_KINDS, CloudPolicyConfig, FusedAdamWConfig

TRAIN_TIMESTEPS = 100
"""Diffusion steps in training."""
UNET_GROUPS = 8
"""Groups of the U-Net's group normalisation."""


@dataclass(frozen=True)
class HeadMethod:
    """Fixed parts of a preset, which no option changes.

    Attributes:
        head: network that draws actions: ``truncated`` (diffusion from anchors, typical motions) or ``diffusion`` (of
            whole chunks by a U-Net, the paper's).
        frame: frame of clouds and actions: ``tool``, without normalisation, or ``base``, the robot's.
        encoder: ``mlp`` (DP3's PointNet) or ``pointnet2`` (the paper's).
        weight_decay: weight decay of AdamW.
        prediction_type: target of the U-Net, ``epsilon`` (the noise) or ``sample`` (the clean action).
        step_embed_dim: size of the diffusion step's embedding.
        control: of the data and environments, see `contract.control.CONTROLS`; None for any.
    """

    head: str
    frame: str
    encoder: str = "mlp"
    weight_decay: float = 1e-6
    prediction_type: str = "sample"
    step_embed_dim: int = 64
    control: str | None = KEYFRAME

    @property
    def has_anchors(self) -> bool:
        """Whether actions are drawn around typical motions, and refined."""
        return self.head == "truncated"


METHODS = {
    "keyframe": HeadMethod("truncated", "tool", weight_decay=1e-4),
    "dense": HeadMethod("diffusion", "tool", control=DENSE),
    "dp3": HeadMethod("diffusion", "base", step_embed_dim=128, control=None),
    "paper": HeadMethod("diffusion", "base", "pointnet2", prediction_type="epsilon", step_embed_dim=256, control=None),
}
"""``keyframe``: the paper's method with this project's truncated diffusion, tool frame, memory of contact events and
refinement. ``dense``: the paper's diffusion at control rate, in longer chunks, in the tool's frame. Its memory merges
steps into strokes, and it has no refinement.

``dp3``: 3D Diffusion Policy (Ze et al. 2024) with the values of its release, without an action history.
``--policy.down_dims='[128,256,384]'`` gives the widths of the release's Simple DP3, which a CPU can train; LeRobot's
U-Net has twice its residual blocks. What else differs from the release: docs/differences.md.
``paper``: the paper's table of parameters, except for ``--batch_size=64``. Values missing in the table are those of the
paper's code.
"""
TOOL: dict[str, Any] = {
    "num_points": 1024, "encoder_dims": (64, 128, 192), "encoder_out_dim": 128,
    "coarse_points": 512, "training_points": 320,
    "n_obs_steps": 1, "n_action_history_steps": 16, "n_action_steps": 1, "memory_dim": 64, "memory_kind": "events",
    "use_feedback": True,
    "num_anchors": 32, "num_refinements": 3, "refinement_points": 128, "optimizer_lr": 1e-3,
    "scheduler_warmup_steps": 100,
}  # fmt: skip
"""Options of the heads in the tool's frame for key frames, at a size for two CPU cores."""
OF_KEY_FRAMES = {"num_anchors", "num_refinements", "refinement_points"}
"""Those of them that are not used at control rate."""
PRESETS: dict[str, dict[str, Any]] = {
    "keyframe": {**TOOL, "horizon": 1, "trunk_dim": 256, "num_inference_steps": 2},
    "dense": {
        **{name: value for name, value in TOOL.items() if name not in OF_KEY_FRAMES},
        "n_action_history_steps": 32, "horizon": 16, "n_action_steps": 8,
        "down_dims": (128, 256), "noise_scheduler_type": "DDIM", "num_inference_steps": 10,
    },
    "dp3": {
        "num_points": 1024, "encoder_dims": (64, 128, 256), "encoder_out_dim": 64,
        "n_obs_steps": 2, "n_action_history_steps": 0, "horizon": 4, "n_action_steps": 3,
        "down_dims": (512, 1024, 2048), "noise_scheduler_type": "DDIM", "num_inference_steps": 10,
        "optimizer_lr": 1e-4, "scheduler_warmup_steps": 500,
    },
    "paper": {
        "num_points": 4096, "encoder_dims": (64, 128, 256, 512), "encoder_out_dim": 128,
        "n_obs_steps": 4, "n_action_history_steps": 4, "horizon": 4, "n_action_steps": 2,
        "down_dims": (256, 512, 1024), "noise_scheduler_type": "DDPM", "num_inference_steps": 100,
        "optimizer_lr": 1e-4, "scheduler_warmup_steps": 500,
    },
}  # fmt: skip
"""Preset -> the default of each option that it uses; it refuses the others' options."""
OPTIONS = {name for preset in PRESETS.values() for name in preset}
"""Options whose default is the preset's."""
COUNTS = (
    "num_points", "num_anchors", "memory_dim", "trunk_dim", "training_points", "coarse_points", "refinement_points",
    "num_inference_steps", "encoder_out_dim",
)  # fmt: skip
"""Options that are at least 1."""
SIZES = (*COUNTS, "down_dims", "encoder_dims", "num_refinements")
HORIZONS = ("horizon", "n_action_steps", "n_obs_steps", "n_action_history_steps", "down_dims")


FREE = {
    "inference", "n_action_steps", "memory_episodes", "num_refinements", "noise_scheduler_type",
    "num_inference_steps", "training_points", "augmentation_mirror",
    "augmentation_earlier_episodes", "optimizer_lr", "scheduler_warmup_steps",
}  # fmt: skip
"""Options of training, and of draws at run time, see `CloudPolicyConfig.FREE_OPTIONS`."""


@dataclass
class Inference:
    """Memory and sampling at inference. They do not change training. Presets dp3 and paper use none."""

    # Use the learned memory of contact events.
    memory: bool = True
    # Number of the latest contact events that the memory reads; 0 for all.
    latest_events: int = 0
    # Divides the scores of the anchors before one is drawn: below 1, unlikely motions are drawn less often.
    temperature: float = 0.25
    # Do not draw a motion that has failed, until something has moved: a rule written by hand, the memory's baseline.
    no_repeat: bool = False


def from_preset() -> Any:
    """Returns a field that is None until `DP3AdaptiveConfig.check` sets it from the preset."""
    return field(default=None)


@PreTrainedConfig.register_subclass("dp3_adaptive")
@dataclass
class DP3AdaptiveConfig(CloudPolicyConfig):
    """Options of ``dp3_adaptive``. Command-line options override the preset; a checkpoint saves the final values.

    The comment above a field is its help in ``lerobot-train --policy.type=dp3_adaptive --help``.
    """

    FREE_OPTIONS: ClassVar[frozenset[str]] = CloudPolicyConfig.FREE_OPTIONS | FREE

    # Preset, the defaults of the options below. For key frames: keyframe. For control rate: dense. Both are of a size
    # for two CPU cores. For either: dp3 or paper (as published).
    preset: str = "keyframe"
    # Set automatically: the preset that the saved values come from.
    values_from: str | None = None
    # Memory and sampling at inference (keyframe; dense has the memory alone).
    inference: Inference = field(default_factory=Inference)

    # Observed steps, including the present one; 1 in the tool's frame (keyframe 1, dense 1, dp3 2, paper 4).
    n_obs_steps: int = from_preset()
    # Number of past actions in the policy's input, in dense of past strokes; 0 for none (keyframe 16, dense
    # 32, dp3 0, paper 4).
    n_action_history_steps: int = from_preset()
    # Number of actions per chunk (keyframe 1, dense 16, dp3 4, paper 4).
    horizon: int = from_preset()
    # Number of actions executed before the next chunk (keyframe 1, dense 8, dp3 3, paper 2).
    n_action_steps: int = from_preset()
    # Number of points used of each cloud: the first ones, as clouds are in farthest-point order (keyframe 1024, dense
    # 1024, dp3 1024, paper 4096).
    num_points: int = from_preset()
    # Widths of the encoder's layers (mlp) or levels (paper) (keyframe 64 128 192, dense 64 128 192,
    # dp3 64 128 256, paper 64 128 256 512).
    encoder_dims: tuple[int, ...] = from_preset()
    # Number of features of a cloud (keyframe 128, dense 128, dp3 64, paper 128).
    encoder_out_dim: int = from_preset()
    # Use the external joint torques as an input.
    use_effort: bool = False
    # Use the instruction as an input, for one policy of several tasks.
    use_instruction: bool = False
    # Use results of past actions as inputs: the undone motion, and the reached gripper opening (keyframe True, dense
    # True).
    use_feedback: bool = from_preset()
    # Run time only: episodes in a row that share the history of actions, as --env.repeats=K plays one scene K times.
    # Train with augmentation_earlier_episodes.
    memory_episodes: int = 1
    # Size of the memory (keyframe 64, dense 64).
    memory_dim: int = from_preset()
    # What the memory reads, to compare kinds of memory: events (contact events), window (each past key frame), or code
    # (each of them, by a code that learns only to reconstruct them) (keyframe events, dense events).
    memory_kind: str = from_preset()
    # Number of anchors, typical motions of the demonstrations, around which actions are denoised (keyframe 32).
    num_anchors: int = from_preset()
    # Width of the layers after the cloud (keyframe 256).
    trunk_dim: int = from_preset()
    # Number of first points used to choose a motion; refinement uses all points (keyframe 512, dense 512).
    coarse_points: int = from_preset()
    # Training only: size of a random subset of coarse_points (keyframe 320, dense 320).
    training_points: int = from_preset()
    # Refinement steps of the pose that an open hand approaches; 0 for none (keyframe 3).
    num_refinements: int = from_preset()
    # Number of nearest points used by a refinement step (keyframe 128).
    refinement_points: int = from_preset()
    # Channels of the U-Net's levels; the chunk is halved between levels (dense 128 256, dp3 512 1024 2048, paper 256
    # 512 1024).
    down_dims: tuple[int, ...] | None = from_preset()
    # Sampler: DDPM or DDIM (dense DDIM, dp3 DDIM, paper DDPM).
    noise_scheduler_type: str = from_preset()
    # Denoising steps per chunk at run time, at most 100 (keyframe 2, dense 10, dp3 10, paper 100).
    num_inference_steps: int = from_preset()
    # Training only, its held-out loss included: share of scenes mirrored left to right; joint positions and torques do
    # not change. Not for objects that always turn the same way, such as lids and portafilters. Needs poses.
    augmentation_mirror: float = 0.0
    # Training only: share of rows that also remember the end of another episode with the same hidden values, for
    # memory_episodes. Needs simulated key frames, and the preset keyframe.
    augmentation_earlier_episodes: float = 0.0
    # Learning rate of AdamW (keyframe 0.001, dense 0.001, dp3 0.0001, paper 0.0001).
    optimizer_lr: float = from_preset()
    # Warm-up steps to the full learning rate (keyframe 100, dense 100, dp3 500, paper 500).
    scheduler_warmup_steps: int = from_preset()

    def check(self) -> None:
        """Sets the preset's values; raises `AdaManipError` for options that do not fit together."""
        self._take_preset()
        if self.method.head == "diffusion":
            require_choice("noise_scheduler_type", self.noise_scheduler_type, ("DDPM", "DDIM"))
        self._check_sizes()
        self._check_horizon()
        self._check_history()

    def changed_options(self, trained: CloudPolicyConfig) -> dict[str, tuple[Any, Any]]:
        """Returns options as `CloudPolicyConfig.changed_options`; a policy may act without its memory."""
        changed = super().changed_options(trained)
        return {name: values for name, values in changed.items() if (name, values[0]) != ("n_action_history_steps", 0)}

    @property
    def method(self) -> HeadMethod:
        """Fixed parts of the preset."""
        return METHODS[self.preset]

    @property
    def control(self) -> str | None:
        """Control that the preset is for; None for any."""
        return self.method.control

    @property
    def normalization_mapping(self) -> dict[str, NormalizationMode]:
        """In the robot's base frame states and actions are normalised, but not clouds."""
        scaled = {} if self.method.frame == "tool" else dict.fromkeys(("STATE", "ACTION"), NormalizationMode.MIN_MAX)
        return {**super().normalization_mapping, **scaled}

    def _take_preset(self) -> None:
        values = PRESETS[require_choice("preset", self.preset, PRESETS)]
        if self.values_from not in (None, self.preset):
            raise ConfigurationError(
                "A checkpoint's preset cannot be changed: its network has the sizes it was trained with.",
                got=f"preset={self.preset}, for values of {self.values_from}",
                allowed=f"preset={self.values_from}",
                hint=f"a new training with --policy.type=dp3_adaptive --policy.preset={self.preset}",
            )
        foreign = [name for name in OPTIONS - values.keys() if getattr(self, name) is not None]
        if self._has_unused_inference():
            foreign.append("inference")
        for name in foreign:
            others = [preset for preset in PRESETS if name in PRESETS[preset]] or ["keyframe"]
            raise self._error(
                f"The preset {self.preset} does not use this option.",
                (name,),
                f"{name} with preset={' or '.join(others)}",
                f"--policy.preset={others[0]}, or without --policy.{name}",
            )
        for name in OPTIONS:
            if getattr(self, name) is None:
                setattr(self, name, values.get(name))
        self.values_from = self.preset

    def _has_unused_inference(self) -> bool:
        """Whether ``inference`` switches what this preset does not have."""
        used = self.inference if self.method.frame == "base" else replace(self.inference, memory=True, latest_events=0)
        return used != Inference() and not self.method.has_anchors

    def _check_sizes(self) -> None:
        fits = all(getattr(self, name) >= 1 for name in COUNTS if name in PRESETS[self.preset])
        fits = fits and min(self.encoder_dims, default=0) >= 1 and (self.num_refinements or 0) >= 0
        fits = fits and self.num_inference_steps <= TRAIN_TIMESTEPS
        if self.method.head == "diffusion":
            widths = tuple(self.down_dims or ())
            fits = fits and all(width > 0 and width % UNET_GROUPS == 0 for width in widths) and len(widths) > 0
        if not fits:
            raise self._error(
                "Sizes do not fit.",
                [name for name in SIZES if name in PRESETS[self.preset]],
                f"down_dims that {UNET_GROUPS} divides, encoder_dims and {', '.join(COUNTS)} >= 1, "
                f"num_refinements >= 0, num_inference_steps <= {TRAIN_TIMESTEPS}",
                f"--policy.preset={self.preset}, and none of these",
            )
        if self.memory_kind is not None:
            require_choice("kind of memory", self.memory_kind, MEMORY_KINDS, hint="--policy.memory_kind=events")
        if not self.inference.temperature > 0.0:
            raise self._error(
                "Not a temperature.", ["inference"], "a number above 0", "--policy.inference.temperature=0.25"
            )
        if self.inference.latest_events < 0:
            raise self._error(
                "Not a number of events.",
                ["inference"],
                "0 for all, or 1 or more",
                "--policy.inference.latest_events=1",
            )
        for name in ("augmentation_mirror", "augmentation_earlier_episodes"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise self._error("Not a share.", [name], "0 to 1", f"--policy.{name}=0.5")

    def _check_history(self) -> None:
        remembers = self.method.has_anchors and self.n_action_history_steps > 0
        if self.memory_episodes < 1 or (self.memory_episodes > 1 and not remembers):
            allowed = "1 or more; 1 without a history of actions, and with other presets than keyframe"
            raise self._error("Not a number of episodes.", ["memory_episodes"], allowed, "--policy.memory_episodes=3")
        if self.augmentation_earlier_episodes and not self.method.has_anchors:
            allowed, name = "0 with other presets than keyframe", "augmentation_earlier_episodes"
            raise self._error("No memory over episodes is trained.", [name], allowed, f"--policy.{name}=0")
        if self.inference.no_repeat and not self.n_action_history_steps:
            raise self._error(
                "inference.no_repeat reads the history of actions, which this policy does not have.",
                ["n_action_history_steps"],
                "1 or more in training and evaluation",
                "without --policy.inference.no_repeat",
            )

    def _check_horizon(self) -> None:
        factor = 2 ** (len(self.down_dims or ()) - 1) if self.method.head == "diffusion" else 1
        fits = self.horizon % factor == 0 and 1 <= self.n_action_steps <= self.horizon
        if not fits or self.n_action_history_steps < 0 or self.n_obs_steps < 1:
            raise self._error(
                "Horizons do not fit.",
                [name for name in HORIZONS if name in PRESETS[self.preset]],
                f"horizon a multiple of {factor}, 1 <= n_action_steps <= horizon, "
                "n_obs_steps >= 1, n_action_history_steps >= 0",
                "--policy.horizon=4 --policy.n_action_steps=1",
            )
        one_action = self.method.head == "truncated"
        if self.method.frame == "tool" and (self.n_obs_steps != 1 or (one_action and self.horizon != 1)):
            raise self._error(
                "The tool's frame uses one cloud, and the preset keyframe draws one action.",
                ("n_obs_steps", "horizon"),
                "n_obs_steps=1, and horizon=1 for keyframe; n_action_history_steps sets the length of the history",
                "--policy.preset=dp3",
            )

    def _error(self, what: str, names: Sequence[str], allowed: str, hint: str) -> ConfigurationError:
        got = ", ".join(f"{name}={getattr(self, name)}" for name in names)
        return ConfigurationError(what, got=got, allowed=allowed, hint=hint)

    @property
    def observation_delta_indices(self) -> list[int] | None:
        """Observation steps relative to the present; None for the present only, which LeRobot reads fastest."""
        return list(range(1 - self.n_obs_steps, 1)) if self.n_obs_steps > 1 else None

    def validate_features(self) -> None:
        """Keeps cloud, state and, with ``use_effort``, effort as inputs; see `CloudPolicyConfig.keep_inputs`."""
        self.keep_inputs(POINT_CLOUD, STATE, *([EFFORT] if self.use_effort else []))

    def feature_size(self, key: str) -> int:
        """Returns the size of an input."""
        return int((self.input_features or {})[key].shape[0])

    def get_optimizer_preset(self) -> FusedAdamWConfig:
        """Returns AdamW."""
        return FusedAdamWConfig(lr=self.optimizer_lr, betas=(0.95, 0.999), weight_decay=self.method.weight_decay)

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Returns a cosine schedule with warm-up."""
        return DiffuserSchedulerConfig(name="cosine", num_warmup_steps=self.scheduler_warmup_steps)
