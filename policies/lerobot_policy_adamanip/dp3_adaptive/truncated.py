"""The head for key frames: truncated diffusion from anchors (DiffusionDrive, Liao et al., CVPR 2025, arXiv 2411.15139).

Motions in contact are millimetres long, approaches decimetres. So motions are clustered (k-means), and each centre is
an *anchor*. The network gives each anchor a score, and denoises the residual of the drawn one from a Gaussian of its
cluster's spread. A residual is in units of that spread, so its error is small relative to the motion. The scores keep
the two directions of a knob apart, and take the memory.
"""

from __future__ import annotations

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import ACTION_DIM, STATE
from lerobot_policy_adamanip.common import geometry
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.dp3_adaptive.tool_head import AnchoredHead

TRUNCATION = 1.0
"""Angle a of the strongest noise, pi/2 for noise alone: residuals have a share cos a of signal and sin a of noise."""
NOISES_PER_MOTION = 4
"""Number of noisy versions of a motion in a batch: the denoiser is small, compared with the encoder."""


class TruncatedHead(AnchoredHead):
    """Scores the anchors, draws one, denoises its residual and refines the pose.

    The memory changes only the scores, and only after a contact event. Before one, they are those of a network without
    a history. The rules act before a contact event, too.
    """

    def add_residuals(self, width: int) -> None:
        """Adds the denoiser of residuals."""
        self.denoiser = Denoiser(width, self.config.num_anchors)

    def forward(self, window: Window) -> tuple[Tensor, Tensor, Tensor | None]:
        """Returns features (B, W), logits (B, K) without memory, and what the memory adds to the logits."""
        features = torch.cat([self.encoder(self.point_inputs(window)), self.body_inputs(window)], dim=-1)
        features = self.trunk(features)
        if self.memory is None:
            return features, self.logits(features), None
        past = self.past(window)
        added = self.memory(features, past.events(feedback=self.config.use_feedback), past.contact)
        return features, self.logits(features), added

    def loss(self, window: Window, actions: Tensor, is_label: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the losses of choice, memory, denoising and refinement; labels are poses (B, 1, 10)."""
        motions, goal = self.motions, actions[:, 0]
        motion = geometry.motion_between(goal, window.observations[STATE][:, -1, :ACTION_DIM])
        index = motions.nearest(motion)
        features, logits, added = self(window)
        losses = {"choice_loss": F.cross_entropy(logits, index, reduction="none")}
        if added is not None:
            # Trains the memory alone: the choice without it must not depend on it.
            losses["memory_loss"] = F.cross_entropy(logits.detach() + added, index, reduction="none")
        residual = (motion - motions.anchors[index]) / motions.spread[index]
        losses["denoising_loss"] = self.denoiser.loss(features, index, residual)
        if self.refiner is not None:
            losses["refinement_loss"] = self.refinement_loss(window, goal, index)
        total = torch.stack(list(losses.values())).sum(dim=0)
        return total, is_label[:, 0].to(total.dtype), {name: loss.detach().mean() for name, loss in losses.items()}

    def sample(self, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, 1, 10). Uniform ``noise`` (B, ...) in [0, 1): its first value selects the first anchor, its
        last seven are the noise of residuals.

        An anchor whose approach ends at nothing is masked, and another one drawn, up to `DRAWS` draws. If all draws
        fail, the first one counts.
        """
        inference, motions, tool = self.config.inference, self.motions, self.tool(window)
        features, logits, added = self(window)
        logits = logits.float()
        if added is not None and inference.memory:
            logits = logits + added.float()
        noises, start = self._noises(len(tool), noise, logits)
        residuals = self.denoiser.sample(features, start, self.config.num_inference_steps)
        drawn = motions.anchors + residuals * motions.spread
        return self.choose(window, logits, drawn, noises)

    def _noises(self, count: int, noise: Tensor | None, like: Tensor) -> tuple[Tensor, Tensor]:
        """Returns uniform numbers (B, draws) that select anchors, and Gaussian noise (B, 1, 7), from ``noise``."""
        draws, dim = self.DRAWS if self.config.inference.redraw else 1, geometry.MOTION_DIM
        drawn = torch.rand(count, draws + dim, device=like.device)
        if noise is not None:
            given = noise.reshape(count, -1)
            drawn[:, 0], drawn[:, draws:] = given[:, 0], given[:, -dim:]
        uniform = drawn[:, draws:].clamp(1e-6, 1 - 1e-6)  # finite as a normal deviate
        return drawn[:, :draws], torch.special.ndtri(uniform)[:, None]


class Denoiser(nn.Module):
    """Denoises residuals of anchors, in units of their clusters' spread.

    In these units the residuals of a cluster have mean 0 and variance 1, and so have their noisy versions at each
    level. Sampling can therefore start amid the diffusion, at `TRUNCATION`, from Gaussian noise around the anchor.

    Args:
        width: number of features of an observation, and width of the layers.
        anchors: number of anchors.
    """

    def __init__(self, width: int, anchors: int) -> None:
        super().__init__()
        self.features, self.anchor = nn.Linear(width, width), nn.Embedding(anchors, width)
        self.noisy = nn.Linear(geometry.MOTION_DIM + 2, width)
        self.out = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, geometry.MOTION_DIM))

    def forward(self, features: Tensor, index: Tensor, noisy: Tensor, angle: Tensor) -> Tensor:
        """Returns clean residuals (B, K, 7) of noisy ones.

        Args:
            features: of the observations (B, W).
            index: anchors (B, K).
            noisy: residuals (B, K, 7) with a share cos a of signal and sin a of Gaussian noise.
            angle: a, (B, K) or for all ().
        """
        level = torch.stack([angle.cos(), angle.sin()], dim=-1).expand(*noisy.shape[:-1], 2)
        hidden = self.features(features)[:, None] + self.anchor(index) + self.noisy(torch.cat([noisy, level], dim=-1))
        clean: Tensor = self.out(hidden).float()
        return clean

    def loss(self, features: Tensor, index: Tensor, residual: Tensor) -> Tensor:
        """Returns the error (B,) of the residuals (B, 7) of anchors (B,), denoised from random levels."""
        residual, index = (
            value[:, None].expand(-1, NOISES_PER_MOTION, *value.shape[1:]) for value in (residual, index)
        )
        angle = TRUNCATION * torch.rand(index.shape, device=index.device)
        noisy = angle.cos()[..., None] * residual + angle.sin()[..., None] * torch.randn_like(residual)
        error = F.smooth_l1_loss(self(features, index, noisy, angle), residual, reduction="none")
        return error.mean(dim=(1, 2))

    def sample(self, features: Tensor, start: Tensor, steps: int) -> Tensor:
        """Draws a residual of each anchor (B, K, 7) from Gaussian noise (B, 1, 7) by DDIM, in float32."""
        count = self.anchor.num_embeddings
        index, sample = torch.arange(count, device=start.device).expand(len(start), -1), start.expand(-1, count, -1)
        angles = TRUNCATION * torch.linspace(1, 0, steps + 1, device=start.device)
        for angle, following in pairwise(angles):
            clean = self(features, index, sample, angle)
            noise = (sample - angle.cos() * clean) / angle.sin()
            sample = following.cos() * clean + following.sin() * noise
        return sample
