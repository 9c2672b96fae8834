"""``adaafford``: chooses contacts and motions from the results of its own interactions. See the package."""

import copy
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_adamanip.contract.schema import POINT_CLOUD, POSITION_DIMS, STATE
from lerobot_policy_adamanip.adaafford.configuration_adaafford import AdaAffordConfig
from lerobot_policy_adamanip.adaafford.interactions import InteractionLabels, InteractionMemory, label_interactions
from lerobot_policy_adamanip.adaafford.network import (
    AdaAffordNetwork,
    Interactions,
    NegativeActions,
    action_numbers,
    encode_proposal,
    goal_of,
    trim_padding,
)
from lerobot_policy_adamanip.affordance import plans
from lerobot_policy_adamanip.affordance.demonstrations import Demonstrations
from lerobot_policy_adamanip.affordance.losses import (
    Weighted,
    error_by_group,
    free_bits,
    logistic_loss,
    sum_losses,
    valid_rows,
)
from lerobot_policy_adamanip.affordance.networks import mean_of_best, point_near, points_away
from lerobot_policy_adamanip.affordance.policy import AffordancePolicy
from lerobot_policy_adamanip.common.geometry import with_gripper
from lerobot_policy_adamanip.common.inputs import INDEX
from lerobot_policy_adamanip.common.policy import ChunkGuard

OFFSET = slice(plans.GRASP_GROUPS[0], plans.GRASP_GROUPS[0] + plans.GRASP_GROUPS[1])
"""Entries of a proposal that hold the offset of the tool from a place in the cloud."""
BEST_SUCCESSES, BEST_INFORMATION = 3, 5
"""Number of best proposals at a place; their mean is the target of each map."""


class AdaAffordPolicy(AffordancePolicy):
    """LeRobot policy. Its memory is its own interactions and their results."""

    config_class = AdaAffordConfig
    network_class = AdaAffordNetwork
    name = "adaafford"

    def make_labels(self, demonstrations: Demonstrations) -> InteractionLabels:
        """Returns the interactions that each row can learn from."""
        return label_interactions(demonstrations, self.config.num_interactions, self.config.num_candidates)

    # Training ---------------------------------------------------------------------------------------------------

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Returns the sum of the modules' losses over rows with known results of interactions; see `sum_losses`."""
        labels, (cloud, _) = self.labels, self.observed(batch)
        recorded = self.rows_of(batch)
        candidates = labels.candidates[recorded]
        rows = valid_rows(candidates[:, 0] >= 0)
        cloud, candidates, history = cloud[rows], candidates[rows], labels.history[recorded[rows]]
        weight = (candidates[:, 0] >= 0).to(cloud.dtype)
        known, past = self._interactions(trim_padding(candidates)), self._interactions(trim_padding(history))
        held = known.before[..., POSITION_DIMS]
        held = torch.where(known.valid[..., None], held, held[:, :1])  # the first one instead of padding
        elsewhere = points_away(cloud, held, plans.PART_RADIUS_M, 1)
        negatives = self._negatives(cloud, known, held, elsewhere)
        # In one call: each call encodes the whole cloud.
        places = torch.cat([past.before[..., POSITION_DIMS], held, negatives.places], dim=1)
        counts = [past.valid.shape[1], known.valid.shape[1], negatives.places.shape[1]]
        features = self.model.features(cloud, places).split(counts, dim=1)
        tokens = self.model.tokens(past.before, past.command, past.after)
        latest = past.valid.sum(dim=1, keepdim=True).clamp(min=1) - 1
        earlier = past.valid.scatter(1, latest, False)
        z, prefix = (self.model.summary(tokens, features[0], valid) for valid in (past.valid, earlier))
        errors = [self._success_error(known, features[1], each) for each in (z, prefix)]
        information = self._information_error(past, features[0], latest, prefix, errors[1] - errors[0])
        losses = {
            "success_loss": (errors[0] + errors[1], weight),
            "elsewhere_loss": (self._negative_error(negatives, features[2], z), weight),
            "information_loss": (information, weight * past.valid[:, 0]),
            "actor_loss": self._actor_error(cloud, known),
            "map_loss": (self._map_error(cloud, held, elsewhere, z.detach()), weight),
        }
        return sum_losses(losses, rows, len(batch[INDEX]), reduction)

    def _interactions(self, numbers: Tensor) -> Interactions:
        """Looks up interactions (B, K) by number; -1 is padding."""
        labels, valid, number = self.labels, numbers >= 0, numbers.clamp(min=0)
        poses = (each[number] for each in (labels.before, labels.command, labels.after))
        return Interactions(*poses, labels.opening[number], labels.moved[number], labels.tried[number] & valid, valid)

    def _success_error(self, known: Interactions, features: Tensor, z: Tensor) -> Tensor:
        """Returns ``BCE(C, moved)`` (B,), the mean over the interactions (B, K) with known results."""
        logits = self.model.success_logits(features, z, action_numbers(known.before, known.command))
        valid = known.valid.to(logits.dtype)
        return (logistic_loss(logits, known.moved) * valid).sum(dim=1) / valid.sum(dim=1).clamp(min=1)

    def _negatives(self, cloud: Tensor, known: Interactions, held: Tensor, elsewhere: Tensor) -> NegativeActions:
        """Returns actions (B, 1 + E) away from contacts: a known one, and proposals at E other points.

        Without the proposals, the scorer would predict success for every new action if hardly any try fails: the actor
        turns its hands as in no demonstration.
        """
        points = points_away(cloud, held, plans.PART_RADIUS_M, self.config.num_astray)
        grasps, commands = (each.squeeze(2) for each in self.model.proposals(cloud, points, 1))
        places = torch.cat([elsewhere, grasps[..., POSITION_DIMS]], dim=1)
        before = torch.cat([known.before[:, :1], grasps], dim=1)
        command = torch.cat([known.command[:, :1], commands], dim=1)
        # A proposal at a point beside a part may be a grasp of it.
        away = (torch.cdist(places, held) > plans.PART_RADIUS_M).all(dim=-1)
        away[:, 0] = True
        return NegativeActions(places, action_numbers(before, command), away)

    def _negative_error(self, negatives: NegativeActions, features: Tensor, z: Tensor) -> Tensor:
        """Returns ``BCE(C, 0) + |G|`` (B,), the mean over negative actions with features (B, 1 + E, F)."""
        logits = self.model.success_logits(features, z, negatives.actions)
        information = self.model.predicted_information(
            features.detach(), z.detach(), negatives.actions, logits.sigmoid().detach()
        )
        errors = logistic_loss(logits, torch.zeros_like(logits)) + information.abs()
        valid = negatives.valid.to(logits.dtype)
        return (errors * valid).sum(dim=1) / valid.sum(dim=1)

    def _information_error(
        self, past: Interactions, features: Tensor, latest: Tensor, prefix: Tensor, gained: Tensor
    ) -> Tensor:
        """Returns ``|G - gained|`` (B,): predicted against measured information of the latest interaction."""
        row = torch.arange(len(latest), device=latest.device)[:, None]
        actions = action_numbers(past.before[row, latest], past.command[row, latest])
        features, prefix = features[row, latest].detach(), prefix.detach()
        likely = self.model.success_logits(features, prefix, actions).sigmoid().detach()
        predicted = self.model.predicted_information(features, prefix, actions, likely)
        return F.l1_loss(predicted.squeeze(1), gained.detach(), reduction="none")

    def _actor_error(self, cloud: Tensor, known: Interactions) -> Weighted:
        """Returns the actor's ``L1 + KL`` (B,) of one known try per row, and its weight (B,), 0 for added ways back.

        Half of the places are the tool's own, as for motions of a held part. Each number of a motion is its own group,
        since a turn is only one of six. The mean divergence has free bits, as in ``vat_mart``.
        """
        drawn = (torch.rand_like(known.moved) + known.tried).argmax(dim=1)
        row = torch.arange(len(drawn), device=drawn.device)
        before, command, opening = (each[row, drawn] for each in (known.before, known.command, known.opening))
        place = point_near(cloud, before[:, POSITION_DIMS], plans.PART_RADIUS_M)
        place = torch.where(torch.rand_like(place[:, :1]) < 0.5, before[:, POSITION_DIMS], place)
        target = encode_proposal(before, command, opening, place)
        predicted, divergence = self.model.actor(target, self.model.actor_features(cloud, place[:, None]).squeeze(1))
        weight = known.tried.any(dim=1).to(predicted.dtype)
        error = error_by_group(predicted, target, (*plans.GRASP_GROUPS, *[1] * (target.shape[-1] - plans.GRASP_DIM)))
        offset = (predicted - target)[:, OFFSET].abs().mean(dim=-1)
        error = error + (self.config.offset_weight - 1) * offset
        divergence = free_bits(divergence, weight, self.config.free_divergence)
        return error + self.config.divergence_weight * divergence, weight

    def _map_error(self, cloud: Tensor, held: Tensor, elsewhere: Tensor, z: Tensor) -> Tensor:
        """Returns the maps' errors (B,) at a contact and elsewhere, without gradients of proposals and scores."""
        places = torch.cat([point_near(cloud, held[:, 0], plans.PART_RADIUS_M)[:, None], elsewhere], dim=1)
        before, command = self.model.proposals(cloud, places, self.config.contact_proposals)
        likely, information = self.model.scores(cloud, z, before.flatten(1, 2), command.flatten(1, 2))
        likely, information = (each.reshape(before.shape[:3]) for each in (likely, information))
        success, both = self.model.maps(cloud, places, z)
        target = mean_of_best(information, BEST_INFORMATION) + mean_of_best(likely, BEST_INFORMATION)
        errors = logistic_loss(success, mean_of_best(likely, BEST_SUCCESSES)) + (both - target).abs()
        return errors.mean(dim=1)

    # Run time ---------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Clears memories and plans at an episode's start."""
        self._memories: list[InteractionMemory] = []
        self._plans = plans.PlanQueue()
        self._chunks = ChunkGuard(self.name)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns the next key frame (B, 10) for one observation; first stores the result of the previous one."""
        cloud, pose = self.observed(batch)
        self._chunks.select()
        self._memories += self._new_memories(len(cloud) - len(self._memories))
        for memory, present in zip(self._memories, pose, strict=True):
            memory.observe(present)
        for row in self._plans.finished(len(cloud)):
            self._plans.append(row, self._plan(cloud[row : row + 1], pose[row], self._memories[row]))
        action = self._plans.pop()
        for memory, present, command in zip(self._memories, pose, action, strict=True):
            memory.sent = (present, command)
        return action

    def replace_latest(self, action: Tensor) -> None:
        """Replaces the latest executed actions by others (B, 10), and drops the plans."""
        for memory, command in zip(self._memories, action, strict=True):
            if memory.sent is not None:
                memory.sent = (memory.sent[0], command.to(memory.sent[1]))
        self._plans.clear()

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns the plans (B, T, 10) for this observation, padded with their last key frame. See `ChunkGuard`."""
        cloud, pose = self.observed(batch)
        self._chunks.predict({POINT_CLOUD: cloud, STATE: pose})
        memories = copy.deepcopy(self._memories) or self._new_memories(len(cloud))
        for memory, present in zip(memories, pose, strict=True):
            memory.observe(present)
        return plans.stacked([self._plan(cloud[row : row + 1], pose[row], memories[row]) for row in range(len(cloud))])

    def _new_memories(self, count: int) -> list[InteractionMemory]:
        return [InteractionMemory(self.config.num_interactions) for _ in range(count)]

    def summarise(self, cloud: Tensor, memory: InteractionMemory) -> Tensor:
        """Returns z (1, Z) of a memory, with features of a cloud (1, N, 3) [m]."""
        if not memory.interactions:
            return cloud.new_zeros(1, self.config.hidden_dim)
        before, command, after = (torch.stack(each)[None] for each in zip(*memory.interactions, strict=True))
        tokens = self.model.tokens(before, command, after)
        features = self.model.features(cloud, before[..., POSITION_DIMS])
        return self.model.summary(tokens, features, torch.ones_like(before[..., 0], dtype=torch.bool))

    def _plan(self, cloud: Tensor, pose: Tensor, memory: InteractionMemory) -> Tensor:
        """Returns the key frames (T, 10) of the best next interaction: a motion of the held part, or a new contact."""
        z = self.summarise(cloud, memory)
        grasps, commands, contact_scores = self._new_contacts(cloud, z, memory)
        best = int(contact_scores.argmax())
        if memory.holds(pose):
            motions, scores = self._held_motions(cloud, pose, z, memory)
            if scores.amax() >= contact_scores[best] - self.config.contact_margin:
                return motions[int(scores.argmax())][None]
        return plans.taking_hold(pose, grasps[best], commands[best])

    def _held_motions(self, cloud: Tensor, pose: Tensor, z: Tensor, memory: InteractionMemory) -> tuple[Tensor, Tensor]:
        """Returns goals (K, 10) of a held part and their scores (K,): proposals, the last motion, and the way back."""
        codes = self.model.actor.proposals(
            self.model.actor_features(cloud, pose[None, None, POSITION_DIMS]), self.config.held_proposals
        )
        goals = goal_of(pose.expand(codes.shape[2], -1), codes[0, 0, :, plans.GRASP_DIM :])
        if memory.interactions:
            before, command, _ = memory.interactions[-1]
            again = goal_of(pose, action_numbers(before, command)[6:])
            goals = torch.cat([goals, again[None], with_gripper(before, 0.0)[None]])
        return goals, self._scores(cloud, z, pose.expand(len(goals), -1), goals, memory)

    def _new_contacts(self, cloud: Tensor, z: Tensor, memory: InteractionMemory) -> tuple[Tensor, Tensor, Tensor]:
        """Returns grasps (K, 10), their goals in contact (K, 10), and scores (K,), at the maps' best points."""
        points = cloud[:, : self.config.context_points]
        success, both = self.model.maps(cloud, points, z)
        ranking = (both if self._explores(memory) else success)[0]
        places = points[:, ranking.topk(min(self.config.contact_points, points.shape[1])).indices]
        grasps, commands = self.model.proposals(cloud, places, self.config.contact_proposals)
        grasps, commands = grasps[0].flatten(0, 1), commands[0].flatten(0, 1)
        return grasps, commands, self._scores(cloud, z, grasps, commands, memory)

    def _explores(self, memory: InteractionMemory) -> bool:
        return memory.made < self.config.explorations

    def _scores(self, cloud: Tensor, z: Tensor, before: Tensor, command: Tensor, memory: InteractionMemory) -> Tensor:
        """Returns ``C`` (K,) of K actions, or ``C + G`` while interactions are also chosen for information."""
        likely, information = (each[0] for each in self.model.scores(cloud, z, before[None], command[None]))
        if self._explores(memory) and float(information.amax()) >= self.config.least_information:
            return likely + information
        return likely
