"""``sampling``: takes hold where demonstrations did, and then moves at random. See the package's docstring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import POSITION_DIMS
from lerobot_policy_adamanip.affordance.contact_labels import ContactLabels, drawn_contact, label_contacts
from lerobot_policy_adamanip.affordance.networks import (
    ConditionalVAE,
    PlaceFeatures,
    Score,
    point_near,
    points_away,
    scores_of_points,
)
from lerobot_policy_adamanip.affordance.plans import (
    GRASP_DIM,
    GRASP_GROUPS,
    ON_PART,
    PlanQueue,
    decode_grasp,
    encode_grasp,
    holds_something,
    stacked,
    taking_hold,
)
from lerobot_policy_adamanip.affordance.policy import AffordancePolicy
from lerobot_policy_adamanip.common.demonstrations import Demonstrations
from lerobot_policy_adamanip.common.losses import counting_rows, error_by_group, logistic_loss, summed, weighted_mean
from lerobot_policy_adamanip.common.motion_clusters import cluster_motions
from lerobot_policy_adamanip.common.tool_frame import MOTION_DIM, motion_between, pose_after, reverse
from lerobot_policy_adamanip.sampling.configuration_sampling import SamplingConfig


class SamplingNetwork(nn.Module):
    """Where to take hold and how, and the set of motions in contact.

    Args:
        config: of the policy.
    """

    motions: Tensor

    def __init__(self, config: SamplingConfig) -> None:
        super().__init__()
        self.config = config
        self.place_features, self.grasp_features = (PlaceFeatures(config) for _ in range(2))
        self.affordance = Score(0, config.feature_dim)
        self.grasps = ConditionalVAE(GRASP_DIM, config.feature_dim, config.latent_dim)
        self.register_buffer("motions", torch.zeros(2 * config.num_motions, MOTION_DIM))

    def place_logits(self, cloud: Tensor, places: Tensor) -> Tensor:
        """Returns how likely it is to take hold at places (B, Q, 3) of clouds (B, N, 3): logits (B, Q)."""
        return self.affordance(self.place_features(cloud, places))

    def grasp_loss(self, cloud: Tensor, place: Tensor, grasp: Tensor) -> Tensor:
        """Returns ``KL + L1`` (B,) of demonstrated grasps (B, 10) as seen from places (B, 3) of clouds (B, N, 3)."""
        given = self.grasp_features(cloud, place[:, None]).squeeze(1)
        wanted = encode_grasp(grasp, place)
        found, divergence = self.grasps(wanted, given)
        return error_by_group(found, wanted, GRASP_GROUPS) + self.config.divergence_weight * divergence

    def drawn_grasps(self, cloud: Tensor) -> Tensor:
        """Draws a grasp (B, 10) for each cloud (B, N, 3), at a place drawn among the likely ones."""
        likely = scores_of_points(self.place_logits, cloud).sigmoid()
        candidates = (likely >= self.config.likely_share * likely.amax(dim=1, keepdim=True)).to(likely.dtype)
        place = cloud[torch.arange(len(cloud), device=cloud.device), torch.multinomial(candidates, 1).squeeze(1)]
        given = self.grasp_features(cloud, place[:, None]).squeeze(1)
        return decode_grasp(self.grasps.proposals(given, 1).squeeze(1), place)


@dataclass(frozen=True)
class SamplingLabels(ContactLabels):
    """Contacts to learn from; ``motions`` (M, 7) float32 is what was sent in contact, as the tool saw it."""

    motions: NDArray[np.float32]


class SamplingPolicy(AffordancePolicy):
    """LeRobot policy without a memory: draws a macro action from the present observation, and follows it to its end."""

    config_class = SamplingConfig
    name = "sampling"

    def make_network(self) -> SamplingNetwork:
        """Returns the network, still untrained and without motions."""
        return SamplingNetwork(self.config)

    def make_labels(self, demonstrations: Demonstrations) -> SamplingLabels:
        """Returns contacts; the typical motions in contact become the set that is drawn from."""
        labels = label_contacts(demonstrations)
        motions = motions_in_contact(demonstrations)
        typical, _ = cluster_motions(motions, self.config.num_motions)
        typical[:, -1] = 0.0
        self.model.motions.copy_(torch.cat([typical, reverse(typical)]))
        return SamplingLabels(labels.contacts_of, labels.grasps, motions)

    # Training ---------------------------------------------------------------------------------------------------

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict]:
        """Returns the losses of affordance and grasps, over the rows at which a contact can be made.

        Args:
            batch: ``observation.point_cloud`` (B, N, 3) [m], ``observation.state`` (B, D), ``index`` (B,).

        Raises:
            ConfigurationError: the policy was made without a dataset.
        """
        labels, (cloud, _) = self.labels, self.observed(batch)
        contacts = labels.contacts_of[self.rows_of(batch)]
        rows = counting_rows(contacts[:, 0] >= 0)
        cloud, contacts = cloud[rows], contacts[rows]
        weight = (contacts[:, 0] >= 0).to(cloud.dtype)
        grasp, places = drawn_contact(labels.grasps, contacts)
        place = point_near(cloud, grasp[:, POSITION_DIMS], ON_PART)
        elsewhere = points_away(cloud, places, ON_PART, 1)
        logits = self.model.place_logits(cloud, torch.cat([place[:, None], elsewhere], dim=1))
        affordance = logistic_loss(logits, torch.tensor([1.0, 0.0], device=logits.device).expand_as(logits)).mean(dim=1)
        grasping = self.model.grasp_loss(cloud, place, grasp)
        losses = {
            "affordance_loss": weighted_mean(affordance, weight),
            "grasp_loss": weighted_mean(grasping, weight),
        }
        return summed(losses)

    # Run time ---------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forgets what is left of macro actions."""
        self._plans = PlanQueue()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns the next key frame (B, 10) of each episode's macro action; draws one where none is under way.

        Args:
            batch: one observation: cloud (B, N, 3) [m], state (B, D).
            kwargs: ignored.
        """
        cloud, pose = self.observed(batch)
        for row in self._plans.finished(len(cloud)):
            self._plans.append(row, self.draw_macro(cloud[row], pose[row]))
        return self._plans.pop()

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns a macro action (B, T, 10) for each observation, the last key frame of shorter ones repeated."""
        cloud, pose = self.observed(batch)
        return stacked([self.draw_macro(cloud[row], pose[row]) for row in range(len(cloud))])

    def draw_macro(self, cloud: Tensor, pose: Tensor) -> Tensor:
        """Draws a macro action (T, 10): a motion of what is held, or taking hold.

        Args:
            cloud: (N, 3) [m].
            pose: (10,) of the tool, its gripper the opening felt.
        """
        motions = self.model.motions
        if holds_something(pose):
            choice = int(torch.randint(len(motions) + 1, ()))
            if choice < len(motions):
                return pose_after(motions[choice], pose)[None]
        grasp = self.model.drawn_grasps(cloud[None])[0]
        pushed = motions[int(torch.randint(len(motions), ()))]
        return taking_hold(pose, grasp, pose_after(pushed, grasp))


def motions_in_contact(demonstrations: Demonstrations) -> NDArray[np.float32]:
    """Returns what was sent with a closed hand at a part, as the tool saw it: (M, 7)."""
    spans = [contact for rows in demonstrations.episodes() for contact in demonstrations.contacts(rows)]
    rows = np.concatenate([np.arange(contact.first, contact.end) for contact in spans])
    commands, poses = (torch.from_numpy(each[rows]) for each in (demonstrations.commands, demonstrations.poses))
    found: NDArray[np.float32] = motion_between(commands, poses).numpy()
    return found.reshape(-1, MOTION_DIM)
