"""``sampling``: grasps as in the demonstrations, then moves at random. See the package's docstring."""

from typing import Any

import torch
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import POSITION_DIMS
from lerobot_policy_adamanip.affordance import networks, plans
from lerobot_policy_adamanip.affordance.demonstrations import Demonstrations
from lerobot_policy_adamanip.affordance.losses import error_by_group, logistic_loss, sum_losses, valid_rows
from lerobot_policy_adamanip.affordance.policy import AffordancePolicy
from lerobot_policy_adamanip.common.geometry import MOTION_DIM, pose_after, reverse
from lerobot_policy_adamanip.common.inputs import INDEX
from lerobot_policy_adamanip.common.motion_clusters import cluster_motions
from lerobot_policy_adamanip.sampling.configuration_sampling import SamplingConfig
from lerobot_policy_adamanip.sampling.contact_labels import ContactLabels, draw_contact, label_contacts


class SamplingNetwork(nn.Module):
    """Affordance, grasps, and the set of motions in contact."""

    motions: Tensor

    def __init__(self, config: SamplingConfig) -> None:
        super().__init__()
        self.config = config
        self.place_features, self.grasp_features = (networks.PlaceFeatures(config) for _ in range(2))
        self.affordance = networks.Score(0, config.feature_dim)
        self.grasps = networks.ConditionalVAE(plans.GRASP_DIM, config.feature_dim, config.latent_dim)
        self.register_buffer("motions", torch.zeros(2 * config.num_motions, MOTION_DIM))

    def place_logits(self, cloud: Tensor, places: Tensor) -> Tensor:
        """Returns logits (B, Q) of a grasp at places (B, Q, 3) of clouds (B, N, 3)."""
        return self.affordance(self.place_features(cloud, places))

    def grasp_loss(self, cloud: Tensor, place: Tensor, grasp: Tensor) -> Tensor:
        """Returns ``KL + L1`` (B,) of demonstrated grasps (B, 10) at places (B, 3) of clouds (B, N, 3)."""
        features = self.grasp_features(cloud, place[:, None]).squeeze(1)
        target = plans.encode_grasp(grasp, place)
        predicted, divergence = self.grasps(target, features)
        return error_by_group(predicted, target, plans.GRASP_GROUPS) + self.config.divergence_weight * divergence

    def draw_grasps(self, cloud: Tensor) -> Tensor:
        """Draws a grasp (B, 10) for each cloud (B, N, 3), at a place drawn among the likely ones."""
        likely = networks.scores_of_points(self.place_logits, cloud).sigmoid()
        candidates = (likely >= self.config.likely_share * likely.amax(dim=1, keepdim=True)).to(likely.dtype)
        place = cloud[torch.arange(len(cloud), device=cloud.device), torch.multinomial(candidates, 1).squeeze(1)]
        features = self.grasp_features(cloud, place[:, None]).squeeze(1)
        return plans.decode_grasp(self.grasps.proposals(features, 1).squeeze(1), place)


class SamplingPolicy(AffordancePolicy):
    """LeRobot policy without memory: draws a macro action from the present observation and executes it to its end."""

    config_class = SamplingConfig
    network_class = SamplingNetwork
    name = "sampling"

    def make_labels(self, demonstrations: Demonstrations) -> ContactLabels:
        """Returns the contacts, and sets the network's motions to typical motions in contact."""
        labels = label_contacts(demonstrations)
        typical, _ = cluster_motions(labels.motions, self.config.num_motions)
        typical[:, -1] = 0.0
        self.model.motions.copy_(torch.cat([typical, reverse(typical)]))
        return labels

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Returns the losses of affordance and grasps, over the rows with a possible contact; see `sum_losses`."""
        labels, (cloud, _) = self.labels, self.observed(batch)
        contacts = labels.contacts_of[self.rows_of(batch)]
        rows = valid_rows(contacts[:, 0] >= 0)
        cloud, contacts = cloud[rows], contacts[rows]
        weight = (contacts[:, 0] >= 0).to(cloud.dtype)
        grasp, places = draw_contact(labels.grasps, contacts)
        place = networks.point_near(cloud, grasp[:, POSITION_DIMS], plans.PART_RADIUS_M)
        elsewhere = networks.points_away(cloud, places, plans.PART_RADIUS_M, 1)
        logits = self.model.place_logits(cloud, torch.cat([place[:, None], elsewhere], dim=1))
        affordance = logistic_loss(logits, torch.tensor([1.0, 0.0], device=logits.device).expand_as(logits)).mean(dim=1)
        grasping = self.model.grasp_loss(cloud, place, grasp)
        losses = {"affordance_loss": (affordance, weight), "grasp_loss": (grasping, weight)}
        return sum_losses(losses, rows, len(batch[INDEX]), reduction)

    def reset(self) -> None:
        """Drops the remaining key frames."""
        self._plans = plans.PlanQueue()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns the next key frame (B, 10) of each episode's macro action; draws a new one after the last."""
        cloud, pose = self.observed(batch)
        for row in self._plans.finished(len(cloud)):
            self._plans.append(row, self.draw_macro(cloud[row], pose[row]))
        return self._plans.pop()

    def replace_latest(self, action: Tensor) -> None:
        """Drops the remaining key frames, because another action (B, 10) was sent, which has moved the hand."""
        self._plans.clear()

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Returns a macro action (B, T, 10) for each observation, padded with its last key frame."""
        cloud, pose = self.observed(batch)
        return plans.stacked([self.draw_macro(cloud[row], pose[row]) for row in range(len(cloud))])

    def draw_macro(self, cloud: Tensor, pose: Tensor) -> Tensor:
        """Draws a macro action (T, 10): a motion of the held part, or a new grasp.

        Args:
            cloud: (N, 3) [m].
            pose: (10,) of the tool with the measured opening.
        """
        motions = self.model.motions
        if plans.holds_something(pose):
            choice = int(torch.randint(len(motions) + 1, ()))
            if choice < len(motions):
                return pose_after(motions[choice], pose)[None]
        grasp = self.model.draw_grasps(cloud[None])[0]
        push = motions[int(torch.randint(len(motions), ()))]
        return plans.taking_hold(pose, grasp, pose_after(push, grasp))
