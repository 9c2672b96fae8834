"""Networks of the point-level methods (Where2Act's family): features of places in a cloud, proposals, scores.

Published are a PointNet++ on 10,000 points per module and some eighty epochs on a GPU. On two CPU cores: the cloud as a
whole by a PointNet, and each place that is asked for by the points around it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from lerobot_policy_adamanip.affordance.config import AffordanceConfig
from lerobot_policy_adamanip.common.encoders import PatchEncoder, PointNetEncoder

CLOUD_UNIT, PLACE_UNIT = 0.15, 0.05
"""Distances of points, and of places, from a cloud's middle are given in these units [m]."""


class PlaceFeatures(nn.Module):
    """Features of places in a cloud (VAT-Mart's f_p): what is around them, what the cloud is, and where in it they are.

    Shifting cloud and places together changes nothing.

    Args:
        config: says how many first points tell what the cloud is (a cloud is farthest-point ordered), how far and how
            many points are around a place, and how many features it has.
    """

    def __init__(self, config: AffordanceConfig) -> None:
        super().__init__()
        out_dim, self.context_points = config.feature_dim, config.context_points
        self.whole = PointNetEncoder(3, config.encoder_dims, out_dim)
        self.around = PatchEncoder(config.patch_radius, config.patch_points, (64, out_dim))
        self.where = nn.Linear(3, out_dim)
        self.join = nn.Sequential(
            nn.Linear(3 * out_dim, out_dim), nn.LayerNorm(out_dim), nn.ReLU(), nn.Linear(out_dim, out_dim)
        )

    def forward(self, cloud: Tensor, places: Tensor) -> Tensor:
        """Clouds (B, N, 3) [m], places (B, Q, 3) [m] -> (B, Q, out_dim)."""
        context = cloud[:, : self.context_points]
        middle = context.mean(dim=1, keepdim=True)
        whole = self.whole((context - middle) / CLOUD_UNIT)[:, None].expand(-1, places.shape[1], -1)
        where = self.where((places - middle) / PLACE_UNIT)
        # Where the place is goes past the normalisation: a grasp's offset is a straight function of it.
        features: Tensor = self.join(torch.cat([self.around(cloud, places), whole, where], dim=-1)) + where
        return features


class Score(nn.Module):
    """One number from what describes an action (its own first layer) and what it is judged by.

    Args:
        described: numbers of the action; 0 for a score of the place alone.
        given: numbers that it is judged by.
    """

    def __init__(self, described: int, given: int) -> None:
        super().__init__()
        self.action = nn.Linear(described, 256) if described else None
        width = given + (256 if described else 0)
        self.out = nn.Sequential(
            nn.Linear(width, 128), nn.LeakyReLU(), nn.Linear(128, 128), nn.LeakyReLU(), nn.Linear(128, 1)
        )

    def forward(self, given: Tensor, action: Tensor | None = None) -> Tensor:
        """(..., given), (..., described) -> logits (...)."""
        parts = [given] if self.action is None or action is None else [self.action(action), given]
        logits: Tensor = self.out(torch.cat(parts, dim=-1))
        return logits.squeeze(-1)


class ConditionalVAE(nn.Module):
    """A conditional variational autoencoder (Sohn et al. 2015) of actions: proposals at a place.

    Args:
        numbers: of an action.
        given: features that it is conditioned on.
        latent: size of what tells actions at one place apart.
    """

    def __init__(self, numbers: int, given: int, latent: int) -> None:
        super().__init__()
        self.latent = latent
        self.encoder = nn.Sequential(
            nn.Linear(numbers + given, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, 2 * latent)
        )
        self.decoder = nn.Sequential(
            nn.Linear(latent + given, 512), nn.ReLU(), nn.Linear(512, 256), nn.ReLU(), nn.Linear(256, numbers)
        )

    def forward(self, actions: Tensor, given: Tensor) -> tuple[Tensor, Tensor]:
        """(B, numbers), (B, given) -> reconstructed actions (B, numbers) and the prior's divergence (B,)."""
        mean, log_variance = self.encoder(torch.cat([actions, given], dim=-1)).chunk(2, dim=-1)
        latent = mean + (0.5 * log_variance).exp() * torch.randn_like(mean)
        divergence = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(dim=-1)
        return self.decode(latent, given), divergence

    def decode(self, latent: Tensor, given: Tensor) -> Tensor:
        """(..., latent), (..., given) -> actions (..., numbers)."""
        decoded: Tensor = self.decoder(torch.cat([latent, given], dim=-1))
        return decoded

    def proposals(self, given: Tensor, count: int, noise: Tensor | None = None) -> Tensor:
        """Draws actions (..., count, numbers) for features (..., given), from noise (..., count, latent) if given."""
        wanted = given[..., None, :].expand(*given.shape[:-1], count, given.shape[-1])
        if noise is None:
            noise = torch.randn(*wanted.shape[:-1], self.latent, device=given.device, dtype=given.dtype)
        return self.decode(noise, wanted)


def scores_of_points(score: Callable[[Tensor, Tensor], Tensor], cloud: Tensor) -> Tensor:
    """Returns what ``score(cloud, places)`` says of each point of clouds (B, N, 3) [m] -> (B, N).

    One cloud at a time: what is around all points of a batch of them is a gigabyte.
    """
    return torch.cat([score(one, one) for one in torch.split(cloud, 1)])


def mean_of_best(scores: Tensor, count: int) -> Tensor:
    """Returns the mean of the ``count`` largest scores. (..., K) -> (...)."""
    return scores.topk(min(count, scores.shape[-1]), dim=-1).values.mean(dim=-1)


def point_near(cloud: Tensor, place: Tensor, radius: float) -> Tensor:
    """Draws a point (B, 3) of each cloud (B, N, 3) [m] within a radius of a place (B, 3); the nearest if none is."""
    distance = (cloud - place[:, None]).norm(dim=-1)
    preferred = torch.where(distance <= radius, torch.rand_like(distance), -distance).argmax(dim=1)
    return cloud[torch.arange(len(cloud), device=cloud.device), preferred]


def points_away(cloud: Tensor, places: Tensor, distance: float, count: int) -> Tensor:
    """Draws points (B, count, 3) of each cloud (B, N, 3) [m] beyond a distance from all of its places (B, C, 3).

    Of a cloud that has too few of them, others.
    """
    beyond = (torch.cdist(cloud, places) > distance).all(dim=-1)
    chosen = (torch.rand_like(cloud[..., 0]) + beyond).topk(count, dim=1).indices
    return cloud.gather(1, chosen[..., None].expand(-1, -1, 3))
