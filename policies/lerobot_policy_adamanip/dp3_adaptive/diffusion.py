"""The head ``diffusion``: LeRobot's conditional U-Net denoises a chunk of actions (paper, section 4.2 and eq. 2)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from lerobot.policies.diffusion.modeling_diffusion import DiffusionConditionalUnet1d
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import EFFORT, POINT_CLOUD, STATE
from lerobot_policy_adamanip.common.encoders import make_encoder
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.pose_frames import PoseFrames
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, INSTRUCTION_DIM
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

BODY_RANGE = 3.0
"""Bound of normalised proprioception; demonstrations are within 1."""


class ActionDenoiser(nn.Module):
    """The trained network: cloud encoder, history encoder and LeRobot's conditional U-Net."""

    def __init__(self, config: DP3AdaptiveConfig, point_dim: int) -> None:
        super().__init__()
        self.encoder = make_encoder(
            config.encoder, point_dim, config.encoder_dims, config.encoder_out_dim, config.num_points
        )
        body_dim = config.state_dim + (config.feature_size(EFFORT) if config.use_effort else 0)
        body_dim += INSTRUCTION_DIM if config.use_instruction else 0
        past_dim = config.n_action_history_steps * (config.action_feature.shape[0] + 1)
        self.history = nn.Sequential(nn.Linear(past_dim, 128), nn.Mish(), nn.Linear(128, 64)) if past_dim else None
        condition_dim = config.n_obs_steps * (config.encoder_out_dim + body_dim) + (64 if past_dim else 0)
        self.unet = DiffusionConditionalUnet1d(config, global_cond_dim=condition_dim)

    def condition(self, points: Tensor, body: Tensor, past: Tensor) -> Tensor:
        """(B, S, N, C), (B, S, D), (B, H, A + 1) -> (B, condition)."""
        encoded = self.encoder(points.flatten(0, 1)).unflatten(0, points.shape[:2])
        parts = [torch.cat([encoded, body], dim=-1).flatten(1)]
        if self.history is not None:
            parts.append(self.history(past.flatten(1)))
        return torch.cat(parts, dim=-1)


class DiffusionHead:
    """Loss and sampling of an `ActionDenoiser`. States and actions are normalised."""

    def __init__(self, config: DP3AdaptiveConfig, frames: PoseFrames) -> None:
        self.config, self.frames = config, frames
        scheduler = DDIMScheduler if config.noise_scheduler_type == "DDIM" else DDPMScheduler
        self.noise_scheduler = scheduler(
            num_train_timesteps=config.num_train_timesteps,
            beta_schedule=config.beta_schedule,
            prediction_type=config.prediction_type,
            clip_sample=True,
            clip_sample_range=config.clip_sample_range,
        )

    def network(self) -> ActionDenoiser:
        """Returns an untrained network."""
        return ActionDenoiser(self.config, self.frames.point_dim)

    def loss(
        self, model: ActionDenoiser, window: Window, actions: Tensor, is_label: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the denoising error per sample (B,), its weight (B,), and no metrics.

        Labels are ``actions`` (B, T, A), normalised, where ``is_label`` (B, T) is true; padding repeats the last.
        """
        if model.training and self.config.history_noise_std:
            noisy = window.history + self.config.history_noise_std * torch.randn_like(window.history)
            window = Window(window.observations, noisy, window.valid)
        target = self.frames.to_relative(actions, window.observations[STATE][:, -1])
        condition = self.condition(model, window)
        noise = torch.randn_like(target)
        steps = torch.randint(0, self.config.num_train_timesteps, (len(target),), device=target.device)
        predicted = model.unet(self.noise_scheduler.add_noise(target, noise, steps), steps, global_cond=condition)
        if self.config.prediction_type == "epsilon":
            target = noise
        weight = is_label.sum(dim=1).to(predicted.dtype)
        error = F.mse_loss(predicted, target, reduction="none") * is_label.unsqueeze(-1).to(predicted.dtype)
        return error.flatten(1).sum(1) / (weight * error.shape[-1]).clamp(min=1), weight, {}

    def sample(self, model: ActionDenoiser, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, T, A), normalised, from ``noise`` (B, T, A); None draws the noise."""
        state = window.observations[STATE]
        condition = self.condition(model, window)
        shape = (len(state), self.config.horizon, window.history.shape[-1])
        # Float32 under autocast too: rounding errors of ten steps would be millimetres.
        sample = torch.randn(shape, device=state.device, dtype=torch.float32) if noise is None else noise
        self.noise_scheduler.set_timesteps(self.config.num_inference_steps)
        for step in self.noise_scheduler.timesteps:
            steps = torch.full((len(sample),), int(step), dtype=torch.long, device=sample.device)
            predicted = model.unet(sample, steps, global_cond=condition)
            sample = self.noise_scheduler.step(predicted.float(), step, sample).prev_sample
        return self.frames.to_absolute(sample, state[:, -1])

    def condition(self, model: ActionDenoiser, window: Window) -> Tensor:
        """Returns the conditioning vector (B, C)."""
        observations, valid = window.observations, window.valid[..., None]
        state = observations[STATE]
        points = self.frames.points(observations[POINT_CLOUD], state)
        relative = self.frames.to_relative(window.history, state[:, -1])
        # Invalid rows hold the label.
        past = torch.cat([relative.masked_fill(~valid, 0.0), valid.to(relative.dtype)], dim=-1)
        body = [state[..., : self.config.state_dim]]
        if self.config.use_effort:
            body.append(observations[EFFORT])
        if self.config.use_instruction:
            body.append(observations[INSTRUCTION].expand(-1, state.shape[1], -1))
        # Values that hardly vary in the demonstrations explode under MIN_MAX if they vary at run time.
        body = [part.clamp(-BODY_RANGE, BODY_RANGE) for part in body]
        return model.condition(points, torch.cat(body, dim=-1), past)
