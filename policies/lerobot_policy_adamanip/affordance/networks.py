"""Networks of the point-level methods (Where2Act's family): features of places in a cloud, proposals, scores.

One PointNet encodes the whole cloud, another one each place, instead of the papers' PointNet++ on 10,000 points.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from lerobot_policy_adamanip.affordance.config import AffordanceConfig
from lerobot_policy_adamanip.common.encoders import PatchEncoder, PointNetEncoder

CLOUD_UNIT, PLACE_UNIT = 0.15, 0.05
"""Units of points, and of places relative to the cloud's centre [m]."""


class PlaceFeatures(nn.Module):
    """Features of places in a cloud (VAT-Mart's f_p): their surroundings, the whole cloud, and their position in it.

    The features are invariant to a common shift of cloud and places.
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
        """Returns features (B, Q, out_dim) of places (B, Q, 3) [m] in clouds (B, N, 3) [m]."""
        context = cloud[:, : self.context_points]
        middle = context.mean(dim=1, keepdim=True)
        whole = self.whole((context - middle) / CLOUD_UNIT)[:, None].expand(-1, places.shape[1], -1)
        where = self.where((places - middle) / PLACE_UNIT)
        # The position bypasses the normalisation: a grasp's offset is a linear function of it.
        features: Tensor = self.join(torch.cat([self.around(cloud, places), whole, where], dim=-1)) + where
        return features


class Score(nn.Module):
    """Score of an action at a place; of the place alone if ``action_dim`` is 0."""

    def __init__(self, action_dim: int, features: int) -> None:
        super().__init__()
        self.action = nn.Linear(action_dim, 256) if action_dim else None
        width = features + (256 if action_dim else 0)
        self.out = nn.Sequential(
            nn.Linear(width, 128), nn.LeakyReLU(), nn.Linear(128, 128), nn.LeakyReLU(), nn.Linear(128, 1)
        )

    def forward(self, features: Tensor, action: Tensor | None = None) -> Tensor:
        """(..., features), (..., action_dim) -> logits (...)."""
        parts = [features] if self.action is None or action is None else [self.action(action), features]
        logits: Tensor = self.out(torch.cat(parts, dim=-1))
        return logits.squeeze(-1)


class ConditionalVAE(nn.Module):
    """Conditional variational autoencoder (Sohn et al. 2015) that proposes actions at a place."""

    def __init__(self, action_dim: int, features: int, latent: int) -> None:
        super().__init__()
        self.latent = latent
        self.encoder = nn.Sequential(
            nn.Linear(action_dim + features, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, 2 * latent)
        )
        self.decoder = nn.Sequential(
            nn.Linear(latent + features, 512), nn.ReLU(), nn.Linear(512, 256), nn.ReLU(), nn.Linear(256, action_dim)
        )

    def forward(self, actions: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        """(B, action_dim), (B, features) -> reconstructed actions (B, action_dim), divergence from the prior (B,)."""
        mean, log_variance = self.encoder(torch.cat([actions, features], dim=-1)).chunk(2, dim=-1)
        latent = mean + (0.5 * log_variance).exp() * torch.randn_like(mean)
        divergence = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(dim=-1)
        return self.decode(latent, features), divergence

    def decode(self, latent: Tensor, features: Tensor) -> Tensor:
        """(..., latent), (..., features) -> actions (..., action_dim)."""
        decoded: Tensor = self.decoder(torch.cat([latent, features], dim=-1))
        return decoded

    def proposals(self, features: Tensor, count: int, noise: Tensor | None = None) -> Tensor:
        """Draws actions (..., count, action_dim) at places (..., features), from noise (..., count, latent)."""
        repeated = features[..., None, :].expand(*features.shape[:-1], count, features.shape[-1])
        if noise is None:
            noise = torch.randn(*repeated.shape[:-1], self.latent, device=features.device, dtype=features.dtype)
        return self.decode(noise, repeated)


def scores_of_points(score: Callable[[Tensor, Tensor], Tensor], cloud: Tensor) -> Tensor:
    """Returns ``score(cloud, places)`` of each point of clouds (B, N, 3) [m] -> (B, N).

    Processes one cloud at a time, because the surroundings of all points of a batch would take a gigabyte.
    """
    return torch.cat([score(one, one) for one in torch.split(cloud, 1)])


def mean_of_best(scores: Tensor, count: int) -> Tensor:
    """Returns the mean of the ``count`` largest scores. (..., K) -> (...)."""
    return scores.topk(min(count, scores.shape[-1]), dim=-1).values.mean(dim=-1)


def point_near(cloud: Tensor, place: Tensor, radius: float) -> Tensor:
    """Draws a point (B, 3) of each cloud (B, N, 3) [m] within a radius of a place (B, 3), else the nearest point."""
    distance = (cloud - place[:, None]).norm(dim=-1)
    preferred = torch.where(distance <= radius, torch.rand_like(distance), -distance).argmax(dim=1)
    return cloud[torch.arange(len(cloud), device=cloud.device), preferred]


def points_away(cloud: Tensor, places: Tensor, distance: float, count: int) -> Tensor:
    """Draws points (B, count, 3) of clouds (B, N, 3) [m], away from all places (B, C, 3) if possible."""
    beyond = (torch.cdist(cloud, places) > distance).all(dim=-1)
    chosen = (torch.rand_like(cloud[..., 0]) + beyond).topk(count, dim=1).indices
    return cloud.gather(1, chosen[..., None].expand(-1, -1, 3))
