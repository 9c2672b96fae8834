"""Centre and scale of clouds, for the presets that see them in the robot's base frame."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import POINT_CLOUD, Statistics


class CloudUnits(nn.Module):
    """Constants from the dataset's statistics when training starts; saved with the checkpoint, which needs them."""

    center: Tensor
    scale: Tensor

    def __init__(self, stats: Statistics | None) -> None:
        super().__init__()
        self.register_buffer("center", torch.zeros(3))
        self.register_buffer("scale", torch.ones(1))
        if stats and POINT_CLOUD in stats:
            bounds = (torch.as_tensor(stats[POINT_CLOUD][name], dtype=torch.float32) for name in ("min", "max"))
            lower, upper = (as_points(each).reshape(-1, 3) for each in bounds)
            lower, upper = lower.amin(dim=0), upper.amax(dim=0)
            self.center.copy_((lower + upper) / 2)
            self.scale.copy_(((upper - lower) / 2).max().clamp(min=1e-3))

    def forward(self, cloud: Tensor) -> Tensor:
        """Clouds (..., 3) [m] -> (..., 3), centred and scaled."""
        return (cloud - self.center) / self.scale
