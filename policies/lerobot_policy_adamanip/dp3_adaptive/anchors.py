"""The head ``anchors``: draws one of the demonstrations' typical motions, adds a residual and refines the pose.

Motions in contact are millimetres long, approaches decimetres. Motions are clustered (k-means, as in Behavior
Transformers), and the network classifies the next cluster, which keeps the two directions of a knob apart. The
residual's unit is the spread of its cluster, so its error is small relative to the motion.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import ACTION_DIM, EFFORT, POINT_CLOUD, ROTATION_DIMS, STATE
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common import tool_frame
from lerobot_policy_adamanip.common.encoders import make_encoder
from lerobot_policy_adamanip.common.events import EventMemory, events
from lerobot_policy_adamanip.common.losses import valid_rows
from lerobot_policy_adamanip.common.torch_rotations import angle_between
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, INSTRUCTION_DIM
from lerobot_policy_adamanip.dp3_adaptive.refinement import Refiner
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

POINT_UNIT, DIRECTION_SCALE = 0.15, 0.03
"""Units of `point_features` [m]."""
EFFORT_UNIT = 20.0
"""Unit of joint torques [N m]."""
GRIPPER_OPEN_MIN, MIN_TRANSLATION_M, MIN_ENDPOINT_SPREAD_M = 0.5, 0.02, 0.006
"""Bounds of `AnchorNetwork.needs_refinement`. Last approaches spread by 8 mm or more, because pre-grasps differ;
motions that back off from a grasp spread by 5 mm."""
MIN_ANCHOR_PROBABILITY = 0.03
"""Anchors below it are masked before sampling."""


class AnchorNetwork(nn.Module):
    """Network from cloud and memory to logits of anchors and a residual for each; with a refiner of poses."""

    anchors: Tensor
    spread: Tensor

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        super().__init__()
        self.register_buffer("anchors", torch.zeros(config.num_anchors, tool_frame.MOTION_DIM))
        self.register_buffer("spread", torch.zeros(config.num_anchors, tool_frame.MOTION_DIM))
        self.encoder = make_encoder(config.encoder, 6, config.encoder_dims, config.encoder_out_dim, config.num_points)
        remembers = config.n_action_history_steps > 0
        self.memory = EventMemory(config.memory_dim) if remembers else None
        features = config.encoder_out_dim + 4 + (config.memory_dim if remembers else 0)
        features += config.feature_size(EFFORT) if config.use_effort else 0
        features += INSTRUCTION_DIM if config.use_instruction else 0
        width = config.trunk_dim
        self.trunk = nn.Sequential(nn.Linear(features, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.logits = nn.Linear(width, config.num_anchors)
        self.residuals = nn.Linear(width, config.num_anchors * tool_frame.MOTION_DIM)
        self.refiner = Refiner(config.refinement_points) if config.num_refinements else None

    def forward(self, points: Tensor, body: Tensor, happened: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, 6), (B, 4+), (B, H, 16) -> logits (B, K), residuals (B, K, 7) in units of the anchors' spread."""
        parts = [self.encoder(points), body]
        if self.memory is not None:
            parts.append(self.memory(happened))
        features = self.trunk(torch.cat(parts, dim=-1))
        return self.logits(features), self.residuals(features).reshape(-1, *self.anchors.shape)

    def nearest_anchor(self, motion: Tensor) -> Tensor:
        """Returns the index (B,) of the nearest anchor of each motion (B, 7)."""
        difference = (motion[:, None] - self.anchors) / tool_frame.constant(tool_frame.MOTION_UNITS, motion)
        return difference.square().sum(dim=-1).argmin(dim=-1)

    def needs_refinement(self, index: Tensor) -> Tensor:
        """Returns whether anchors (B,) are approaches of an open hand with a varying end point (B,).

        A closed hand is guided by the part that it holds, and a hand that releases stays where it is.
        """
        approaches = (self.anchors[:, -1] > GRIPPER_OPEN_MIN) & (self.anchors[:, :3].norm(dim=-1) > MIN_TRANSLATION_M)
        varying: Tensor = approaches & (self.spread[:, :3].amax(dim=-1) > MIN_ENDPOINT_SPREAD_M)
        return varying[index]


class AnchorHead:
    """Loss and sampling of an `AnchorNetwork`. States and actions are poses without normalisation."""

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        self.config = config
        self._fitted: AnchorNetwork | None = None

    def network(self) -> AnchorNetwork:
        """Returns an untrained network without anchors."""
        return AnchorNetwork(self.config)

    def predict(self, model: AnchorNetwork, window: Window) -> tuple[Tensor, Tensor]:
        """Returns logits (B, K) and residuals (B, K, 7)."""
        cloud = window.observations[POINT_CLOUD][:, -1, : self.config.coarse_points]
        poses = window.observations[STATE][..., :ACTION_DIM]
        if model.training:
            cloud = self._resampled(cloud)
        points = tool_frame.points_seen(cloud, poses[:, -1])
        body = [tool_frame.upwards(poses[:, -1]), poses[:, -1, 9:10]]
        if self.config.use_effort:
            body.append(window.observations[EFFORT][:, -1] / EFFORT_UNIT)
        if self.config.use_instruction:
            body.append(window.observations[INSTRUCTION][:, -1])
        steps = self.config.n_action_history_steps
        happened = events(window.history, poses[:, -steps - 1 :], window.valid, feedback=self.config.use_feedback)
        features = tool_frame.point_features(points, POINT_UNIT, DIRECTION_SCALE)
        predicted: tuple[Tensor, Tensor] = model(features, torch.cat(body, dim=-1), happened)
        return predicted

    def _resampled(self, cloud: Tensor) -> Tensor:
        """Draws a random subset of the points at every step, and adds noise."""
        count = self.config.training_points
        if count < cloud.shape[1]:
            # Unsorted: the encoder ignores the order of points.
            kept = torch.rand(cloud.shape[:2], device=cloud.device).topk(count, dim=1, sorted=False).indices
            cloud = cloud.gather(1, kept[..., None].expand(-1, -1, cloud.shape[-1]))
        return cloud + self.config.point_noise_std * torch.randn_like(cloud)

    def loss(
        self, model: AnchorNetwork, window: Window, actions: Tensor, is_label: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns a loss per sample (B,), its weight (B,), and its parts as metrics.

        Labels are the poses ``actions`` (B, 1, 10) where ``is_label`` (B, 1) is true. Raises `ConfigurationError` for a
        model without anchors.
        """
        if self._fitted is not model and not model.spread.any():
            raise ConfigurationError(
                "The policy has no anchors.",
                got="a policy created without a dataset",
                allowed="make_policy(..., ds_meta=) of a dataset, or a checkpoint",
                hint="lerobot-train --policy.type=dp3_adaptive --dataset.root=DIR",
            )
        self._fitted = model  # reading the buffer synchronises with a GPU, so only once
        tool, goal = window.observations[STATE][:, -1, :ACTION_DIM], actions[:, 0]
        motion = tool_frame.motion_between(goal, tool)
        index = model.nearest_anchor(motion)
        logits, residuals = self.predict(model, window)
        choice = F.cross_entropy(logits, index, reduction="none")
        target = (motion - model.anchors[index]) / model.spread[index]
        predicted = residuals[torch.arange(len(index), device=index.device), index]
        residual = F.smooth_l1_loss(predicted, target, reduction="none").mean(dim=-1)
        total, parts = choice + residual, {"choice_loss": choice.mean(), "residual_loss": residual.mean()}
        if model.refiner is not None:
            refinement = self._refinement_loss(model, model.refiner, window, goal, index)
            total, parts["refinement_loss"] = total + refinement, refinement.mean()
        return total, is_label[:, 0].to(total.dtype), {name: part.detach() for name, part in parts.items()}

    def _refinement_loss(
        self, model: AnchorNetwork, refiner: Refiner, window: Window, goal: Tensor, index: Tensor
    ) -> Tensor:
        """Returns the refiner's loss (B,), zero for samples whose anchors need no refinement."""
        needed = model.needs_refinement(index)
        rows = _rows_to_refine(needed)
        loss = refiner.loss(window.observations[POINT_CLOUD][rows, -1], goal[rows]) * needed[rows]
        return torch.zeros_like(goal[:, 0]).index_add(0, rows, loss.to(goal.dtype))

    def sample(self, model: AnchorNetwork, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, 1, 10). The first of a row of ``noise`` (B, ...), uniform in [0, 1), selects the anchor."""
        tool = window.observations[STATE][:, -1, :ACTION_DIM].float()
        logits, residuals = self.predict(model, window)
        index = _draw(logits.float().softmax(dim=-1), noise)
        residual = residuals[torch.arange(len(index), device=index.device), index].float()
        motion = model.anchors[index] + residual * model.spread[index]
        motion = torch.cat([motion[:, :6], motion[:, 6:].clamp(0, 1)], dim=-1)
        pose = tool_frame.pose_after(motion, tool)
        if model.refiner is not None:
            pose = self._refined(model, model.refiner, window, pose, index)
        return pose[:, None]

    def _refined(self, model: AnchorNetwork, refiner: Refiner, window: Window, pose: Tensor, index: Tensor) -> Tensor:
        """Returns poses (B, 10), refined where their anchors need it."""
        needed = model.needs_refinement(index)
        if needed.device.type == "cpu" and not needed.any():
            return pose
        rows = _rows_to_refine(needed)
        cloud = window.observations[POINT_CLOUD][rows, -1]
        refined = refiner.refined(cloud, pose[rows], self.config.num_refinements)
        tool = window.observations[STATE][rows, -1, :ACTION_DIM].float()
        refined = _less_turned(refined, pose[rows], tool)
        return torch.where(needed[:, None], pose.index_copy(0, rows, refined), pose)


def _less_turned(refined: Tensor, chosen: Tensor, tool: Tensor) -> Tensor:
    """Returns poses (B, 10), with fingers swapped where that is a smaller turn.

    The turn is measured against the chosen pose, which is seldom wrong by more than a quarter turn, and against the
    hand: half a turn more is often out of the arm's reach.
    """

    def turn(pose: Tensor) -> Tensor:
        rotation = pose[:, ROTATION_DIMS]
        return angle_between(rotation, chosen[:, ROTATION_DIMS]) + angle_between(rotation, tool[:, ROTATION_DIMS])

    swapped = tool_frame.fingers_swapped(refined)
    return torch.where((turn(swapped) < turn(refined))[:, None], swapped, refined)


def _rows_to_refine(needed: Tensor) -> Tensor:
    """Returns the rows (R,) of (B,) bool to compute: on a GPU all, which is cheaper than a synchronisation."""
    if needed.device.type != "cpu":
        return torch.arange(len(needed), device=needed.device)
    return valid_rows(needed)


def _draw(probabilities: Tensor, noise: Tensor | None) -> Tensor:
    """Draws indices (B,) from probabilities (B, K), after masking those below `MIN_ANCHOR_PROBABILITY`."""
    unlikely = (probabilities < MIN_ANCHOR_PROBABILITY) & (probabilities < probabilities.amax(dim=-1, keepdim=True))
    cumulative = probabilities.masked_fill(unlikely, 0.0).cumsum(dim=-1)
    count = len(probabilities)
    draw = torch.rand(count, device=probabilities.device) if noise is None else noise.reshape(count, -1)[:, 0]
    draw = draw[:, None].to(cumulative.dtype) * cumulative[:, -1:]
    index = torch.searchsorted(cumulative, draw, right=True).squeeze(-1)
    return index.clamp(max=probabilities.shape[-1] - 1)
