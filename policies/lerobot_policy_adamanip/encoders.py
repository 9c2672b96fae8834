"""Point-cloud encoders in plain torch: DP3's PointNet and a PointNet++ (no compiled extension is needed)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn


def _mlp(dims: Sequence[int]) -> nn.Sequential:
    """Linear, LayerNorm, ReLU per width. LayerNorm, not BatchNorm: statistics of a batch do not suit EMA weights."""
    layers: list[nn.Module] = []
    for first, second in itertools.pairwise(dims):
        layers += [nn.Linear(first, second), nn.LayerNorm(second), nn.ReLU()]
    return nn.Sequential(*layers)


class PointNetEncoder(nn.Module):
    """DP3's encoder: a shared MLP, the maximum over points, a projection. Order of points does not matter.

    Args:
        in_dim: numbers per point.
        dims: widths of the MLP.
        out_dim: features of a cloud.
    """

    def __init__(self, in_dim: int, dims: Sequence[int], out_dim: int) -> None:
        super().__init__()
        self.mlp = _mlp((in_dim, *dims))
        self.projection = nn.Sequential(nn.Linear(dims[-1], out_dim), nn.LayerNorm(out_dim))

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, in_dim) -> (B, out_dim)."""
        projected: Tensor = self.projection(self.mlp(points).amax(dim=-2))
        return projected


MAX_DISTANCES = 2**27
"""Distances held at once while looking for neighbours: half a gigabyte. A training batch of the paper has 2^30."""


@torch.no_grad()
def ball_query(centres: Tensor, xyz: Tensor, radius: float, neighbours: int) -> Tensor:
    """Returns the nearest points within a radius of centres. (B, C, 3), (B, N, 3) -> indices (B, C, neighbours).

    Where fewer are within the radius, the nearest (the centre itself, if it is a point) stands in for the rest.
    """
    rows = max(1, MAX_DISTANCES // (centres.shape[1] * xyz.shape[1]))
    found = []
    for start in range(0, len(xyz), rows):
        part, cloud = centres[start : start + rows].float(), xyz[start : start + rows].float()
        # Differences, not the inner-product form: that one loses a centre's distance to itself in rounding.
        distance = torch.cdist(part, cloud, compute_mode="donot_use_mm_for_euclid_dist")
        nearest, index = distance.topk(min(neighbours, cloud.shape[1]), dim=-1, largest=False)
        found.append(torch.where(nearest <= radius, index, index[..., :1]))
    return torch.cat(found)


class SetAbstraction(nn.Module):
    """One level of PointNet++ (Qi et al. 2017): centres, their neighbours within a radius, a PointNet on each group.

    Clouds come farthest-point ordered, so the first points *are* the farthest-point sample that the paper computes.

    Args:
        centres: how many.
        radius: of a group, in the encoder's units.
        neighbours: at most per group.
        in_dim: features per point, without its coordinates.
        dims: widths of the group's MLP.
    """

    def __init__(self, centres: int, radius: float, neighbours: int, in_dim: int, dims: Sequence[int]) -> None:
        super().__init__()
        self.centres, self.radius, self.neighbours = centres, radius, neighbours
        self.mlp = _mlp((in_dim + 3, *dims))

    def forward(self, xyz: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, 3), (B, N, in_dim) -> (B, centres, 3), (B, centres, dims[-1])."""
        centres = xyz[:, : self.centres]
        index = ball_query(centres, xyz, self.radius, self.neighbours)
        batch = torch.arange(xyz.shape[0], device=xyz.device)[:, None, None]
        grouped = torch.cat([(xyz[batch, index] - centres[:, :, None]) / self.radius, features[batch, index]], dim=-1)
        return centres, self.mlp(grouped).amax(dim=-2)


class PointNet2Encoder(nn.Module):
    """PointNet++, single-scale grouping, then the maximum over what is left.

    Centres, group sizes and widths are those of the paper's code at 4096 points, and so are the radii, in units of the
    scaled cloud. Its segmentation decoder, whose output at point 0 it took for the cloud's feature, is replaced by
    pooling.

    Args:
        in_dim: numbers per point, coordinates first.
        dims: output width of each level.
        out_dim: features of a cloud.
        num_points: of a cloud.
    """

    def __init__(self, in_dim: int, dims: Sequence[int], out_dim: int, num_points: int) -> None:
        super().__init__()
        levels, features = [], in_dim
        for level, width in enumerate(dims):
            centres = max(8, num_points // 4 ** (level + 1))
            hidden = max(32, width // 2)
            levels.append(SetAbstraction(centres, 0.1 * 2**level, 32, features, (hidden, hidden, width)))
            features = width
        self.levels = nn.ModuleList(levels)
        self.projection = nn.Sequential(nn.Linear(features, out_dim), nn.LayerNorm(out_dim))

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, in_dim) -> (B, out_dim)."""
        xyz, features = points[..., :3], points
        for level in self.levels:
            xyz, features = level(xyz, features)
        projected: Tensor = self.projection(features.amax(dim=-2))
        return projected


def make_encoder(name: str, in_dim: int, dims: Sequence[int], out_dim: int, num_points: int) -> nn.Module:
    """Returns the encoder ``mlp`` or ``pointnet2``."""
    if name == "mlp":
        return PointNetEncoder(in_dim, dims, out_dim)
    return PointNet2Encoder(in_dim, dims, out_dim, num_points)
