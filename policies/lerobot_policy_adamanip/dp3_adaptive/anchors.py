"""The head ``anchors``: draw one of the demonstrations' typical motions, then correct it by what is seen.

A motion in contact is millimetres, an approach decimetres. Motions are clustered (k-means, as Behavior Transformers
do); which cluster comes next is a classification, which keeps two directions of a knob apart, and the residual is
measured in the spread of its own cluster, which makes its error small relative to the motion.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import ACTION_DIM, EFFORT, POINT_CLOUD, ROTATION_DIMS, STATE
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.encoders import make_encoder
from lerobot_policy_adamanip.common.events import events
from lerobot_policy_adamanip.common.losses import counting_rows
from lerobot_policy_adamanip.common.tool_frame import (
    MOTION_DIM,
    MOTION_UNITS,
    constant,
    fingers_swapped,
    motion_between,
    point_features,
    points_seen,
    pose_after,
    upwards,
)
from lerobot_policy_adamanip.common.torch_rotations import angle_between
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.event_memory import EventMemory
from lerobot_policy_adamanip.dp3_adaptive.refinement import Refiner
from lerobot_policy_adamanip.dp3_adaptive.task_conditioning import INSTRUCTION, INSTRUCTION_DIM
from lerobot_policy_adamanip.dp3_adaptive.window import Window

POINT_UNIT, POINT_NEAR = 0.15, 0.03
"""A point is told by where it is in this unit, and by its direction, which is sharp within this distance [m]."""
EFFORT_UNIT = 20.0
"""[N m]"""
OPEN, AWAY, SCATTERED = 0.5, 0.02, 0.006
"""Gripper opening of an open hand, the way [m] beyond which an anchor leads elsewhere, and the spread [m] beyond which
its motions end in different places: those of a last approach spread by 8 mm or more, since pre-grasps differ; backing
off from a grasp spreads by 5."""
SILENT = 0.03
"""Anchors less likely than this are never drawn: what a network has not quite unlearned is no choice."""


class AnchorNetwork(nn.Module):
    """Cloud and memory to logits of anchors and a residual for each; and what corrects a pose by the points around it.

    Args:
        config: of the policy.
    """

    anchors: Tensor
    spread: Tensor

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        super().__init__()
        self.register_buffer("anchors", torch.zeros(config.num_anchors, MOTION_DIM))
        self.register_buffer("spread", torch.zeros(config.num_anchors, MOTION_DIM))
        self.encoder = make_encoder(config.encoder, 6, config.encoder_dims, config.encoder_out_dim, config.num_points)
        remembers = config.n_action_history_steps > 0
        self.memory = EventMemory(config.memory_dim) if remembers else None
        effort = config.feature_size(EFFORT) if config.use_effort else 0
        told = INSTRUCTION_DIM if config.use_instruction else 0
        seen = config.encoder_out_dim + 4 + effort + told + (config.memory_dim if remembers else 0)
        width = config.trunk_dim
        self.trunk = nn.Sequential(nn.Linear(seen, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.logits = nn.Linear(width, config.num_anchors)
        self.residuals = nn.Linear(width, config.num_anchors * MOTION_DIM)
        self.refiner = Refiner(config.refinement_points) if config.num_refinements else None

    def forward(self, points: Tensor, body: Tensor, happened: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, 6), (B, 4+), (B, H, 16) -> logits (B, K), residuals (B, K, 7) in units of their anchors' spread."""
        parts = [self.encoder(points), body]
        if self.memory is not None:
            parts.append(self.memory(happened))
        features = self.trunk(torch.cat(parts, dim=-1))
        return self.logits(features), self.residuals(features).reshape(-1, *self.anchors.shape)

    def nearest_anchor(self, motion: Tensor) -> Tensor:
        """Motions (B, 7) -> indices (B,) of their anchors."""
        away = (motion[:, None] - self.anchors) / constant(MOTION_UNITS, motion)
        return away.square().sum(dim=-1).argmin(dim=-1)

    def aims(self, index: Tensor) -> Tensor:
        """Whether anchors (B,) lead an open hand to something: demonstrations of one anchor end in different places.

        What a closed hand can do is decided by what it holds, and a hand that lets go stays where it is.
        """
        leading = (self.anchors[:, -1] > OPEN) & (self.anchors[:, :3].norm(dim=-1) > AWAY)
        aiming: Tensor = leading & (self.spread[:, :3].amax(dim=-1) > SCATTERED)
        return aiming[index]


class AnchorHead:
    """Loss and sampling of an `AnchorNetwork`. States and actions are poses, not normalised.

    Args:
        config: of the policy.
    """

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        self.config = config
        self._known: AnchorNetwork | None = None

    def network(self) -> AnchorNetwork:
        """Returns a network that is still untrained and without anchors."""
        return AnchorNetwork(self.config)

    def predict(self, model: AnchorNetwork, window: Window) -> tuple[Tensor, Tensor]:
        """Returns logits (B, K) and residuals (B, K, 7)."""
        cloud = window.observations[POINT_CLOUD][:, -1, : self.config.coarse_points]
        poses = window.observations[STATE][..., :ACTION_DIM]
        if model.training:
            cloud = self._perturbed(cloud)
        points = points_seen(cloud, poses[:, -1])
        body = [upwards(poses[:, -1]), poses[:, -1, 9:10]]
        if self.config.use_effort:
            body.append(window.observations[EFFORT][:, -1] / EFFORT_UNIT)
        if self.config.use_instruction:
            body.append(window.observations[INSTRUCTION][:, -1])
        steps = self.config.n_action_history_steps
        happened = events(window.history, poses[:, -steps - 1 :], window.valid, feedback=self.config.use_feedback)
        predicted: tuple[Tensor, Tensor] = model(
            point_features(points, POINT_UNIT, POINT_NEAR), torch.cat(body, dim=-1), happened
        )
        return predicted

    def _perturbed(self, cloud: Tensor) -> Tensor:
        """Other points of the same surfaces at every step, not quite where they were."""
        count = self.config.training_points
        if count < cloud.shape[1]:
            # Which ones is drawn, their order is not looked at: so it is not made.
            kept = torch.rand(cloud.shape[:2], device=cloud.device).topk(count, dim=1, sorted=False).indices
            cloud = cloud.gather(1, kept[..., None].expand(-1, -1, cloud.shape[-1]))
        return cloud + self.config.point_noise_std * torch.randn_like(cloud)

    def loss(
        self, model: AnchorNetwork, window: Window, actions: Tensor, real: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns a loss per sample (B,), its weight (B,), and its parts, to be logged.

        Args:
            model: of which the anchors are known.
            window: what it is conditioned on.
            actions: (B, 1, 10) poses.
            real: (B, 1) bool; what lies beyond an episode's end is no demonstration.

        Raises:
            ConfigurationError: the anchors are not known.
        """
        if self._known is not model and not model.spread.any():
            raise ConfigurationError(
                "The anchors are not known.",
                got="a policy made without a dataset",
                allowed="make_policy(..., ds_meta=) of a dataset, or a checkpoint",
                hint="lerobot-train --policy.type=dp3_adaptive --dataset.root=DIR",
            )
        self._known = model  # looking at the buffer waits for a GPU: once is enough
        tool, goal = window.observations[STATE][:, -1, :ACTION_DIM], actions[:, 0]
        motion = motion_between(goal, tool)
        index = model.nearest_anchor(motion)
        logits, residuals = self.predict(model, window)
        choice = F.cross_entropy(logits, index, reduction="none")
        wanted = (motion - model.anchors[index]) / model.spread[index]
        found = residuals[torch.arange(len(index), device=index.device), index]
        residual = F.smooth_l1_loss(found, wanted, reduction="none").mean(dim=-1)
        total, parts = choice + residual, {"choice_loss": choice.mean(), "residual_loss": residual.mean()}
        if model.refiner is not None:
            refinement = self._refinement_loss(model, model.refiner, window, goal, index)
            total, parts["refinement_loss"] = total + refinement, refinement.mean()
        return total, real[:, 0].to(total.dtype), {name: part.detach() for name, part in parts.items()}

    def _refinement_loss(
        self, model: AnchorNetwork, refiner: Refiner, window: Window, goal: Tensor, index: Tensor
    ) -> Tensor:
        """(B,): of the samples that aim; nothing for the others, which are most and, on a CPU, spared the work."""
        aims = model.aims(index)
        rows = _rows_to_refine(aims)
        loss = refiner.loss(window.observations[POINT_CLOUD][rows, -1], goal[rows]) * aims[rows]
        return torch.zeros_like(goal[:, 0]).index_add(0, rows, loss.to(goal.dtype))

    def sample(self, model: AnchorNetwork, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, 1, 10).

        Args:
            model: trained.
            window: what it is conditioned on.
            noise: uniform numbers in [0, 1), (B, ...), the first of a row is used; drawn if None.
        """
        tool = window.observations[STATE][:, -1, :ACTION_DIM].float()
        logits, residuals = self.predict(model, window)
        index = _drawn(logits.float().softmax(dim=-1), noise)
        residual = residuals[torch.arange(len(index), device=index.device), index].float()
        motion = model.anchors[index] + residual * model.spread[index]
        motion = torch.cat([motion[:, :6], motion[:, 6:].clamp(0, 1)], dim=-1)
        pose = pose_after(motion, tool)
        if model.refiner is not None:
            pose = self._refined(model, model.refiner, window, pose, index)
        return pose[:, None]

    def _refined(self, model: AnchorNetwork, refiner: Refiner, window: Window, pose: Tensor, index: Tensor) -> Tensor:
        """Returns poses (B, 10), corrected where their anchors aim: on a CPU most actions are spared the work."""
        aims = model.aims(index)
        if aims.device.type == "cpu" and not aims.any():
            return pose
        rows = _rows_to_refine(aims)
        cloud = window.observations[POINT_CLOUD][rows, -1]
        refined = refiner.refined(cloud, pose[rows], self.config.num_refinements)
        tool = window.observations[STATE][rows, -1, :ACTION_DIM].float()
        refined = _less_turned(refined, pose[rows], tool)
        return torch.where(aims[:, None], pose.index_copy(0, rows, refined), pose)


def _less_turned(refined: Tensor, chosen: Tensor, tool: Tensor) -> Tensor:
    """Returns poses (B, 10), or the same grasps with fingers swapped where those are less turned.

    Against what was chosen, which is seldom wrong by more than a quarter turn, and against the hand: half a turn more
    is often out of the arm's reach.
    """

    def turned(pose: Tensor) -> Tensor:
        rotation = pose[:, ROTATION_DIMS]
        return angle_between(rotation, chosen[:, ROTATION_DIMS]) + angle_between(rotation, tool[:, ROTATION_DIMS])

    swapped = fingers_swapped(refined)
    return torch.where((turned(swapped) < turned(refined))[:, None], swapped, refined)


def _rows_to_refine(aims: Tensor) -> Tensor:
    """Returns indices of rows (R,), of aims (B,) bool: those that aim, and others that then count for nothing."""
    if aims.device.type != "cpu":
        # Which ones aim is not known without waiting for the device, to which the others are little work.
        return torch.arange(len(aims), device=aims.device)
    return counting_rows(aims)


def _drawn(likely: Tensor, noise: Tensor | None) -> Tensor:
    """Draws indices (B,) from probabilities (B, K), never one that is `SILENT`."""
    silent = (likely < SILENT) & (likely < likely.amax(dim=-1, keepdim=True))
    passed = likely.masked_fill(silent, 0.0).cumsum(dim=-1)
    draw = torch.rand(len(likely), device=likely.device) if noise is None else noise.reshape(len(likely), -1)[:, 0]
    index = torch.searchsorted(passed, draw[:, None].to(passed.dtype) * passed[:, -1:], right=True).squeeze(-1)
    return index.clamp(max=likely.shape[-1] - 1)
