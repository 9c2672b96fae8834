"""The head ``anchors``: draw one of the demonstrations' typical motions, then correct it by what is seen.

A motion in contact is millimetres, an approach decimetres. Motions are clustered (k-means, as Behavior Transformers
do); which cluster comes next is a classification, which keeps two directions of a knob apart, and the residual is
measured in the spread of its own cluster, which makes its error small relative to the motion.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.schema import ACTION, ACTION_DIM, EFFORT, POINT_CLOUD, STATE
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.memory import EventMemory, events
from lerobot_policy_adamanip.dp3_adaptive.tool_frame import (
    MOTION_DIM,
    MOTION_UNITS,
    motion_between,
    points_seen,
    pose_after,
    upwards,
)
from lerobot_policy_adamanip.dp3_adaptive.window import Window
from lerobot_policy_adamanip.encoders import make_encoder

LEAST_SPREAD = (0.002, 0.002, 0.002, 0.02, 0.02, 0.02, 0.02)
"""Spread of a cluster that counts as none [m, m, m, rad, rad, rad, -]: finer than this is not asked for."""
POINT_UNIT, POINT_NEAR = 0.15, 0.03
"""A point is told by where it is in this unit, and by its direction, which is sharp within this distance [m]."""
EFFORT_UNIT = 20.0
"""[N m]"""
SILENT = 0.03
"""Anchors less likely than this are never drawn: what a network has not quite unlearned is no choice."""


class AnchorNetwork(nn.Module):
    """Cloud and memory to logits of anchors and a residual for each.

    Args:
        config: of the policy.
    """

    anchors: Tensor
    spread: Tensor

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        super().__init__()
        motion = config.horizon * MOTION_DIM
        self.register_buffer("anchors", torch.zeros(config.num_anchors, motion))
        self.register_buffer("spread", torch.zeros(config.num_anchors, motion))
        self.encoder = make_encoder(config.encoder, 6, config.encoder_dims, config.encoder_out_dim, config.num_points)
        remembers = config.n_action_history_steps > 0
        self.memory = EventMemory(config.memory_dim) if remembers else None
        effort = config.feature_size(EFFORT) if config.use_effort else 0
        seen = config.encoder_out_dim + 4 + effort + (config.memory_dim if remembers else 0)
        width = config.trunk_dim
        self.trunk = nn.Sequential(nn.Linear(seen, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.logits = nn.Linear(width, config.num_anchors)
        self.residuals = nn.Linear(width, config.num_anchors * motion)

    def forward(self, points: Tensor, body: Tensor, happened: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, 6), (B, 4+), (B, H, 16) -> logits (B, K), residuals (B, K, D) in units of their anchors' spread."""
        parts = [self.encoder(points), body]
        if self.memory is not None:
            parts.append(self.memory(happened))
        features = self.trunk(torch.cat(parts, dim=-1))
        return self.logits(features), self.residuals(features).reshape(-1, *self.anchors.shape)


class AnchorHead:
    """Loss and sampling of an `AnchorNetwork`. States and actions are poses, not normalised.

    Args:
        config: of the policy.
    """

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        self.config = config

    def network(self) -> AnchorNetwork:
        """Returns a network that is still untrained and without anchors."""
        return AnchorNetwork(self.config)

    def predict(self, model: AnchorNetwork, window: Window, *, training: bool = False) -> tuple[Tensor, Tensor]:
        """Returns logits (B, K) and residuals (B, K, D)."""
        cloud = window.observations[POINT_CLOUD][:, -1]
        poses = window.observations[STATE][..., :ACTION_DIM]
        if training:
            cloud = self._perturbed(cloud)
        points = points_seen(cloud, poses[:, -1])
        near = points / (points.norm(dim=-1, keepdim=True) + POINT_NEAR)
        body = [upwards(poses[:, -1]), poses[:, -1, 9:10]]
        if self.config.use_effort:
            body.append(window.observations[EFFORT][:, -1] / EFFORT_UNIT)
        steps = self.config.n_action_history_steps
        happened = events(window.history, poses[:, -steps - 1 :], window.valid)
        logits, residuals = model(torch.cat([points / POINT_UNIT, near], dim=-1), torch.cat(body, dim=-1), happened)
        return logits, residuals

    def _perturbed(self, cloud: Tensor) -> Tensor:
        """Other points of the same surfaces at every step, not quite where they were."""
        count = self.config.training_points
        if count < cloud.shape[1]:
            kept = torch.rand(cloud.shape[:2], device=cloud.device).topk(count, dim=1).indices
            cloud = cloud.gather(1, kept[..., None].expand(-1, -1, cloud.shape[-1]))
        return cloud + self.config.point_noise_std * torch.randn_like(cloud)

    def loss(
        self, model: AnchorNetwork, window: Window, actions: Tensor, real: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns a loss per sample (B,), its weight (B,), and what to log.

        Args:
            model: of which the anchors are known.
            window: what it is conditioned on.
            actions: (B, T, 10) poses.
            real: (B, T) bool; what lies beyond an episode's end is no demonstration.
        """
        if not model.spread.any():
            raise ConfigurationError(
                "The anchors are not known.",
                got="a policy made without a dataset",
                allowed="make_policy(..., ds_meta=) of a dataset, or a checkpoint",
                hint="policy.fit_anchors(motions), or --policy.preset=diffusion",
            )
        tool = window.observations[STATE][:, -1:, :ACTION_DIM]
        target = motion_between(actions, tool)
        units = target.new_tensor(MOTION_UNITS)
        logits, residuals = self.predict(model, window, training=model.training)
        away = (
            (target[:, None] - model.anchors.reshape(-1, self.config.horizon, MOTION_DIM))
            / units
            * real[:, None, :, None]
        ) ** 2
        nearest = away.flatten(2).sum(-1).argmin(dim=1)
        chosen = residuals[torch.arange(len(target), device=target.device), nearest]
        wanted = (target.flatten(1) - model.anchors[nearest]) / model.spread[nearest]
        mask = real.repeat_interleave(MOTION_DIM, dim=1).to(wanted.dtype)
        missed = F.smooth_l1_loss(chosen, wanted, reduction="none") * mask
        choice = F.cross_entropy(logits, nearest, reduction="none")
        correction = missed.sum(1) / mask.sum(1).clamp(min=1)
        told = {
            "choice_loss": choice.detach().mean(),
            "correction_loss": correction.detach().mean(),
        }
        return choice + self.config.residual_weight * correction, real[:, 0].to(choice.dtype), told

    def sample(self, model: AnchorNetwork, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, T, 10).

        Args:
            model: trained.
            window: what it is conditioned on.
            noise: uniform numbers in [0, 1), (B, ...), the first of a row is used; drawn if None.
        """
        logits, residuals = self.predict(model, window)
        likely = logits.float().softmax(dim=-1)
        likely = likely.masked_fill((likely < SILENT) & (likely < likely.amax(dim=-1, keepdim=True)), 0.0)
        draw = torch.rand(len(likely), device=likely.device) if noise is None else noise.reshape(len(likely), -1)[:, 0]
        passed = likely.cumsum(dim=-1) / likely.sum(dim=-1, keepdim=True)
        index = torch.searchsorted(passed, draw[:, None].to(passed.dtype), right=True).squeeze(-1)
        index = index.clamp(max=likely.shape[-1] - 1)
        rows = torch.arange(len(likely), device=likely.device)
        motion = model.anchors[index] + residuals[rows, index].float() * model.spread[index]
        motion = motion.reshape(len(motion), -1, MOTION_DIM)
        motion[..., 6:] = motion[..., 6:].clamp(0, 1)
        return pose_after(motion, window.observations[STATE][:, -1:, :ACTION_DIM].float())


def fit_anchors(motions: NDArray[np.float32], count: int, *, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Clusters motions by k-means in their units.

    Args:
        motions: (M, T, 7) of the demonstrations.
        count: of anchors; with fewer different motions some stand twice.
        seed: of the clustering.

    Returns:
        anchors (count, T * 7) [m, rad, -] and the spread of each cluster (count, T * 7), bounded below.
    """
    from scipy.cluster.vq import kmeans2

    horizon = motions.shape[1]
    units, least = (np.tile(np.asarray(one), horizon) for one in (MOTION_UNITS, LEAST_SPREAD))
    rows = motions.reshape(len(motions), -1).astype(np.float64) / units
    rows = rows if len(rows) >= count else np.tile(rows, (-(-count // len(rows)), 1))
    centres, labels = kmeans2(rows, count, minit="++", iter=50, seed=seed, missing="warn")
    spread = np.stack(
        [rows[labels == k].std(axis=0) if (labels == k).any() else np.zeros(rows.shape[1]) for k in range(count)]
    )
    spread = np.maximum(spread * units, least)
    return torch.from_numpy((centres * units).astype(np.float32)), torch.from_numpy(spread.astype(np.float32))


def demonstrated_motions(dataset_meta: Any, horizon: int) -> NDArray[np.float32]:
    """Returns the motions (M, T, 7) of a dataset, from its files; beyond an episode's end its last action.

    Raises:
        ConfigurationError: the files are not there.
    """
    import pyarrow.dataset as files

    folder = Path(dataset_meta.root) / "data"
    if not folder.is_dir():
        raise ConfigurationError(
            "The demonstrations' motions cannot be read.",
            got=f"no folder {folder.name} beside the metadata",
            allowed="a dataset whose files have been downloaded",
            hint="LeRobotDataset(repo_id), before the policy is made",
        )
    table = files.dataset(folder, format="parquet").to_table(columns=[STATE, ACTION, "episode_index", "index"])
    table = table.sort_by("index")
    poses, actions = (torch.from_numpy(np.stack(table[key].to_numpy()).astype(np.float32)) for key in (STATE, ACTION))
    episodes = table["episode_index"].to_numpy()
    ends = np.searchsorted(episodes, episodes, side="right") - 1
    window = np.minimum(np.arange(len(episodes))[:, None] + np.arange(horizon), ends[:, None])
    return motion_between(actions[window], poses[:, None, :ACTION_DIM]).numpy()
