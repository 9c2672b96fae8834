"""Point-cloud encoders in plain torch: DP3's PointNet and a PointNet++ (no compiled extension is needed)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn


def _mlp(dims: Sequence[int]) -> nn.Sequential:
    """Linear, LayerNorm, ReLU per width. LayerNorm, not BatchNorm: statistics of a batch do not suit EMA weights."""
    layers: list[nn.Module] = []
    for first, second in itertools.pairwise(dims):
        layers += [nn.Linear(first, second), nn.LayerNorm(second), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


CACHED_ROWS = 5120
"""Points that go through the MLP at once where no graph is kept: their activations stay in a core's cache."""


def largest_rows(values: Tensor) -> Tensor:
    """Returns where each channel of each cloud is largest. (B, N, C) -> indices (B, C) of points.

    In two steps, first the group, then the point in it: torch finds a maximum along the points twenty times
    faster than its place.
    """
    points = values.shape[1]
    size = max(size for size in range(1, math.isqrt(points) + 1) if points % size == 0)
    groups = values.reshape(len(values), points // size, size, values.shape[2])
    group = groups.amax(dim=2).argmax(dim=1)
    chosen = group[:, None, None].expand(-1, 1, size, -1)
    return group * size + groups.gather(1, chosen).squeeze(1).argmax(dim=1)


class PointNetEncoder(nn.Module):
    """DP3's encoder: a shared MLP, the maximum over points, a projection. Order of points does not matter.

    The maximum hands its gradient to the points that won a channel, a third of a cloud or less, and LayerNorm knows
    one point at a time: no other point has a gradient. In training on a CPU the cloud therefore goes through the MLP
    without a graph, and the winners alone once more with one. Where two points are equal the gradient goes to one of
    them instead of half to each; what the weights receive is the same.

    On a GPU the plain way stays: which points won is not known without waiting for it, and one row per channel, which
    would not need to be known, is as many rows as points.

    Args:
        in_dim: numbers per point.
        dims: widths of the MLP.
        out_dim: features of a cloud.
    """

    winners_only: ClassVar[bool] = True
    """False takes the plain way in training, too: for comparison."""

    def __init__(self, in_dim: int, dims: Sequence[int], out_dim: int) -> None:
        super().__init__()
        self.mlp = _mlp((in_dim, *dims))
        self.projection = nn.Sequential(nn.Linear(dims[-1], out_dim), nn.LayerNorm(out_dim))

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, in_dim) -> (B, out_dim)."""
        learning = self.training and torch.is_grad_enabled() and points.device.type == "cpu"
        pooled = self._maximum_of_winners(points) if learning and self.winners_only else self.mlp(points).amax(dim=-2)
        projected: Tensor = self.projection(pooled)
        return projected

    def _maximum_of_winners(self, points: Tensor) -> Tensor:
        """(B, N, in_dim) -> (B, C): as the plain way, with a graph that holds the winners alone."""
        clouds, count = points.shape[:2]
        with torch.no_grad():
            winners = self._winners(points) + count * torch.arange(clouds, device=points.device)[:, None]
            won = torch.zeros(clouds * count, dtype=torch.bool, device=points.device)
            won[winners.flatten()] = True
            place = won.cumsum(dim=0) - 1
        rows: Tensor = self.mlp(points.flatten(0, 1)[won])
        return rows.gather(0, place[winners])

    def _winners(self, points: Tensor) -> Tensor:
        """(B, N, in_dim) -> indices (B, C) of points, without a graph."""
        kind = points.device.type
        # Autocast keeps the weights it has cast: those cast here would have no graph, and later no gradient.
        casting = torch.is_autocast_enabled(kind)
        dtype = torch.get_autocast_dtype(kind) if casting else None
        with torch.autocast(kind, dtype=dtype, enabled=casting, cache_enabled=False):
            pieces = torch.split(points, max(1, CACHED_ROWS // points.shape[1]))
            return torch.cat([largest_rows(self.mlp(piece)) for piece in pieces])


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


class PatchEncoder(nn.Module):
    """A PointNet on the points around a place, as one centre of a `SetAbstraction` whose place need not be a point.

    Args:
        radius: within which points are around it [m].
        neighbours: the nearest of them, at most.
        dims: widths of the MLP.
    """

    def __init__(self, radius: float, neighbours: int, dims: Sequence[int]) -> None:
        super().__init__()
        self.radius, self.neighbours = radius, neighbours
        self.mlp = _mlp((3, *dims))

    def forward(self, cloud: Tensor, places: Tensor) -> Tensor:
        """(B, N, 3) [m], (B, Q, 3) [m] -> (B, Q, dims[-1])."""
        index = ball_query(places, cloud, self.radius, self.neighbours)
        batch = torch.arange(len(cloud), device=cloud.device)[:, None, None]
        features: Tensor = self.mlp((cloud[batch, index] - places[:, :, None]) / self.radius).amax(dim=-2)
        return features


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
