"""Modules of ``adaafford``: summary of interactions, success, information, their maps, and an actor."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.adaafford.configuration_adaafford import AdaAffordConfig
from lerobot_policy_adamanip.affordance.networks import ConditionalVAE, PlaceFeatures, Score
from lerobot_policy_adamanip.affordance.plans import GRASP_DIM, decode_grasp, encode_grasp
from lerobot_policy_adamanip.common.contacts import EVENT_DIM, Past
from lerobot_policy_adamanip.common.geometry import (
    MOTION_DIM,
    MOTION_UNITS,
    constant,
    motion_between,
    pose_after,
    with_gripper,
)

ACTION_NUMBERS = 6 + MOTION_DIM - 1
"""An action in contact: the tool's rotation 6D, and its goal in the tool's frame."""
PROPOSAL_NUMBERS = GRASP_DIM + MOTION_DIM - 1
"""A proposal: a grasp at a place, and the tool's goal from there."""
ORDER_UNIT = 16.0
"""Unit of an interaction's number in its token; without the number a weighted mean would lose the order."""


@dataclass(frozen=True)
class Interactions:
    """Interactions (B, K) as tensors, see `InteractionLabels`; entries that are not ``valid`` are padding."""

    before: Tensor
    command: Tensor
    after: Tensor
    opening: Tensor
    moved: Tensor
    tried: Tensor
    valid: Tensor


@dataclass(frozen=True)
class NegativeActions:
    """Actions away from any demonstrated contact.

    Attributes:
        places: (B, E, 3) [m] of the tool.
        actions: (B, E, 12) of `action_numbers`.
        valid: (B, E) bool, whether the place is away from contacts.
    """

    places: Tensor
    actions: Tensor
    valid: Tensor


def trim_padding(numbers: Tensor) -> Tensor:
    """Removes the columns of (B, K) that are padding (-1) in every row; keeps at least one column."""
    longest = int((numbers >= 0).sum(dim=1).amax())
    return numbers[:, : max(1, longest)]


def action_numbers(before: Tensor, command: Tensor) -> Tensor:
    """Converts tool poses (..., 10) and their goals (..., 10) to actions (..., 12)."""
    motion = motion_between(command, before)[..., :6]
    return torch.cat([before[..., ROTATION_DIMS], motion / constant(MOTION_UNITS[:6], motion)], dim=-1)


def encode_proposal(before: Tensor, command: Tensor, opening: Tensor, place: Tensor) -> Tensor:
    """Converts actions at places (B, 3) [m], with the approach's ``opening`` (B,), to proposals (B, 16)."""
    grasp = torch.cat([before[..., :9], opening[..., None]], dim=-1)
    return torch.cat([encode_grasp(grasp, place), action_numbers(before, command)[..., 6:]], dim=-1)


def decode_proposal(code: Tensor, place: Tensor) -> tuple[Tensor, Tensor]:
    """Inverts `encode_proposal`: any numbers (..., 16) at places (..., 3) -> grasps and their goals, (..., 10) each."""
    grasp = decode_grasp(code[..., :GRASP_DIM], place)
    return grasp, goal_of(grasp, code[..., GRASP_DIM:])


def goal_of(pose: Tensor, motion: Tensor) -> Tensor:
    """Returns the goals (..., 10), fingers closed, of tools (..., 10) moved by motions (..., 6) in their units."""
    motion = motion * constant(MOTION_UNITS[:6], motion)
    return pose_after(torch.cat([motion, torch.zeros_like(motion[..., :1])], dim=-1), with_gripper(pose, 0.0))


class AdaAffordNetwork(nn.Module):
    """All modules. Success and information share the features of places; the actor and the maps have their own."""

    def __init__(self, config: AdaAffordConfig) -> None:
        super().__init__()
        self.config = config
        features, hidden = config.feature_dim, config.hidden_dim
        self.features, self.actor_features, self.map_features = (PlaceFeatures(config) for _ in range(3))
        token = 6 + EVENT_DIM + features
        self.embedding = nn.Sequential(nn.Linear(token, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU())
        self.conclusion = nn.Linear(128, hidden)
        self.attention = nn.Sequential(nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 1))
        self.success = Score(ACTION_NUMBERS, features + hidden)
        self.information = Score(ACTION_NUMBERS + 1, features + hidden)
        self.success_map = Score(0, features + hidden)
        self.information_map = Score(0, features + hidden + 1)
        self.actor = ConditionalVAE(PROPOSAL_NUMBERS, features, config.latent_dim)

    def tokens(self, before: Tensor, command: Tensor, after: Tensor) -> Tensor:
        """Returns tokens (B, H, 22) of interactions: action, result and number, from poses (B, H, 10) each."""
        # Each interaction is a past of length one; the last number of its event is validity.
        poses, valid = torch.stack([before, after], dim=-2), torch.ones_like(before[..., :1], dtype=torch.bool)
        happened = Past(command.flatten(0, 1)[:, None], poses.flatten(0, 1), valid.flatten(0, 1)).events()
        happened = happened[:, 0, :-1].unflatten(0, before.shape[:2])  # type: ignore[no-untyped-call]
        number = torch.arange(before.shape[1], device=before.device).expand(before.shape[:2])[..., None] / ORDER_UNIT
        return torch.cat([before[..., ROTATION_DIMS], happened, number.to(before.dtype)], dim=-1)

    def summary(self, tokens: Tensor, features: Tensor, valid: Tensor) -> Tensor:
        """Returns z (B, Z): the mean of interactions weighted by attention; zero if there are none.

        Args:
            tokens: (B, H, 22) of `tokens`.
            features: (B, H, F) of their places.
            valid: (B, H) bool.
        """
        embedded = self.embedding(torch.cat([tokens, features], dim=-1))
        weights = self.attention(embedded).sigmoid() * valid[..., None]
        mean: Tensor = (weights * self.conclusion(embedded)).sum(dim=1) / (1e-5 + weights.sum(dim=1))
        return mean

    def success_logits(self, features: Tensor, z: Tensor, actions: Tensor) -> Tensor:
        """Returns logits (B, K) of C: actions (B, K, 12) at places with features (B, K, F), given z (B, Z)."""
        logits: Tensor = self.success(_join(features, z), actions)
        return logits

    def predicted_information(self, features: Tensor, z: Tensor, actions: Tensor, likely: Tensor) -> Tensor:
        """Returns G (B, K) [nats] of actions (B, K, 12), given their success ``likely`` (B, K) from C."""
        information: Tensor = self.information(_join(features, z), torch.cat([actions, likely[..., None]], dim=-1))
        return information

    def maps(self, cloud: Tensor, places: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the maps at places (B, Q, 3): logits of success, and success plus information, (B, Q) each."""
        joined = _join(self.map_features(cloud, places), z)
        success = self.success_map(joined)
        likely = success.detach().sigmoid()[..., None]
        return success, self.information_map(torch.cat([joined, likely], dim=-1))

    @torch.no_grad()
    def proposals(self, cloud: Tensor, places: Tensor, count: int) -> tuple[Tensor, Tensor]:
        """Returns the actor's proposals at places (B, Q, 3): grasps and their goals (B, Q, count, 10) each."""
        codes = self.actor.proposals(self.actor_features(cloud, places), count)
        return decode_proposal(codes, places[..., None, :])

    @torch.no_grad()
    def scores(self, cloud: Tensor, z: Tensor, before: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """Returns C in [0, 1] and G of actions: poses (B, K, 10) and their goals (B, K, 10) -> (B, K) each."""
        features, actions = self.features(cloud, before[..., POSITION_DIMS]), action_numbers(before, command)
        likely = self.success_logits(features, z, actions).sigmoid()
        return likely, self.predicted_information(features, z, actions, likely)


def _join(features: Tensor, z: Tensor) -> Tensor:
    """Features (B, K, F), z (B, Z) -> (B, K, F + Z)."""
    return torch.cat([features, z[:, None].expand(-1, features.shape[1], -1)], dim=-1)
