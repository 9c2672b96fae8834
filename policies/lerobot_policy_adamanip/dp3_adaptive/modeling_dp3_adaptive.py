"""``dp3_adaptive``: a diffusion policy over point clouds that remembers what it has tried.

Paper, section 4.2: P(A_t | O_t, A^_t), observations O_t and *action history* A^_t. The cloud is encoded, joined with
state and history into one vector, and modulates (FiLM) LeRobot's conditional U-Net, which denoises a chunk of actions.
"""

from __future__ import annotations

import copy
import logging
from collections import deque
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from lerobot.policies.diffusion.modeling_diffusion import DiffusionConditionalUnet1d
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor, nn

from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.mixed_precision import require_mixed_precision
from lerobot_adamanip.schema import ACTION, EFFORT, POINT_CLOUD, STATE
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig, wrong_number_of_points
from lerobot_policy_adamanip.encoders import make_encoder

ACTION_IS_PAD = "action_is_pad"
RELATIVE_SCALE = 0.15
"""Positions relative to the tool are given in this unit [m]: the length of a typical key frame."""
BODY_RANGE = 3.0
"""Bound of normalised proprioception; the demonstrations are within 1."""


def _forget_count(policy: DP3AdaptivePolicy, _: Any) -> None:
    """After weights were loaded the buffer says how many updates there were."""
    policy._ema_count = None


class DP3AdaptivePolicy(PreTrainedPolicy):
    """LeRobot policy. Training uses `forward`; at run time `select_action` keeps the histories.

    Time axis of a training batch, for H = ``n_action_history_steps`` and T = ``horizon``, t the present::

        batch["action"]   row  0 ... H-1 | H ... H+T-1       observations   row 0 ... S-1
                          step t-H ... t-1 | t ... t+T-1                    step t-S+1 ... t
                          history        | labels

    At run time the history is a queue of the normalised actions that `select_action` returned, one per step, whether
    they came from an old chunk or a new one. Before the episode's start both hold zeros, marked by a validity bit:
    LeRobot pads the window with the episode's first action, which at the start is the label. Observations before it
    repeat the first one, as LeRobot's padding does. The action that the environment receives is the remembered one
    unnormalised, its rotation orthonormalised and its gripper clipped; recorded actions are so already, which makes the
    two histories the same for a policy that acts as the demonstrations do.

    Args:
        config: of which `validate_features` is called here.
        dataset_stats: of the training data; relates normalised numbers to metres. Not needed to load a checkpoint.
        dataset_meta: of the training data; is told that no videos are needed.
        kwargs: whatever else LeRobot passes.
    """

    config_class = DP3AdaptiveConfig
    name = "dp3_adaptive"

    def __init__(
        self, config: DP3AdaptiveConfig, *, dataset_stats: dict | None = None, dataset_meta: Any = None, **kwargs: Any
    ):
        super().__init__(config)
        if config.use_amp:
            require_mixed_precision(config.device)
        config.validate_features()
        if config.action_feature is None:
            raise ConfigurationError(
                "The dataset has no actions.",
                got="no column `action`",
                allowed="demonstrations",
                hint="adamanip collect",
            )
        if config.tcp_relative and not config.has_pose_layout:
            logging.getLogger(__name__).warning(
                "State and action are not the ten pose numbers of the contract: tcp_relative, augmentation and "
                "orthonormalisation do not apply."
            )
        self.frames = PoseFrames(config, dataset_stats)
        self.model = ActionDenoiser(config, self.frames.point_dim)
        # The averaged weights are part of the policy, so that they are saved, resumed and evaluated.
        self.ema_model = copy.deepcopy(self.model).requires_grad_(False)
        self.register_buffer("ema_steps", torch.zeros((), dtype=torch.int64))
        self._ema_count: int | None = None  # known once `update` has read the buffer
        self.register_load_state_dict_post_hook(_forget_count)
        scheduler = DDIMScheduler if config.noise_scheduler_type == "DDIM" else DDPMScheduler
        self.noise_scheduler = scheduler(
            num_train_timesteps=config.num_train_timesteps,
            beta_schedule=config.beta_schedule,
            prediction_type=config.prediction_type,
            clip_sample=True,
            clip_sample_range=config.clip_sample_range,
        )
        self._meet_dataset(dataset_meta)
        self.reset()

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path, *, dataset_stats: dict | None = None, dataset_meta: Any = None, **kwargs
    ):
        """As LeRobot's, but strict about weights. New data's statistics, by which finetuning normalises, are taken.

        The unit of the cloud stays that of the checkpoint, for which its encoder was trained.
        """
        policy = super().from_pretrained(pretrained_name_or_path, **kwargs)
        policy.frames.set_pose_statistics(dataset_stats)
        policy._meet_dataset(dataset_meta)
        return policy

    def _meet_dataset(self, dataset_meta: Any) -> None:
        if dataset_meta is not None:
            from lerobot_adamanip.lerobot_compat import skip_videos

            skip_videos(dataset_meta)

    def supports_rtc(self) -> bool:
        """No: real-time chunking asks for chunks only, so that the histories would never advance."""
        return False

    # Training ---------------------------------------------------------------------------------------------------

    def get_optim_params(self):
        """Parameters to train; the averaged copy is not among them."""
        return self.model.parameters()

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Returns the denoising loss (paper, eq. 2), over actions that exist.

        Args:
            batch: normalised, with S = n_obs_steps, H = n_action_history_steps, T = horizon:
                ``observation.point_cloud`` (B, S, N, 3) metres, ``observation.state`` (B, S, D),
                ``action`` (B, H + T, A), ``action_is_pad`` (B, H + T).
            reduction: ``mean``, or ``none`` for one loss per sample (B,).
        """
        past = self.config.n_action_history_steps
        observations = self._observations(batch)
        history, valid = batch[ACTION][:, :past], ~batch[ACTION_IS_PAD][:, :past]
        if self.training and self.config.history_noise_std:
            history = history + self.config.history_noise_std * torch.randn_like(history)
        target = self.frames.to_relative(batch[ACTION][:, past:], observations[STATE][:, -1])
        condition = self.condition(observations, history, valid)
        noise = torch.randn_like(target)
        steps = torch.randint(0, self.config.num_train_timesteps, (len(target),), device=target.device)
        model = self._active_model()
        predicted = model.unet(self.noise_scheduler.add_noise(target, noise, steps), steps, global_cond=condition)
        # Padded labels repeat the episode's last action: they are no demonstrations, so they carry no loss.
        wanted = noise if self.config.prediction_type == "epsilon" else target
        real = (~batch[ACTION_IS_PAD][:, past:]).unsqueeze(-1).to(predicted.dtype)
        error = F.mse_loss(predicted, wanted, reduction="none") * real
        if reduction == "none":
            loss = error.flatten(1).sum(1) / (real.flatten(1).sum(1) * error.shape[-1]).clamp(min=1)
        else:
            loss = error.sum() / (real.sum() * error.shape[-1]).clamp(min=1)
        return loss, {}

    @torch.no_grad()
    def update(self) -> None:
        """Moves the averaged weights; lerobot-train calls this after each optimizer step."""
        # Counted here too: reading the buffer would wait for the GPU at every step.
        self._ema_count = (int(self.ema_steps) if self._ema_count is None else self._ema_count) + 1
        self.ema_steps += 1
        decay = min(1 - (1 + self._ema_count) ** -self.config.ema_power, self.config.ema_max)
        torch._foreach_lerp_(list(self.ema_model.parameters()), list(self.model.parameters()), 1 - decay)

    # Run time ---------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forgets the episode."""
        self._observed: deque[dict[str, Tensor]] = deque(maxlen=self.config.n_obs_steps)
        self._executed: deque[Tensor] = deque(maxlen=max(1, self.config.n_action_history_steps))
        self._planned: deque[Tensor] = deque()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the next action (B, A), normalised, and remembers it as executed.

        Args:
            batch: one observation, normalised: cloud (B, N, 3) [m], state (B, D). An ``action`` is ignored.
            noise: what denoising starts from, (B, T, A); drawn if None.
            kwargs: ignored.
        """
        observation = self._single(batch)
        self._observed.append(observation)
        while len(self._observed) < self.config.n_obs_steps:
            self._observed.append(observation)
        if not self._planned:
            chunk = self._generate(list(self._observed), noise)
            self._planned.extend(chunk[:, : self.config.n_action_steps].unbind(dim=1))
        action = self._planned.popleft()
        self._executed.append(action)
        return action

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the chunk (B, T, A) that would follow ``batch`` after what was observed and done; changes nothing."""
        observed = deque(self._observed, maxlen=self.config.n_obs_steps)
        observation = self._single(batch)
        observed.append(observation)
        while len(observed) < self.config.n_obs_steps:
            observed.appendleft(observed[0])
        return self._generate(list(observed), noise)

    def executed_history(self, batch_size: int, like: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the run-time history: actions (B, H, A), oldest first and zero before the start; validity (B, H)."""
        length, dims = self.config.n_action_history_steps, self.config.action_feature.shape[0]
        history = torch.zeros(batch_size, length, dims, device=like.device, dtype=like.dtype)
        valid = torch.zeros(batch_size, length, dtype=torch.bool, device=like.device)
        known = list(self._executed)[-length:] if length else []
        if known:
            history[:, -len(known) :] = torch.stack(known, dim=1).to(history)
            valid[:, -len(known) :] = True
        return history, valid

    def _generate(self, observed: list[dict[str, Tensor]], noise: Tensor | None) -> Tensor:
        observations = {key: torch.stack([step[key] for step in observed], dim=1) for key in observed[0]}
        state = observations[STATE]
        history, valid = self.executed_history(len(state), state)
        condition = self.condition(observations, history, valid)
        shape = (len(state), self.config.horizon, self.config.action_feature.shape[0])
        # In float32 under autocast too: ten steps of rounding would cost millimetres.
        sample = torch.randn(shape, device=state.device, dtype=torch.float32) if noise is None else noise
        self.noise_scheduler.set_timesteps(self.config.num_inference_steps)
        unet = self._active_model().unet
        for step in self.noise_scheduler.timesteps:
            steps = torch.full((len(sample),), int(step), dtype=torch.long, device=sample.device)
            predicted = unet(sample, steps, global_cond=condition)
            sample = self.noise_scheduler.step(predicted.float(), step, sample).prev_sample
        return self.frames.to_absolute(sample, state[:, -1])

    # Shared -----------------------------------------------------------------------------------------------------

    def condition(self, observations: dict[str, Tensor], history: Tensor, valid: Tensor) -> Tensor:
        """Returns the conditioning vector (B, C).

        Args:
            observations: cloud (B, S, N, 3) [m], state (B, S, D), effort (B, S, 7) if used.
            history: normalised actions (B, H, A), oldest first. At an episode's start LeRobot pads it with the *label*:
                whatever is not valid is zeroed here, so that neither training nor run time can see it.
            valid: (B, H) bool.
        """
        state = observations[STATE]
        points = self.frames.points(observations[POINT_CLOUD], state)
        relative = self.frames.to_relative(history, state[:, -1])
        past = torch.cat([relative.masked_fill(~valid[..., None], 0.0), valid[..., None].to(relative.dtype)], dim=-1)
        body = [state[..., : self.config.state_dim]]
        if self.config.use_effort:
            body.append(observations[EFFORT])
        # Dimensions that hardly vary in the demonstrations explode under MIN_MAX as soon as they do.
        body = [part.clamp(-BODY_RANGE, BODY_RANGE) for part in body]
        return self._active_model().condition(points, torch.cat(body, dim=-1), past)

    def _active_model(self) -> ActionDenoiser:
        """The trained weights in training mode, the averaged ones otherwise."""
        return self.model if self.training or int(self.ema_steps) == 0 else self.ema_model

    def _observations(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Picks the inputs, and of each cloud the first points; the batch stays as it is."""
        wanted = self.config.input_features
        if any(batch.get(key) is None for key in wanted):
            raise ConfigurationError(
                "The observation lacks what the policy looks at.",
                got=", ".join(key for key in batch if key.startswith("observation")) or "no observation",
                allowed=", ".join(wanted),
                hint="--env.type=adamanip_safe, or another environment with point clouds",
            )
        picked = {key: batch[key] for key in wanted}
        cloud = picked[POINT_CLOUD]
        if cloud.shape[-2] < self.config.num_points:
            raise wrong_number_of_points(tuple(cloud.shape[-2:]), self.config.num_points)
        picked[POINT_CLOUD] = cloud[..., : self.config.num_points, :3]
        return picked

    def _single(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """One step's inputs, each (B, ...). LeRobot adds a missing batch dimension to states, but not to clouds."""
        observation = self._observations(batch)
        if observation[POINT_CLOUD].dim() == 2:
            observation[POINT_CLOUD] = observation[POINT_CLOUD][None]
        return observation

    @classmethod
    def _load_as_safetensor(cls, model, model_file: str, map_location: str, strict: bool):
        """Loads strictly: LeRobot's default would leave what does not fit at random values."""
        try:
            return super()._load_as_safetensor(model, model_file, map_location, True)
        except RuntimeError as error:
            reasons = [line.strip() for line in str(error).splitlines() if line.strip()]
            raise ConfigurationError(
                f"The checkpoint {Path(model_file).parent} does not fit this policy.",
                got="; ".join(reasons[:3])[:400],
                allowed="weights saved with the same options",
                hint="leave --policy.* options as in its config.json",
            ) from error

    def generate_model_card(self, *args: Any, **kwargs: Any):
        """LeRobot's card, headed by ``hub_cards/model_card.md``: what this policy is, sees and does."""
        from lerobot_adamanip.hub.cards import card_template

        card, config = super().generate_model_card(*args, **kwargs), self.config
        own = card_template("model_card.md").substitute(
            repo_id=config.repo_id or "<this repository>",
            preset=config.preset,
            encoder=config.encoder,
            num_points=config.num_points,
            inputs=", ".join(f"`{key}` {tuple(feature.shape)}" for key, feature in config.input_features.items()),
            outputs=", ".join(f"`{key}` {tuple(feature.shape)}" for key, feature in config.output_features.items()),
            n_obs_steps=config.n_obs_steps,
            n_action_history_steps=config.n_action_history_steps,
            horizon=config.horizon,
            n_action_steps=config.n_action_steps,
            sampler=f"{config.noise_scheduler_type}, {config.num_inference_steps} steps, {config.prediction_type}",
            parameters=f"{sum(p.numel() for p in self.model.parameters()) / 1e6:.1f}",
            updates=int(self.ema_steps),
        )
        card.text = own.rstrip() + "\n\n" + card.text.lstrip()
        return card


class PoseFrames(nn.Module):
    """The few constants that relate normalised states and actions to metres, so that clouds and poses can be related.

    Set from dataset statistics when training starts, saved with the checkpoint.
    """

    def __init__(self, config: DP3AdaptiveConfig, stats: dict | None) -> None:
        super().__init__()
        self.relative = bool(config.tcp_relative) and config.has_pose_layout
        for name, size, value in (
            ("cloud_center", 3, 0.0),
            ("cloud_scale", 1, 1.0),
            ("state_center", 3, 0.0),
            ("state_half", 3, 1.0),
            ("action_center", 3, 0.0),
            ("action_half", 3, 1.0),
        ):
            self.register_buffer(name, torch.full((size,), value))
        if stats and POINT_CLOUD in stats:
            lower, upper = _range(stats, POINT_CLOUD)
            self.cloud_center.copy_((lower + upper) / 2)
            self.cloud_scale.copy_(((upper - lower) / 2).max().clamp(min=1e-3))
        self.set_pose_statistics(stats)

    def set_pose_statistics(self, stats: dict | None) -> None:
        """Sets what LeRobot's MIN_MAX normalises positions with: it must be the same as in the processors."""
        if not stats or not self.relative:
            return
        for key, name in ((STATE, "state"), (ACTION, "action")):
            lower, upper = _range(stats, key)
            center, half = getattr(self, f"{name}_center"), getattr(self, f"{name}_half")
            center.copy_((lower + upper) / 2)
            # LeRobot replaces a range of zero by 1e-8; so does this, in float32.
            half.copy_(torch.where(upper == lower, torch.full_like(upper, 1e-8), upper - lower) / 2)

    @property
    def point_dim(self) -> int:
        """Numbers per point."""
        return 6 if self.relative else 3

    def tcp(self, state: Tensor) -> Tensor:
        """Normalised states (..., D) -> tool positions (..., 3) [m]."""
        return state[..., :3] * self.state_half + self.state_center

    def points(self, cloud: Tensor, state: Tensor) -> Tensor:
        """(B, S, N, 3) [m] -> (B, S, N, 3 or 6): centred and scaled, and relative to the tool."""
        centred = (cloud - self.cloud_center) / self.cloud_scale
        if not self.relative:
            return centred
        return torch.cat([centred, (cloud - self.tcp(state)[..., None, :]) / RELATIVE_SCALE], dim=-1)

    def to_relative(self, actions: Tensor, state: Tensor) -> Tensor:
        """Normalised actions (B, T, A) -> positions relative to the tool of ``state`` (B, D)."""
        if not self.relative:
            return actions
        position = actions[..., :3] * self.action_half + self.action_center
        return torch.cat([(position - self.tcp(state)[:, None]) / RELATIVE_SCALE, actions[..., 3:]], dim=-1)

    def to_absolute(self, actions: Tensor, state: Tensor) -> Tensor:
        """The inverse of `to_relative`."""
        if not self.relative:
            return actions
        position = actions[..., :3] * RELATIVE_SCALE + self.tcp(state)[:, None]
        return torch.cat([(position - self.action_center) / self.action_half, actions[..., 3:]], dim=-1)


def _range(stats: dict, key: str) -> tuple[Tensor, Tensor]:
    lower, upper = (torch.as_tensor(stats[key][name], dtype=torch.float32).reshape(-1)[:3] for name in ("min", "max"))
    return lower, upper


class ActionDenoiser(nn.Module):
    """What is trained: cloud encoder, history encoder and LeRobot's conditional U-Net.

    Args:
        config: of the policy.
        point_dim: numbers per point, as `PoseFrames` gives them.
    """

    def __init__(self, config: DP3AdaptiveConfig, point_dim: int) -> None:
        super().__init__()
        self.encoder = make_encoder(
            config.encoder, point_dim, config.encoder_dims, config.encoder_out_dim, config.num_points
        )
        body_dim = config.state_dim + (config.input_features[EFFORT].shape[0] if config.use_effort else 0)
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
