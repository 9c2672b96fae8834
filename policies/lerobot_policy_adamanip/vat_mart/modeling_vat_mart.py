"""``vat_mart``: proposes grasps and trajectories, scores them, and executes the best. See the package."""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.affordance import networks
from lerobot_policy_adamanip.affordance.demonstrations import Demonstrations
from lerobot_policy_adamanip.affordance.losses import error_by_group, free_bits, logistic_loss, sum_losses, valid_rows
from lerobot_policy_adamanip.affordance.plans import (
    GRASP_DIM,
    GRASP_GROUPS,
    OFFSET_UNIT,
    PART_RADIUS_M,
    approach,
    decode_grasp,
    encode_grasp,
)
from lerobot_policy_adamanip.affordance.policy import AffordancePolicy
from lerobot_policy_adamanip.common.geometry import angle_between, matrix_from_6d, matrix_from_rotation_vector
from lerobot_policy_adamanip.common.inputs import INDEX
from lerobot_policy_adamanip.vat_mart.configuration_vat_mart import VatMartConfig
from lerobot_policy_adamanip.vat_mart.plan_labels import PlanLabels, label_plans

NEGATIVE_TURN_RAD, NEGATIVE_SHIFT_M = (0.2, 3.1), (0.01, 0.06)
"""Ranges of turns and shifts after which a grasp does not hold."""
WAYPOINT_GROUPS = (3, 6)
"""Sizes of a key frame's position and rotation."""
WAYPOINT_DIM = sum(WAYPOINT_GROUPS)
WAYPOINT_UNIT = 0.15
"""Unit of positions relative to the grasp [m]."""


class VatMartNetwork(nn.Module):
    """The three modules, each with features of its own."""

    def __init__(self, config: VatMartConfig) -> None:
        super().__init__()
        self.config = config
        numbers, features = GRASP_DIM + WAYPOINT_DIM * config.waypoints, config.feature_dim
        self.proposal_features, self.score_features, self.action_features = (
            networks.PlaceFeatures(config) for _ in range(3)
        )
        self.proposal = networks.ConditionalVAE(numbers, features, config.latent_dim)
        self.scorer = networks.Score(numbers, features)
        self.actionability = networks.Score(0, features)

    def proposal_loss(self, cloud: Tensor, place: Tensor, trajectory: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the loss ``KL + L1 + geodesic`` (B,), and the reconstructed trajectories (B, D).

        Inputs are demonstrated trajectories (B, D) with weights (B,), at places (B, 3) [m] of clouds (B, N, 3) [m].
        Positions and rotations of key frames have the same weight. The mean divergence has free bits (Kingma et al.
        2016), because no weight of the KL term works alone: if small, samples lie between demonstrations; if large,
        all samples are their mean.
        """
        config = self.config
        features = self.proposal_features(cloud, place[:, None]).squeeze(1)
        predicted, divergence = self.proposal(trajectory, features)
        grasp = error_by_group(predicted[:, :GRASP_DIM], trajectory[:, :GRASP_DIM], GRASP_GROUPS)
        motion = error_by_group(predicted[:, GRASP_DIM:], trajectory[:, GRASP_DIM:], WAYPOINT_GROUPS * config.waypoints)
        angle = config.rotation_weight * angle_between(predicted[:, :6], trajectory[:, :6])
        divergence = free_bits(divergence, weight, config.free_divergence)
        error = config.grasp_weight * grasp + motion + angle
        return error + config.divergence_weight * divergence, predicted.detach()

    def score(self, cloud: Tensor, places: Tensor, trajectories: Tensor) -> Tensor:
        """Returns logits (B, Q, ...) of C: trajectories (B, Q, ..., D) at places (B, Q, 3)."""
        features = self.score_features(cloud, places)
        for _ in range(trajectories.dim() - 3):
            features = features.unsqueeze(-2)
        return self.scorer(features.expand(*trajectories.shape[:-1], -1), trajectories)

    def actionable(self, cloud: Tensor, places: Tensor) -> Tensor:
        """Returns logits (B, Q) of D at places (B, Q, 3)."""
        return self.actionability(self.action_features(cloud, places))

    @torch.no_grad()
    def proposed(self, cloud: Tensor, places: Tensor, count: int, noise: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Returns ``count`` trajectories (B, Q, P, D) proposed at places (B, Q, 3), and C in [0, 1] of each."""
        trajectories = self.proposal.proposals(self.proposal_features(cloud, places), count, noise)
        return trajectories, self.score(cloud, places, trajectories).sigmoid()


class VatMartPolicy(AffordancePolicy):
    """LeRobot policy. Plans from an episode's first observation, and executes the plan open-loop."""

    config_class = VatMartConfig
    network_class = VatMartNetwork
    name = "vat_mart"

    def make_labels(self, demonstrations: Demonstrations) -> PlanLabels:
        """Returns the plans and their rows."""
        return label_plans(demonstrations, self.config.waypoints)

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Returns the sum of the three modules' losses, over the rows with a plan; see `sum_losses`."""
        labels, (cloud, _) = self.labels, self.observed(batch)
        plan = labels.plan_of[self.rows_of(batch)]
        rows = valid_rows(plan >= 0)
        cloud, plan, weight = cloud[rows], plan[rows].clamp(min=0), (plan[rows] >= 0).to(cloud.dtype)
        grasp, share = labels.grasps[plan], labels.share[plan]
        place = networks.point_near(cloud, grasp[:, POSITION_DIMS], PART_RADIUS_M)
        trajectory = encode_trajectory(grasp, labels.waypoints[plan], place)
        elsewhere = networks.points_away(cloud, grasp[:, None, POSITION_DIMS], PART_RADIUS_M, 1)
        places = torch.cat([place[:, None], elsewhere], dim=1)
        opening = weight * (share > 0)
        proposal, reconstructed = self.model.proposal_loss(cloud, place, trajectory, opening)
        # Scores both. Otherwise the scorer would learn to distinguish proposals from demonstrations.
        score = self._score_loss(cloud, places, trajectory, share) + self._score_loss(
            cloud, places, reconstructed, share
        )
        losses = {
            "proposal_loss": (proposal, opening),
            "score_loss": (score, weight),
            "actionability_loss": (self._actionability_loss(cloud, places), weight),
        }
        return sum_losses(losses, rows, len(batch[INDEX]), reduction)

    def _score_loss(self, cloud: Tensor, places: Tensor, trajectory: Tensor, share: Tensor) -> Tensor:
        """Returns ``BCE(C, success)`` (B,) of trajectories (B, D), and of negatives: perturbed grasps, other places."""
        candidates = torch.stack([trajectory, perturb_grasp(trajectory), trajectory], dim=1)
        logits = self.model.score(cloud, places[:, [0, 0, 1]], candidates)
        target = torch.stack([share, torch.zeros_like(share), torch.zeros_like(share)], dim=1)
        return logistic_loss(logits, target).mean(dim=1)

    def _actionability_loss(self, cloud: Tensor, places: Tensor) -> Tensor:
        """Returns ``BCE(D, mean of the best C)`` (B,) at places (B, Q, 3), without gradients of proposals and C.

        Most places open nothing. An absolute error would drive D to zero everywhere, where a sigmoid has no gradient.
        """
        _, scores = self.model.proposed(cloud, places, self.config.training_proposals)
        target = networks.mean_of_best(scores, self.config.best_proposals)
        return logistic_loss(self.model.actionable(cloud, places), target).mean(dim=1)

    def reset(self) -> None:
        """Drops the plan."""
        self._plan: list[Tensor] = []
        self._next = 0

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the plan's next key frame (B, 10); after its last one the tool stays.

        Only an episode's first observation is used; see `predict_action_chunk` for ``noise``.
        """
        if not self._plan:
            self._plan = list(self.predict_action_chunk(batch, noise).unbind(dim=1))
        action = self._plan[min(self._next, len(self._plan) - 1)]
        self._next += 1
        return action

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the plan (B, 3 + waypoints, 10) for an observation, without changing the state of the policy.

        Proposals are drawn from ``noise`` (B, 1, proposals, latent_dim) if given.
        """
        cloud, _ = self.observed(batch)
        rows = torch.arange(len(cloud), device=cloud.device)
        place = cloud[rows, networks.scores_of_points(self.model.actionable, cloud).argmax(dim=1)]
        trajectories, scores = self.model.proposed(cloud, place[:, None], self.config.proposals, noise)
        return key_frames(trajectories[rows, 0, scores[:, 0].argmax(dim=1)], place)


def perturb_grasp(trajectory: Tensor) -> Tensor:
    """Returns trajectories (B, D) whose grasps are turned or shifted at random, so that they do not hold."""
    like = trajectory[:, :1]
    turns = torch.rand_like(like) < 0.5
    axis, direction = (F.normalize(torch.randn_like(trajectory[:, :3]), dim=-1) for _ in range(2))
    angle, distance = (
        low + (high - low) * torch.rand_like(like) for low, high in (NEGATIVE_TURN_RAD, NEGATIVE_SHIFT_M)
    )
    turned = matrix_from_rotation_vector(angle * axis) @ matrix_from_6d(trajectory[:, :6])
    shifted = trajectory[:, 6:9] + distance * direction / OFFSET_UNIT
    return torch.cat(
        [
            torch.where(turns, turned[:, :2].flatten(1), trajectory[:, :6]),
            torch.where(turns, trajectory[:, 6:9], shifted),
            trajectory[:, 9:],
        ],
        dim=-1,
    )


def encode_trajectory(grasp: Tensor, waypoints: Tensor, place: Tensor) -> Tensor:
    """Grasps (..., 10), poses in contact (..., K, 10), places (..., 3) [m] -> (..., 10 + 9 K).

    Each pose gives its position relative to the grasp along the base's axes, and its rotation 6D relative to the grasp
    (a factor on the right).
    """
    shift = (waypoints[..., POSITION_DIMS] - grasp[..., None, POSITION_DIMS]) / WAYPOINT_UNIT
    held = matrix_from_6d(grasp[..., ROTATION_DIMS])[..., None, :, :]
    turn = held.transpose(-1, -2) @ matrix_from_6d(waypoints[..., ROTATION_DIMS])
    relative = torch.cat([shift, turn[..., :2, :].flatten(-2)], dim=-1)
    return torch.cat([encode_grasp(grasp, place), relative.flatten(-2)], dim=-1)


def key_frames(code: Tensor, place: Tensor) -> Tensor:
    """Inverts `encode_trajectory`: any numbers become a plan (..., 3 + K, 10), with closed fingers in contact.

    It is pre-grasp, grasp, fingers closed, and the poses in contact.
    """
    grasp = decode_grasp(code[..., :GRASP_DIM], place)
    relative = code[..., GRASP_DIM:].reshape(*code.shape[:-1], -1, WAYPOINT_DIM)
    held = matrix_from_6d(grasp[..., ROTATION_DIMS])[..., None, :, :]
    position = grasp[..., None, POSITION_DIMS] + WAYPOINT_UNIT * relative[..., :3]
    rotation = held @ matrix_from_6d(relative[..., 3:])
    closed = torch.zeros_like(position[..., :1])
    waypoints = torch.cat([position, rotation[..., :2, :].flatten(-2), closed], dim=-1)
    return torch.cat([approach(grasp), waypoints], dim=-2)
