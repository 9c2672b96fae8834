"""Point-cloud encoders in plain torch: DP3's PointNet and a PointNet++ (no compiled extension is needed)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn


def _mlp(dims: Sequence[int]) -> nn.Sequential:
    """Builds Linear, LayerNorm, ReLU per width. BatchNorm's statistics would not suit averaged weights."""
    layers: list[nn.Module] = []
    for first, second in itertools.pairwise(dims):
        layers += [nn.Linear(first, second), nn.LayerNorm(second), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


CACHED_ROWS = 5120
"""Number of points per MLP call without a graph: their activations fit a core's cache."""


def largest_rows(values: Tensor) -> Tensor:
    """Returns each channel's argmax over points. (B, N, C) -> (B, C).

    Searches the group first, then the point: torch's amax along points is twenty times faster than its argmax, and max,
    which also returns the index, four times.
    """
    points = values.shape[1]
    size = max(size for size in range(1, math.isqrt(points) + 1) if points % size == 0)
    groups = values.reshape(len(values), points // size, size, values.shape[2])
    group = groups.amax(dim=2).max(dim=1).indices
    chosen = group[:, None, None].expand(-1, 1, size, -1)
    return group * size + groups.gather(1, chosen).squeeze(1).max(dim=1).indices


class PointNetEncoder(nn.Module):
    """DP3's encoder: a shared MLP, the maximum over points, a projection. The order of points does not matter.

    Only winners, the points with a channel's maximum, get a gradient: at most a third of a cloud. In training on a CPU
    the cloud passes the MLP without a graph, then the winners pass with one. Of equal points only one gets the
    gradient; gradients of weights are the same. On a GPU finding the winners would synchronise, so all points pass with
    a graph.
    """

    def __init__(self, in_dim: int, dims: Sequence[int], out_dim: int) -> None:
        super().__init__()
        self.mlp = _mlp((in_dim, *dims))
        self.projection = nn.Sequential(nn.Linear(dims[-1], out_dim), nn.LayerNorm(out_dim))

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, in_dim) -> (B, out_dim)."""
        learning = self.training and torch.is_grad_enabled() and points.device.type == "cpu"
        pooled = self._maximum_of_winners(points) if learning else self.mlp(points).amax(dim=-2)
        projected: Tensor = self.projection(pooled)
        return projected

    def _maximum_of_winners(self, points: Tensor) -> Tensor:
        """Returns the maximum (B, C) over points (B, N, in_dim), with a graph of the winners only."""
        clouds, count = points.shape[:2]
        with torch.no_grad():
            winners = self._winners(points) + count * torch.arange(clouds, device=points.device)[:, None]
            won = torch.zeros(clouds * count, dtype=torch.bool, device=points.device)
            won[winners.flatten()] = True
            place = won.cumsum(dim=0) - 1
        rows: Tensor = self.mlp(points.flatten(0, 1)[won])
        return rows.gather(0, place[winners])

    def _winners(self, points: Tensor) -> Tensor:
        """Returns the winners' indices (B, C) of points (B, N, in_dim), without a graph."""
        kind = points.device.type
        # No cache: autocast would reuse weights that were cast without a graph and get no gradient.
        casting = torch.is_autocast_enabled(kind)
        dtype = torch.get_autocast_dtype(kind) if casting else None
        with torch.autocast(kind, dtype=dtype, enabled=casting, cache_enabled=False):
            pieces = torch.split(points, max(1, CACHED_ROWS // points.shape[1]))
            return torch.cat([largest_rows(self.mlp(piece)) for piece in pieces])


MAX_DISTANCES = 2**27
"""Largest number of distances in memory in `ball_query`: half a gigabyte. A training batch of the paper has 2^30."""


@torch.no_grad()
def ball_query(centres: Tensor, xyz: Tensor, radius: float, neighbours: int) -> Tensor:
    """Returns the nearest points within a radius of centres. (B, C, 3), (B, N, 3) -> indices (B, C, neighbours).

    If there are fewer, the nearest one (the centre, if it is a point) is repeated.
    """
    rows = max(1, MAX_DISTANCES // (centres.shape[1] * xyz.shape[1]))
    indices = []
    for start in range(0, len(xyz), rows):
        part, cloud = centres[start : start + rows].float(), xyz[start : start + rows].float()
        # Not the inner-product form: its rounding makes a centre's distance to itself nonzero.
        distance = torch.cdist(part, cloud, compute_mode="donot_use_mm_for_euclid_dist")
        nearest, index = distance.topk(min(neighbours, cloud.shape[1]), dim=-1, largest=False)
        indices.append(torch.where(nearest <= radius, index, index[..., :1]))
    return torch.cat(indices)


class SetAbstraction(nn.Module):
    """One level of PointNet++ (Qi et al. 2017): centres, their neighbours within a radius, a PointNet on each group.

    Clouds are in farthest-point order, so their first points equal the farthest-point sample of the paper.
    Radii are in the encoder's units; ``in_dim`` counts a point's features without its coordinates.
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
    """A PointNet on the nearest points, at most ``neighbours``, within ``radius`` [m] of any place."""

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
    """PointNet++ with single-scale grouping, then the maximum over points.

    Centres, groups, widths and radii (in units of the scaled cloud) are those of the paper's code at 4096 points. That
    code uses a segmentation decoder's output at point 0 as the cloud's feature; here features are pooled. The first
    three of a point's ``in_dim`` numbers are its coordinates.
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
