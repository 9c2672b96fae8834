"""The diffusion heads: LeRobot's conditional U-Net denoises a chunk of actions (paper, section 4.2 and eq. 2).

`BaseDiffusionHead` is the paper's and DP3's, in the robot's base frame. `MemoryDiffusionHead` works in the tool's frame
with contact events, for control rate.
"""

from __future__ import annotations

from types import SimpleNamespace

import torch
import torch.nn.functional as F
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from lerobot.policies.diffusion.modeling_diffusion import DiffusionConditionalUnet1d
from torch import Tensor, nn

from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import (
    ACTION_DIM,
    EFFORT,
    GRIPPER_DIM,
    POINT_CLOUD,
    POSITION_DIMS,
    ROTATION_DIMS,
    STATE,
    Statistics,
)
from lerobot_policy_adamanip.common import geometry
from lerobot_policy_adamanip.common.contacts import ContactMemory, MotionCode, make_memory
from lerobot_policy_adamanip.common.encoders import PointNet2Encoder, PointNetEncoder
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import (
    TRAIN_TIMESTEPS,
    UNET_GROUPS,
    DP3AdaptiveConfig,
)
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, instruction_dim
from lerobot_policy_adamanip.dp3_adaptive.truncated import POINT_DIM, ToolHead

BODY_RANGE = 3.0
"""Bound of normalised proprioception; demonstrations are within 1."""
POSITION_UNIT, ROTATION_UNIT = 0.02, 0.5
"""Units of a denoised pose: positions are scaled by asinh, so that an error is small relative to the motion [m]."""


class DiffusionHead(nn.Module):
    """Denoises chunks of actions. Subclasses define the encoding of a chunk and the condition.

    Args:
        config: configuration of the policy.
        point_dim: number of features of a point.
        condition_dim: number of values of the condition.
        kernel_size: kernel size of the U-Net's convolutions over time, odd.
        clip: bound of a denoised value while sampling.
    """

    def __init__(
        self, config: DP3AdaptiveConfig, point_dim: int, condition_dim: int, *, kernel_size: int, clip: float
    ) -> None:
        super().__init__()
        self.config, method = config, config.method
        self._predicts_noise = method.prediction_type == "epsilon"
        sizes = (point_dim, config.encoder_dims, config.encoder_out_dim)
        is_pointnet2 = method.encoder == "pointnet2"
        self.encoder = PointNet2Encoder(*sizes, config.num_points) if is_pointnet2 else PointNetEncoder(*sizes)
        unet = SimpleNamespace(
            action_feature=config.action_feature,
            horizon=config.horizon,
            down_dims=config.down_dims,
            kernel_size=kernel_size,
            n_groups=UNET_GROUPS,
            diffusion_step_embed_dim=method.step_embed_dim,
            use_film_scale_modulation=True,
            gradient_checkpointing=False,
        )
        self.unet = DiffusionConditionalUnet1d(unet, global_cond_dim=condition_dim)
        scheduler = DDIMScheduler if config.noise_scheduler_type == "DDIM" else DDPMScheduler
        self.noise_scheduler = scheduler(
            num_train_timesteps=TRAIN_TIMESTEPS,
            beta_schedule="squaredcos_cap_v2",
            prediction_type=method.prediction_type,
            clip_sample=True,
            clip_sample_range=clip,
        )

    def condition(self, window: Window) -> Tensor:
        """Returns the conditioning vector (B, C)."""
        raise NotImplementedError

    def encode(self, actions: Tensor, window: Window) -> Tensor:
        """Returns actions (B, T, A) as denoised values (B, T, A)."""
        raise NotImplementedError

    def loss(self, window: Window, actions: Tensor, is_label: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the denoising error per sample (B,), its weight (B,), and metrics (paper, eq. 2).

        Labels are ``actions`` (B, T, A) where ``is_label`` (B, T) is true; padding repeats the last.
        """
        target, condition = self.encode(actions, window), self.condition(window)
        noise = torch.randn_like(target)
        steps = torch.randint(0, TRAIN_TIMESTEPS, (len(target),), device=target.device)
        predicted = self.unet(self.noise_scheduler.add_noise(target, noise, steps), steps, global_cond=condition)
        target = noise if self._predicts_noise else target
        weight = is_label.sum(dim=1).to(predicted.dtype)
        error = F.mse_loss(predicted, target, reduction="none") * is_label.unsqueeze(-1).to(predicted.dtype)
        return error.flatten(1).sum(1) / (weight * error.shape[-1]).clamp(min=1), weight, {}

    def denoise(self, condition: Tensor, noise: Tensor | None) -> Tensor:
        """Draws values (B, T, A) from ``noise`` (B, T, A); None draws the noise."""
        assert self.config.action_feature is not None
        shape = (len(condition), self.config.horizon, self.config.action_feature.shape[0])
        # Float32 under autocast too: rounding errors of ten steps would be millimetres.
        sample = torch.randn(shape, device=condition.device, dtype=torch.float32) if noise is None else noise
        self.noise_scheduler.set_timesteps(self.config.num_inference_steps)
        for step in self.noise_scheduler.timesteps:
            steps = torch.full((len(sample),), int(step), dtype=torch.long, device=sample.device)
            predicted = self.unet(sample, steps, global_cond=condition)
            sample = self.noise_scheduler.step(predicted.float(), step, sample).prev_sample
        return sample


class CloudUnits(nn.Module):
    """Centre and scale of clouds, from the dataset's statistics when training starts; saved with the checkpoint."""

    center: Tensor
    scale: Tensor

    def __init__(self, stats: Statistics | None) -> None:
        super().__init__()
        self.register_buffer("center", torch.zeros(3))
        self.register_buffer("scale", torch.ones(1))
        if stats and POINT_CLOUD in stats:
            bounds = (torch.as_tensor(stats[POINT_CLOUD][name], dtype=torch.float32) for name in ("min", "max"))
            lower, upper = (as_points(bound).reshape(-1, 3) for bound in bounds)
            lower, upper = lower.amin(dim=0), upper.amax(dim=0)
            self.center.copy_((lower + upper) / 2)
            self.scale.copy_(((upper - lower) / 2).max().clamp(min=1e-3))

    def forward(self, cloud: Tensor) -> Tensor:
        """Clouds (..., 3) [m] -> (..., 3), centred and scaled."""
        return (cloud - self.center) / self.scale


class BaseDiffusionHead(DiffusionHead):
    """The head of the paper: observed steps and a flat history of actions, in the robot's base frame, normalised.

    Args:
        config: configuration of the policy.
        stats: statistics of the dataset, for the units of clouds; a checkpoint has its own.
    """

    def __init__(self, config: DP3AdaptiveConfig, stats: Statistics | None) -> None:
        assert config.action_feature is not None
        body_dim = config.feature_size(STATE) + (config.feature_size(EFFORT) if config.use_effort else 0)
        body_dim += instruction_dim(config)
        past_dim = config.n_action_history_steps * (config.action_feature.shape[0] + 1)
        condition_dim = config.n_obs_steps * (config.encoder_out_dim + body_dim) + (64 if past_dim else 0)
        super().__init__(config, 3, condition_dim, kernel_size=5, clip=1.0)
        self.cloud_units = CloudUnits(stats)
        self.history = nn.Sequential(nn.Linear(past_dim, 128), nn.Mish(), nn.Linear(128, 64)) if past_dim else None

    def encode(self, actions: Tensor, window: Window) -> Tensor:
        """Returns the normalised actions, which are denoised as they are."""
        return actions

    def sample(self, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, T, A), normalised, from ``noise`` (B, T, A); None draws the noise."""
        return self.denoise(self.condition(window), noise)

    def condition(self, window: Window) -> Tensor:
        """Returns the conditioning vector (B, C)."""
        observations, valid = window.observations, window.valid[..., None]
        state = observations[STATE]
        points = self.cloud_units(observations[POINT_CLOUD])
        body = [state]
        if self.config.use_effort:
            body.append(observations[EFFORT])
        if self.config.use_instruction:
            body.append(observations[INSTRUCTION].expand(-1, state.shape[1], -1))
        # Values that hardly vary in the demonstrations explode under MIN_MAX if they vary at run time.
        body = [part.clamp(-BODY_RANGE, BODY_RANGE) for part in body]
        encoded = self.encoder(points.flatten(0, 1)).unflatten(0, points.shape[:2])
        parts = [torch.cat([encoded, *body], dim=-1).flatten(1)]
        if self.history is not None:
            # Invalid rows hold the label.
            past = torch.cat([window.history.masked_fill(~valid, 0.0), valid.to(window.history.dtype)], dim=-1)
            parts.append(self.history(past.flatten(1)))
        return torch.cat(parts, dim=-1)


class MemoryDiffusionHead(ToolHead, DiffusionHead):
    """The head for control rate: with a memory of contact events, and no rule beside the network."""

    IS_DENSE = True
    READS_MISSES = False
    memory: ContactMemory | None

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        memory = config.memory_dim if config.n_action_history_steps else 0
        condition_dim = config.encoder_out_dim + self.body_dim(config) + memory
        super().__init__(config, POINT_DIM, condition_dim, kernel_size=3, clip=4.0)
        length = config.n_action_history_steps
        self.memory = make_memory(config.memory_kind, config.memory_dim, length) if memory else None

    def condition(self, window: Window, *, use_memory: bool = True) -> Tensor:
        """Returns the conditioning vector (B, C); its part of the memory is zero without a contact event."""
        parts = [self.encoder(self.point_inputs(window)), self.body_inputs(window)]
        if self.memory is not None:
            happened, read = self.remembered(window)
            parts.append(self.memory(happened, read if use_memory else torch.zeros_like(read)))
        return torch.cat(parts, dim=-1)

    def loss(self, window: Window, actions: Tensor, is_label: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """See `DiffusionHead.loss`; with the loss of a code."""
        error, weight, metrics = super().loss(window, actions, is_label)
        if isinstance(self.memory, MotionCode):
            code_loss = self.memory.loss(*self.remembered(window))
            error, metrics = error + code_loss, {**metrics, "code_loss": code_loss.detach().mean()}
        return error, weight, metrics

    def encode(self, actions: Tensor, window: Window) -> Tensor:
        """Returns poses (B, T, 10) as denoised values, relative to the present tool."""
        relative = geometry.relative_poses(actions, window.observations[STATE][:, -1:, :ACTION_DIM])
        position = torch.asinh(relative[..., POSITION_DIMS] / POSITION_UNIT)
        rotation, gripper = relative[..., ROTATION_DIMS] / ROTATION_UNIT, 2 * relative[..., GRIPPER_DIM:] - 1
        return torch.cat([position, rotation, gripper], dim=-1)

    def decode(self, values: Tensor, window: Window) -> Tensor:
        """Inverts `encode`; any values become poses."""
        position = POSITION_UNIT * torch.sinh(values[..., POSITION_DIMS])
        rotation = values[..., ROTATION_DIMS] * ROTATION_UNIT
        gripper = ((values[..., GRIPPER_DIM:] + 1) / 2).clamp(0, 1)
        return geometry.absolute_poses(torch.cat([position, rotation, gripper], dim=-1), self.tool(window)[:, None])

    def sample(self, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, T, 10) from ``noise`` (B, T, 10); None draws the noise."""
        condition = self.condition(window, use_memory=self.config.inference.memory)
        return self.decode(self.denoise(condition, noise), window)
