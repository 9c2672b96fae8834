"""The modules of ``adaafford``: conclusions from interactions, success given them, information, maps, and an actor."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.adaafford.configuration_adaafford import AdaAffordConfig
from lerobot_policy_adamanip.affordance.networks import ConditionalVAE, PlaceFeatures, Score
from lerobot_policy_adamanip.affordance.plans import GRASP_DIM, decode_grasp, encode_grasp, with_gripper
from lerobot_policy_adamanip.common.events import EVENT_DIM, events
from lerobot_policy_adamanip.common.tool_frame import MOTION_DIM, MOTION_UNITS, constant, motion_between, pose_after

ACTION_NUMBERS = 6 + MOTION_DIM - 1
"""An action in contact: the tool's rotation 6D, and where it is sent as it sees it."""
PROPOSAL_NUMBERS = GRASP_DIM + MOTION_DIM - 1
"""A proposal: a grasp at a place, and where the tool is sent from there."""
ORDER = 16.0
"""Interactions are numbered in this unit: a weighted mean forgets their order."""


def action_numbers(before: Tensor, command: Tensor) -> Tensor:
    """Tool poses (..., 10) and where they are sent (..., 10) -> what describes an action (..., 12)."""
    motion = motion_between(command, before)[..., :6]
    return torch.cat([before[..., ROTATION_DIMS], motion / constant(MOTION_UNITS[:6], motion)], dim=-1)


def encode_proposal(before: Tensor, command: Tensor, opening: Tensor, place: Tensor) -> Tensor:
    """Actions as proposals at places (B, 3) [m]; ``opening`` (B,) is what the part is approached with. -> (B, 16)."""
    grasp = torch.cat([before[..., :9], opening[..., None]], dim=-1)
    return torch.cat([encode_grasp(grasp, place), action_numbers(before, command)[..., 6:]], dim=-1)


def decode_proposal(code: Tensor, place: Tensor) -> tuple[Tensor, Tensor]:
    """The inverse: any numbers (..., 16) at places (..., 3) -> grasps, and where they are sent, (..., 10) each."""
    grasp = decode_grasp(code[..., :GRASP_DIM], place)
    return grasp, sent_from(grasp, code[..., GRASP_DIM:])


def sent_from(pose: Tensor, motion: Tensor) -> Tensor:
    """Returns where tools (..., 10) are sent by motions (..., 6) in their units, closed: (..., 10)."""
    motion = motion * constant(MOTION_UNITS[:6], motion)
    return pose_after(torch.cat([motion, torch.zeros_like(motion[..., :1])], dim=-1), with_gripper(pose, 0.0))


class AdaAffordNetwork(nn.Module):
    """All modules. Those that decide about success share features of places; the actor and the maps have their own.

    Args:
        config: of the policy.
    """

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
        """What was done and felt, and when: poses (B, H, 10) before, sent, and reached -> (B, H, 22)."""
        # Each is a history of one to `events`; the last of its numbers says that there is one.
        poses, valid = torch.stack([before, after], dim=-2), torch.ones_like(before[..., :1], dtype=torch.bool)
        told = events(command.flatten(0, 1)[:, None], poses.flatten(0, 1), valid.flatten(0, 1))
        happened = told[:, 0, :-1].unflatten(0, before.shape[:2])  # type: ignore[no-untyped-call]
        when = torch.arange(before.shape[1], device=before.device).expand(before.shape[:2])[..., None] / ORDER
        return torch.cat([before[..., ROTATION_DIMS], happened, when.to(before.dtype)], dim=-1)

    def concluded(self, tokens: Tensor, features: Tensor, valid: Tensor) -> Tensor:
        """Returns z (B, Z): the mean of what interactions tell, weighted by attention; zero if there are none.

        Args:
            tokens: (B, H, 22) of `tokens`.
            features: (B, H, F) of the places where they happened.
            valid: (B, H) bool; others count for nothing.
        """
        embedded = self.embedding(torch.cat([tokens, features], dim=-1))
        weights = self.attention(embedded).sigmoid() * valid[..., None]
        mean: Tensor = (weights * self.conclusion(embedded)).sum(dim=1) / (1e-5 + weights.sum(dim=1))
        return mean

    def succeeds(self, features: Tensor, z: Tensor, actions: Tensor) -> Tensor:
        """Returns logits (B, K) of C: actions (B, K, 12) at places with features (B, K, F), given z (B, Z)."""
        logits: Tensor = self.success(_joined(features, z), actions)
        return logits

    def informs(self, features: Tensor, z: Tensor, actions: Tensor, likely: Tensor) -> Tensor:
        """Returns G (B, K) [nats]: what actions (B, K, 12) would tell, that succeed as ``likely`` (B, K) as C says."""
        described = torch.cat([actions, likely[..., None]], dim=-1)
        told: Tensor = self.information(_joined(features, z), described)
        return told

    def mapped(self, cloud: Tensor, places: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the maps at places (B, Q, 3): success in logits (B, Q), success and information together (B, Q)."""
        given = _joined(self.map_features(cloud, places), z)
        success = self.success_map(given)
        likely = success.detach().sigmoid()[..., None]
        return success, self.information_map(torch.cat([given, likely], dim=-1))

    @torch.no_grad()
    def proposals(self, cloud: Tensor, places: Tensor, count: int) -> tuple[Tensor, Tensor]:
        """Returns what the actor proposes at places (B, Q, 3): grasps and where to (B, Q, count, 10) each."""
        codes = self.actor.proposals(self.actor_features(cloud, places), count)
        return decode_proposal(codes, places[..., None, :])

    @torch.no_grad()
    def judged(self, cloud: Tensor, z: Tensor, before: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """Returns C in [0, 1] and G of actions: poses (B, K, 10), where they are sent (B, K, 10) -> (B, K) each."""
        features, actions = self.features(cloud, before[..., POSITION_DIMS]), action_numbers(before, command)
        likely = self.succeeds(features, z, actions).sigmoid()
        return likely, self.informs(features, z, actions, likely)


def _joined(features: Tensor, z: Tensor) -> Tensor:
    """Features (B, K, F) with z (B, Z) beside each."""
    return torch.cat([features, z[:, None].expand(-1, features.shape[1], -1)], dim=-1)
