"""Conversion of normalised states and actions to metres, to relate clouds and poses."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import ACTION, POINT_CLOUD, STATE, Statistics
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig

RELATIVE_SCALE = 0.15
"""Unit of positions relative to the tool [m]: the length of a typical key frame."""


class PoseFrames(nn.Module):
    """Constants of the normalisation, from dataset statistics when training starts; saved with the checkpoint."""

    cloud_center: Tensor
    cloud_scale: Tensor
    state_center: Tensor
    state_half: Tensor
    action_center: Tensor
    action_half: Tensor

    def __init__(self, config: DP3AdaptiveConfig, stats: Statistics | None) -> None:
        super().__init__()
        self.relative = bool(config.tcp_relative) and config.has_pose_layout
        self.register_buffer("cloud_scale", torch.ones(1))
        for name in ("cloud", "state", "action"):
            self.register_buffer(f"{name}_center", torch.zeros(3))
        for name in ("state", "action"):
            self.register_buffer(f"{name}_half", torch.ones(3))
        if stats and POINT_CLOUD in stats:
            bounds = (torch.as_tensor(stats[POINT_CLOUD][name], dtype=torch.float32) for name in ("min", "max"))
            lower, upper = (as_points(each).reshape(-1, 3) for each in bounds)
            lower, upper = lower.amin(dim=0), upper.amax(dim=0)
            self.cloud_center.copy_((lower + upper) / 2)
            self.cloud_scale.copy_(((upper - lower) / 2).max().clamp(min=1e-3))
        self.set_pose_statistics(stats)

    def set_pose_statistics(self, stats: Statistics | None) -> None:
        """Sets the ranges of positions; they must equal those of the processors' MIN_MAX."""
        if not stats or not self.relative:
            return
        for key, name in ((STATE, "state"), (ACTION, "action")):
            lower, upper = _range(stats, key)
            center, half = getattr(self, f"{name}_center"), getattr(self, f"{name}_half")
            center.copy_((lower + upper) / 2)
            # As LeRobot does: a range of zero becomes 1e-8, in float32.
            half.copy_(torch.where(upper == lower, torch.full_like(upper, 1e-8), upper - lower) / 2)

    @property
    def point_dim(self) -> int:
        """Number of values per point."""
        return 6 if self.relative else 3

    def tcp(self, state: Tensor) -> Tensor:
        """Converts normalised states (..., D) to tool positions (..., 3) [m]."""
        return state[..., :3] * self.state_half + self.state_center

    def points(self, cloud: Tensor, state: Tensor) -> Tensor:
        """(B, S, N, 3) [m] -> (B, S, N, 3 or 6): centred and scaled, and relative to the tool."""
        centred = (cloud - self.cloud_center) / self.cloud_scale
        if not self.relative:
            return centred
        return torch.cat([centred, (cloud - self.tcp(state)[..., None, :]) / RELATIVE_SCALE], dim=-1)

    def to_relative(self, actions: Tensor, state: Tensor) -> Tensor:
        """Converts positions of normalised actions (B, T, A) to positions relative to the tool of ``state`` (B, D)."""
        if not self.relative:
            return actions
        position = actions[..., :3] * self.action_half + self.action_center
        return torch.cat([(position - self.tcp(state)[:, None]) / RELATIVE_SCALE, actions[..., 3:]], dim=-1)

    def to_absolute(self, actions: Tensor, state: Tensor) -> Tensor:
        """Inverts `to_relative`."""
        if not self.relative:
            return actions
        position = actions[..., :3] * RELATIVE_SCALE + self.tcp(state)[:, None]
        return torch.cat([(position - self.action_center) / self.action_half, actions[..., 3:]], dim=-1)


def _range(stats: Statistics, key: str) -> tuple[Tensor, Tensor]:
    lower, upper = (torch.as_tensor(stats[key][name], dtype=torch.float32).reshape(-1)[:3] for name in ("min", "max"))
    return lower, upper
