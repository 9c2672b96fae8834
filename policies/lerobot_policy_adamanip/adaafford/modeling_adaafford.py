"""``adaafford``: chooses where to take hold and what to do there by what its own interactions have told.

Names of modules and losses are those of the method's released code (`wangyian-me/AdaAffordCode`); what differs is in
the package's docstring.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_adamanip.contract.schema import POINT_CLOUD, POSITION_DIMS, STATE
from lerobot_policy_adamanip.adaafford.configuration_adaafford import AdaAffordConfig
from lerobot_policy_adamanip.adaafford.episode_memory import Memory
from lerobot_policy_adamanip.adaafford.interactions import InteractionLabels, label_interactions
from lerobot_policy_adamanip.adaafford.network import AdaAffordNetwork, action_numbers, encode_proposal, sent_from
from lerobot_policy_adamanip.adaafford.queries import Astray, Interactions, trimmed
from lerobot_policy_adamanip.affordance.networks import mean_of_best, point_near, points_away
from lerobot_policy_adamanip.affordance.plans import (
    GRASP_DIM,
    GRASP_GROUPS,
    ON_PART,
    PlanQueue,
    stacked,
    taking_hold,
    with_gripper,
)
from lerobot_policy_adamanip.affordance.policy import AffordancePolicy
from lerobot_policy_adamanip.common.chunk_guard import ChunkGuard
from lerobot_policy_adamanip.common.demonstrations import Demonstrations
from lerobot_policy_adamanip.common.losses import counting_rows, error_by_group, logistic_loss, summed, weighted_mean

OFFSET = slice(GRASP_GROUPS[0], GRASP_GROUPS[0] + GRASP_GROUPS[1])
"""Of a proposal's numbers: from a place in the cloud to where the tool takes hold."""
BEST_SUCCESSES, BEST_INFORMATION = 3, 5
"""The maps are means of so many of the best proposals at a place."""


class AdaAffordPolicy(AffordancePolicy):
    """LeRobot policy. What it has done in contact and felt is its memory; nothing else passes from step to step."""

    config_class = AdaAffordConfig
    name = "adaafford"

    def make_network(self) -> AdaAffordNetwork:
        """Returns the network, still untrained."""
        return AdaAffordNetwork(self.config)

    def make_labels(self, demonstrations: Demonstrations) -> InteractionLabels:
        """Returns interactions, and what each row can learn from them."""
        return label_interactions(demonstrations, self.config.num_interactions, self.config.num_candidates)

    # Training ---------------------------------------------------------------------------------------------------

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict]:
        """Returns the sum of the modules' losses, over the rows at which the outcome of an interaction is known.

        Args:
            batch: ``observation.point_cloud`` (B, N, 3) [m], ``observation.state`` (B, D), ``index`` (B,).

        Raises:
            ConfigurationError: the policy was made without a dataset.
        """
        labels, (cloud, _) = self.labels, self.observed(batch)
        recorded = self.rows_of(batch)
        known = labels.candidates[recorded]
        rows = counting_rows(known[:, 0] >= 0)
        cloud, known, history = cloud[rows], known[rows], labels.history[recorded[rows]]
        counts = (known[:, 0] >= 0).to(cloud.dtype)
        asked, told = self._interactions(trimmed(known)), self._interactions(trimmed(history))
        held = asked.before[..., POSITION_DIMS]
        elsewhere = points_away(cloud, held, ON_PART, 1)
        astray = self._astray(cloud, asked, held, elsewhere)
        # At once: every call looks at the whole cloud.
        places = torch.cat([told.before[..., POSITION_DIMS], held, astray.places], dim=1)
        counted = [told.valid.shape[1], asked.valid.shape[1], astray.places.shape[1]]
        features = self.model.features(cloud, places).split(counted, dim=1)
        tokens = self.model.tokens(told.before, told.command, told.after)
        latest = told.valid.sum(dim=1, keepdim=True).clamp(min=1) - 1
        before_it = told.valid.scatter(1, latest, False)
        z, prefix = (self.model.concluded(tokens, features[0], valid) for valid in (told.valid, before_it))
        errors = [self._success_error(asked, features[1], given) for given in (z, prefix)]
        information = self._information_error(told, features[0], latest, prefix, errors[1] - errors[0])
        losses = {
            "success_loss": weighted_mean(errors[0] + errors[1], counts),
            "elsewhere_loss": weighted_mean(self._elsewhere_error(astray, features[2], z), counts),
            "information_loss": weighted_mean(information, counts * told.valid[:, 0]),
            "actor_loss": self._actor_error(cloud, asked),
            "map_loss": weighted_mean(self._map_error(cloud, held, elsewhere, z.detach()), counts),
        }
        return summed(losses)

    def _interactions(self, numbers: Tensor) -> Interactions:
        """Looks interactions (B, K) up; -1 is none."""
        labels, valid, number = self.labels, numbers >= 0, numbers.clamp(min=0)
        poses = (each[number] for each in (labels.before, labels.command, labels.after))
        return Interactions(*poses, labels.opening[number], labels.moved[number], labels.tried[number] & valid, valid)

    def _success_error(self, asked: Interactions, features: Tensor, z: Tensor) -> Tensor:
        """Returns ``BCE(C, moved)`` (B,), the mean over the interactions (B, K) whose outcome is known."""
        logits = self.model.succeeds(features, z, action_numbers(asked.before, asked.command))
        valid = asked.valid.to(logits.dtype)
        return (logistic_loss(logits, asked.moved) * valid).sum(dim=1) / valid.sum(dim=1).clamp(min=1)

    def _astray(self, cloud: Tensor, asked: Interactions, held: Tensor, elsewhere: Tensor) -> Astray:
        """Returns actions (B, 1 + E) where nobody has taken hold: a known one, and proposals at E other points.

        The known one alone would leave open what becomes of the actor's own there: it proposes hands turned as no
        demonstration turns them, and where hardly any try fails, success is what the scorer says of everything new.

        Args:
            cloud: (B, N, 3) [m].
            asked: interactions (B, K) whose outcome is known; the first is taken elsewhere.
            held: (B, K, 3) [m] where they were.
            elsewhere: (B, 1, 3) [m] where it is taken to.
        """
        points = points_away(cloud, held, ON_PART, self.config.num_astray)
        grasps, commands = (each.squeeze(2) for each in self.model.proposals(cloud, points, 1))
        places = torch.cat([elsewhere, grasps[..., POSITION_DIMS]], dim=1)
        before = torch.cat([asked.before[:, :1], grasps], dim=1)
        command = torch.cat([asked.command[:, :1], commands], dim=1)
        # What is proposed from beside a part may well be a grasp of it.
        away = (torch.cdist(places, held) > ON_PART).all(dim=-1)
        away[:, 0] = True
        return Astray(places, action_numbers(before, command), away)

    def _elsewhere_error(self, astray: Astray, features: Tensor, z: Tensor) -> Tensor:
        """Returns ``BCE(C, 0) + |G|`` (B,), the mean over actions where nobody has taken hold: features (B, 1 + E, F).

        They move nothing there, and tell nothing.
        """
        logits = self.model.succeeds(features, z, astray.actions)
        tells = self.model.informs(features.detach(), z.detach(), astray.actions, logits.sigmoid().detach())
        errors, away = logistic_loss(logits, torch.zeros_like(logits)) + tells.abs(), astray.away.to(logits.dtype)
        return (errors * away).sum(dim=1) / away.sum(dim=1)

    def _information_error(
        self, told: Interactions, features: Tensor, latest: Tensor, prefix: Tensor, gained: Tensor
    ) -> Tensor:
        """Returns ``|G - gained|`` (B,): what the latest interaction promised to tell, and what it told.

        Args:
            told: interactions (B, H) before a row.
            features: (B, H, F) of where they were.
            latest: (B, 1) which of them was the latest.
            prefix: z (B, Z) of those before it.
            gained: (B,) cross-entropy of the known outcomes without it, less that with it [nats].
        """
        row = torch.arange(len(latest), device=latest.device)[:, None]
        actions = action_numbers(told.before[row, latest], told.command[row, latest])
        features, prefix = features[row, latest].detach(), prefix.detach()
        likely = self.model.succeeds(features, prefix, actions).sigmoid().detach()
        found = self.model.informs(features, prefix, actions, likely)
        return F.l1_loss(found.squeeze(1), gained.detach(), reduction="none")

    def _actor_error(self, cloud: Tensor, asked: Interactions) -> Tensor:
        """Returns ``L1 + KL`` () of known interactions as proposals, one a row; reversals are not proposed.

        Half of them are proposed at the tool's own place, as motions of what is held are. A motion's numbers count
        singly, for a turn is one of six. The divergence is of the mean, and costs nothing below a few nats (free bits,
        Kingma et al. 2016): with less to pay, draws from the prior fall between what was tried, and with more, every
        draw is its mean, which is no motion at all.
        """
        drawn = (torch.rand_like(asked.moved) + asked.tried).argmax(dim=1)
        row = torch.arange(len(drawn), device=drawn.device)
        before, command, opening = (each[row, drawn] for each in (asked.before, asked.command, asked.opening))
        place = point_near(cloud, before[:, POSITION_DIMS], ON_PART)
        place = torch.where(torch.rand_like(place[:, :1]) < 0.5, before[:, POSITION_DIMS], place)
        wanted = encode_proposal(before, command, opening, place)
        found, divergence = self.model.actor(wanted, self.model.actor_features(cloud, place[:, None]).squeeze(1))
        counts = asked.tried.any(dim=1).to(found.dtype)
        error = error_by_group(found, wanted, (*GRASP_GROUPS, *[1] * (wanted.shape[-1] - GRASP_DIM)))
        offset = (found - wanted)[:, OFFSET].abs().mean(dim=-1)
        error = error + (self.config.offset_weight - 1) * offset
        beyond = weighted_mean(divergence, counts).clamp(min=self.config.free_divergence)
        return weighted_mean(error, counts) + self.config.divergence_weight * beyond

    def _map_error(self, cloud: Tensor, held: Tensor, elsewhere: Tensor, z: Tensor) -> Tensor:
        """Returns the maps' errors (B,) where to take hold and elsewhere, proposals and scores as they are now.

        Args:
            cloud: (B, N, 3) [m].
            held: (B, K, 3) [m] where known interactions were; the first is taken.
            elsewhere: (B, 1, 3) [m].
            z: (B, Z).
        """
        places = torch.cat([point_near(cloud, held[:, 0], ON_PART)[:, None], elsewhere], dim=1)
        before, command = self.model.proposals(cloud, places, self.config.contact_proposals)
        likely, tells = self.model.judged(cloud, z, before.flatten(1, 2), command.flatten(1, 2))
        likely, tells = (each.reshape(before.shape[:3]) for each in (likely, tells))
        success, both = self.model.mapped(cloud, places, z)
        wanted = mean_of_best(tells, BEST_INFORMATION) + mean_of_best(likely, BEST_INFORMATION)
        errors = logistic_loss(success, mean_of_best(likely, BEST_SUCCESSES)) + (both - wanted).abs()
        return errors.mean(dim=1)

    # Run time ---------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forgets the episode."""
        self._memories: list[Memory] = []
        self._plans = PlanQueue()
        self._chunks = ChunkGuard(self.config)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns the next key frame (B, 10), and remembers what came of the one before.

        Args:
            batch: one observation: cloud (B, N, 3) [m], state (B, D).
            kwargs: ignored.
        """
        cloud, pose = self.observed(batch)
        self._chunks.select()
        self._memories += [Memory(self.config.num_interactions) for _ in range(len(cloud) - len(self._memories))]
        for memory, felt in zip(self._memories, pose, strict=True):
            memory.feel(felt)
        for row in self._plans.finished(len(cloud)):
            self._plans.append(row, self._decided(cloud[row : row + 1], pose[row], self._memories[row]))
        action = self._plans.pop()
        for memory, felt, command in zip(self._memories, pose, action, strict=True):
            memory.sent = (felt, command)
        return action

    def replace_latest(self, action: Tensor) -> None:
        """Remembers that other actions (B, 10) were executed than the latest of `select_action`; plans anew."""
        for memory, command in zip(self._memories, action, strict=True):
            if memory.sent is not None:
                memory.sent = (memory.sent[0], command.to(memory.sent[1]))
        self._plans.clear()

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns what would be decided (B, T, 10) now; shorter ones repeat their last. See `ChunkGuard`."""
        cloud, pose = self.observed(batch)
        self._chunks.predict({POINT_CLOUD: cloud, STATE: pose})
        memories = self._memories or [Memory(self.config.num_interactions) for _ in cloud]
        return stacked([self._decided(cloud[row : row + 1], pose[row], memories[row]) for row in range(len(cloud))])

    def conclude(self, cloud: Tensor, memory: Memory) -> Tensor:
        """Returns z (1, Z) of what is remembered, looking at a cloud (1, N, 3) [m]."""
        if not memory.interactions:
            return cloud.new_zeros(1, self.config.hidden_dim)
        before, command, after = (torch.stack(each)[None] for each in zip(*memory.interactions, strict=True))
        tokens = self.model.tokens(before, command, after)
        features = self.model.features(cloud, before[..., POSITION_DIMS])
        return self.model.concluded(tokens, features, torch.ones_like(before[..., 0], dtype=torch.bool))

    def _decided(self, cloud: Tensor, pose: Tensor, memory: Memory) -> Tensor:
        """Returns the key frames (T, 10) to the best next interaction: it itself, or taking hold of something else.

        Args:
            cloud: (1, N, 3) [m].
            pose: (10,) of the tool, its gripper the opening felt.
            memory: of the episode.
        """
        z = self.conclude(cloud, memory)
        grasps, commands, place_scores = self._elsewhere(cloud, z, memory)
        best = int(place_scores.argmax())
        if memory.holds(pose):
            here, scores = self._here(cloud, pose, z, memory)
            if scores.amax() >= place_scores[best] - self.config.contact_margin:
                return here[int(scores.argmax())][None]
        return taking_hold(pose, grasps[best], commands[best])

    def _here(self, cloud: Tensor, pose: Tensor, z: Tensor, memory: Memory) -> tuple[Tensor, Tensor]:
        """Returns motions of what is held, where they lead (K, 10), and their scores (K,).

        Proposed are the actor's, the last motion again, and the way back.
        """
        codes = self.model.actor.proposals(
            self.model.actor_features(cloud, pose[None, None, POSITION_DIMS]), self.config.held_proposals
        )
        commands = sent_from(pose.expand(codes.shape[2], -1), codes[0, 0, :, GRASP_DIM:])
        if memory.interactions:
            before, command, _ = memory.interactions[-1]
            again = sent_from(pose, action_numbers(before, command)[6:])
            commands = torch.cat([commands, again[None], with_gripper(before, 0.0)[None]])
        return commands, self._scores(cloud, z, pose.expand(len(commands), -1), commands, memory)

    def _elsewhere(self, cloud: Tensor, z: Tensor, memory: Memory) -> tuple[Tensor, Tensor, Tensor]:
        """Returns grasps (K, 10), where they are sent in contact (K, 10), and scores (K,), at the maps' best points."""
        points = cloud[:, : self.config.context_points]
        success, both = self.model.mapped(cloud, points, z)
        wanted = (both if self._explores(memory) else success)[0]
        places = points[:, wanted.topk(min(self.config.contact_points, points.shape[1])).indices]
        grasps, commands = self.model.proposals(cloud, places, self.config.contact_proposals)
        grasps, commands = grasps[0].flatten(0, 1), commands[0].flatten(0, 1)
        return grasps, commands, self._scores(cloud, z, grasps, commands, memory)

    def _explores(self, memory: Memory) -> bool:
        return memory.made < self.config.explorations

    def _scores(self, cloud: Tensor, z: Tensor, before: Tensor, command: Tensor, memory: Memory) -> Tensor:
        """Returns ``C``, or ``C + G`` while interactions are chosen for what they tell, of K actions (K,)."""
        likely, tells = (each[0] for each in self.model.judged(cloud, z, before[None], command[None]))
        if self._explores(memory) and float(tells.amax()) >= self.config.least_information:
            return likely + tells
        return likely
