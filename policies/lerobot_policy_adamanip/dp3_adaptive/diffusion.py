"""The head ``diffusion``: LeRobot's conditional U-Net denoises a chunk of actions (paper, section 4.2 and eq. 2)."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from lerobot.policies.diffusion.modeling_diffusion import DiffusionConditionalUnet1d
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import EFFORT, POINT_CLOUD, STATE, Statistics
from lerobot_policy_adamanip.common.encoders import make_encoder
from lerobot_policy_adamanip.dp3_adaptive.cloud_units import CloudUnits
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, instruction_dim
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

BODY_RANGE = 3.0
"""Bound of normalised proprioception; demonstrations are within 1."""


class Denoiser(nn.Module):
    """A cloud encoder and LeRobot's conditional U-Net, whose condition has ``condition_dim`` values."""

    def __init__(self, config: DP3AdaptiveConfig, point_dim: int, condition_dim: int) -> None:
        super().__init__()
        self.encoder = make_encoder(
            config.encoder, point_dim, config.encoder_dims, config.encoder_out_dim, config.num_points
        )
        self.unet = DiffusionConditionalUnet1d(config, global_cond_dim=condition_dim)


class BaseDenoiser(Denoiser):
    """The network of the paper: observed steps and a flat history of actions, in the robot's base frame."""

    def __init__(self, config: DP3AdaptiveConfig, stats: Statistics | None) -> None:
        body_dim = config.state_dim + (config.feature_size(EFFORT) if config.use_effort else 0)
        body_dim += instruction_dim(config)
        past_dim = config.n_action_history_steps * (config.action_feature.shape[0] + 1)
        condition_dim = config.n_obs_steps * (config.encoder_out_dim + body_dim) + (64 if past_dim else 0)
        super().__init__(config, 3, condition_dim)
        self.cloud_units = CloudUnits(stats)
        self.history = nn.Sequential(nn.Linear(past_dim, 128), nn.Mish(), nn.Linear(128, 64)) if past_dim else None


class DiffusionHead:
    """Denoising of chunks of actions; how a chunk is encoded and what it is conditioned on depends on the frame."""

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        self.config = config
        scheduler = DDIMScheduler if config.noise_scheduler_type == "DDIM" else DDPMScheduler
        self.noise_scheduler = scheduler(
            num_train_timesteps=config.num_train_timesteps,
            beta_schedule=config.beta_schedule,
            prediction_type=config.prediction_type,
            clip_sample=True,
            clip_sample_range=config.clip_sample_range,
        )

    def condition(self, model: Any, window: Window) -> Tensor:
        """Returns the conditioning vector (B, C)."""
        raise NotImplementedError

    def encode(self, actions: Tensor, window: Window) -> Tensor:
        """Returns actions (B, T, A) as denoised values (B, T, A)."""
        raise NotImplementedError

    def loss(
        self, model: Any, window: Window, actions: Tensor, is_label: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the denoising error per sample (B,), its weight (B,), and metrics (paper, eq. 2).

        Labels are ``actions`` (B, T, A) where ``is_label`` (B, T) is true; padding repeats the last.
        """
        target, condition = self.encode(actions, window), self.condition(model, window)
        noise = torch.randn_like(target)
        steps = torch.randint(0, self.config.num_train_timesteps, (len(target),), device=target.device)
        predicted = model.unet(self.noise_scheduler.add_noise(target, noise, steps), steps, global_cond=condition)
        if self.config.prediction_type == "epsilon":
            target = noise
        weight = is_label.sum(dim=1).to(predicted.dtype)
        error = F.mse_loss(predicted, target, reduction="none") * is_label.unsqueeze(-1).to(predicted.dtype)
        return error.flatten(1).sum(1) / (weight * error.shape[-1]).clamp(min=1), weight, {}

    def denoise(self, model: Any, condition: Tensor, noise: Tensor | None) -> Tensor:
        """Draws values (B, T, A) from ``noise`` (B, T, A); None draws the noise."""
        shape = (len(condition), self.config.horizon, self.config.action_feature.shape[0])
        # Float32 under autocast too: rounding errors of ten steps would be millimetres.
        sample = torch.randn(shape, device=condition.device, dtype=torch.float32) if noise is None else noise
        self.noise_scheduler.set_timesteps(self.config.num_inference_steps)
        for step in self.noise_scheduler.timesteps:
            steps = torch.full((len(sample),), int(step), dtype=torch.long, device=sample.device)
            predicted = model.unet(sample, steps, global_cond=condition)
            sample = self.noise_scheduler.step(predicted.float(), step, sample).prev_sample
        return sample


class BaseDiffusionHead(DiffusionHead):
    """Loss and sampling of a `BaseDenoiser`. States and actions are normalised.

    Args:
        config: of the policy.
        stats: of the dataset, for the units of clouds; a checkpoint has its own.
    """

    def __init__(self, config: DP3AdaptiveConfig, stats: Statistics | None) -> None:
        super().__init__(config)
        self.stats = stats

    def network(self) -> BaseDenoiser:
        """Returns an untrained network."""
        return BaseDenoiser(self.config, self.stats)

    def encode(self, actions: Tensor, window: Window) -> Tensor:
        """Returns the normalised actions, which are denoised as they are."""
        return actions

    def loss(
        self, model: Any, window: Window, actions: Tensor, is_label: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the loss of `DiffusionHead`, with noise on the history."""
        if model.training and self.config.history_noise_std:
            noisy = window.history + self.config.history_noise_std * torch.randn_like(window.history)
            window = Window(window.observations, noisy, window.valid)
        return super().loss(model, window, actions, is_label)

    def sample(self, model: Any, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, T, A), normalised, from ``noise`` (B, T, A); None draws the noise."""
        return self.denoise(model, self.condition(model, window), noise)

    def condition(self, model: BaseDenoiser, window: Window) -> Tensor:
        """Returns the conditioning vector (B, C)."""
        observations, valid = window.observations, window.valid[..., None]
        state = observations[STATE]
        points = model.cloud_units(observations[POINT_CLOUD])
        body = [state[..., : self.config.state_dim]]
        if self.config.use_effort:
            body.append(observations[EFFORT])
        if self.config.use_instruction:
            body.append(observations[INSTRUCTION].expand(-1, state.shape[1], -1))
        # Values that hardly vary in the demonstrations explode under MIN_MAX if they vary at run time.
        body = [part.clamp(-BODY_RANGE, BODY_RANGE) for part in body]
        encoded = model.encoder(points.flatten(0, 1)).unflatten(0, points.shape[:2])
        parts = [torch.cat([encoded, *body], dim=-1).flatten(1)]
        if model.history is not None:
            # Invalid rows hold the label.
            past = torch.cat([window.history.masked_fill(~valid, 0.0), valid.to(window.history.dtype)], dim=-1)
            parts.append(model.history(past.flatten(1)))
        return torch.cat(parts, dim=-1)
