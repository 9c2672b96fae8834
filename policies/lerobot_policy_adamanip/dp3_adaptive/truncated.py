"""The head for key frames: truncated diffusion from anchors (DiffusionDrive, Liao et al., CVPR 2025, arXiv 2411.15139).

Motions in contact are millimetres long, approaches decimetres. So motions are clustered (k-means), and each centre is
an *anchor*. The network gives each anchor a score, and denoises the residual of the drawn one from a Gaussian of its
cluster's spread. A residual is in units of that spread, so its error is small relative to the motion. The scores keep
the two directions of a knob apart, and take the memory.

A network that encodes a whole cloud locates a handle only to centimetres. In the frame of a proposed pose, the points
around it look the same wherever the object stands, and each demonstrated goal gives any number of training poses. So a
`Refiner` corrects the pose of an approach from the points near it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.keyframes import CLOSED_HAND
from lerobot_adamanip.contract.schema import ACTION_DIM, EFFORT, GRIPPER_DIM, POINT_CLOUD, POSITION_DIMS, STATE
from lerobot_policy_adamanip.common import geometry
from lerobot_policy_adamanip.common.config import EVENTS
from lerobot_policy_adamanip.common.contacts import ChoiceMemory, MotionCode, Past, make_memory, surely_none
from lerobot_policy_adamanip.common.encoders import PointNetEncoder
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.common.motion_clusters import cluster_motions
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.no_repeat import allowed_probabilities, repeats_failure
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, instruction_dim

POINT_UNIT, DIRECTION_SCALE = 0.15, 0.03
"""Units of `geometry.point_features` [m]."""
POINT_DIM = 6
"""Number of `geometry.point_features` per point."""
POINT_NOISE_M = 0.002
"""Standard deviation of noise on points in training."""
EFFORT_UNIT = 20.0
"""Unit of joint torques [N m]."""
MIN_TRANSLATION_M = 0.02
"""Least length of an approach that is refined."""
MIN_ENDPOINT_SPREAD_M = 0.006
"""An anchor's approaches are refined if their end points have a larger standard deviation."""
TRUNCATION = 1.0
"""Angle a of the strongest noise, pi/2 for noise alone: residuals have a share cos a of signal and sin a of noise."""
NOISES_PER_MOTION = 4
"""Number of noisy versions of a motion in a batch: the denoiser is small, compared with the encoder."""
CORRECTION_UNITS = (0.01, 0.01, 0.01, 0.05, 0.05, 0.1, 0.1)
"""Units of a `geometry.grasp_correction` [m, m, m, rad, rad, -, -]."""
CENTRE = (0.0, 0.0, 0.04)
"""Centre of the nearest points, in a proposed tool's frame [m]: the part is ahead of the fingers."""
NEAR_UNIT, NEAR_DIRECTION_SCALE = 0.1, 0.02
"""Units of `geometry.point_features` near a pose [m]."""
PROPOSAL_NOISE_M, PROPOSAL_NOISE_RAD = 0.03, 0.15
"""Largest standard deviation of proposals in training."""
TWIST_PROBABILITY = 0.5
"""Share of proposals that are also turned about the approach by any angle. Whether a lever lies or stands is visible
only from nearby, and fingers that close along it hold nothing."""
PROPOSALS_PER_GOAL = 4
"""Number of proposals near each goal: few rows of a batch need refinement, and this network is small. One more is
elsewhere on the cloud, where there is nothing to hold."""
ELSEWHERE_M = 0.08
"""Least distance from the goal of a proposal elsewhere."""
NEAR_NOISE_M = 0.001
"""Standard deviation of the noise on points near a pose in training."""
REACH_M = 0.1
"""Largest shift by refinement; a pose that would shift further has nothing to hold."""


class ToolHead(nn.Module):
    """Base class of the heads in the tool's frame. States and actions are poses.

    A head's ``loss(window, actions, is_label)`` returns a loss per sample (B,), its weight (B,), and its parts as
    metrics, for labels ``actions`` (B, T, A) where ``is_label`` (B, T) is true. ``sample(window, noise)`` draws actions
    (B, T, A).
    """

    IS_DENSE: ClassVar = False
    """Whether the head acts at control rate."""
    READS_MISSES: ClassVar = True
    """Whether the memory also reads key frames that closed the hand on nothing."""
    config: DP3AdaptiveConfig

    @staticmethod
    def body_dim(config: DP3AdaptiveConfig) -> int:
        """Returns the number of `body_inputs`."""
        return 4 + (config.feature_size(EFFORT) if config.use_effort else 0) + instruction_dim(config)

    def tool(self, window: Window) -> Tensor:
        """Returns the present tool poses (B, 10)."""
        return window.observations[STATE][:, -1, :ACTION_DIM].float()

    def past(self, window: Window) -> Past:
        """Returns the past key frames, or at control rate strokes."""
        commands = window.history.float()
        states = window.observations[STATE][:, -commands.shape[1] - 1 :, :ACTION_DIM]
        return Past(commands, states.float(), window.valid, self.IS_DENSE)

    def remembered(self, window: Window) -> tuple[Tensor, Tensor]:
        """Returns `Past.events` (B, H, 16) and the mask (B, H) of those that the memory reads."""
        past = self.past(window)
        contact = past.contact | past.missed | past.ends if self.READS_MISSES else past.contact
        read = contact if self.config.memory_kind == EVENTS else past.valid
        if (latest := self.config.inference.latest_events) and not self.training:
            read = read & (read.flip(1).cumsum(dim=1).flip(1) <= latest)
        return past.events(feedback=self.config.use_feedback), read

    def point_inputs(self, window: Window) -> Tensor:
        """Returns features (B, N, 6) of the present cloud; in training of a random subset, with noise."""
        cloud = window.observations[POINT_CLOUD][:, -1, : self.config.coarse_points]
        if self.training:
            count = self.config.training_points
            if count < cloud.shape[1]:
                # Unsorted: the encoder ignores the order of points.
                kept = torch.rand(cloud.shape[:2], device=cloud.device).topk(count, dim=1, sorted=False).indices
                cloud = cloud.gather(1, kept[..., None].expand(-1, -1, cloud.shape[-1]))
            cloud = cloud + POINT_NOISE_M * torch.randn_like(cloud)
        seen = geometry.points_seen(cloud, window.observations[STATE][:, -1, :ACTION_DIM])
        return geometry.point_features(seen, POINT_UNIT, DIRECTION_SCALE)

    def body_inputs(self, window: Window) -> Tensor:
        """Returns (B, `body_dim`): upward direction, gripper opening, and torques and instruction if they are used."""
        tool = window.observations[STATE][:, -1, :ACTION_DIM]
        body = [geometry.upwards(tool), tool[:, GRIPPER_DIM:]]
        if self.config.use_effort:
            body.append(window.observations[EFFORT][:, -1] / EFFORT_UNIT)
        return torch.cat([*body, self.instruction(window)], dim=-1)

    def instruction(self, window: Window) -> Tensor:
        """Returns the instruction as a vector (B, 64), or (B, 0) for a policy that does not use it."""
        unused = window.observations[STATE][:, :, :0]
        return window.observations.get(INSTRUCTION, unused)[:, -1]


class TruncatedHead(ToolHead):
    """Scores the anchors, draws one, denoises its residual and refines the pose.

    The memory changes only the scores, and only after a contact event or a grasp of nothing. Before one, they are those
    of a network without a history.
    """

    memory: ChoiceMemory | None

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        super().__init__()
        self.config = config
        self.motions = TypicalMotions(config.num_anchors)
        self.encoder = PointNetEncoder(POINT_DIM, config.encoder_dims, config.encoder_out_dim)
        features, width = config.encoder_out_dim + self.body_dim(config), config.trunk_dim
        self.trunk = nn.Sequential(nn.Linear(features, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.logits, self.denoiser = nn.Linear(width, config.num_anchors), Denoiser(width, config.num_anchors)
        refinements = (config.num_refinements, config.refinement_points, instruction_dim(config))
        self.refiner = Refiner(*refinements) if config.num_refinements else None
        # Last, so that the weights above start as those of a network without a memory.
        self.memory = None
        if config.n_action_history_steps:
            events = make_memory(config.memory_kind, config.memory_dim, config.n_action_history_steps)
            self.memory = ChoiceMemory(events, config.memory_dim, width, config.num_anchors)
        self.register_load_state_dict_pre_hook(_leave_out_parts)  # type: ignore[no-untyped-call]

    def forward(self, window: Window) -> tuple[Tensor, Tensor, Tensor | None]:
        """Returns features (B, W), logits (B, K) without memory, and what the memory adds to the logits."""
        features = torch.cat([self.encoder(self.point_inputs(window)), self.body_inputs(window)], dim=-1)
        features = self.trunk(features)
        if self.memory is None:
            return features, self.logits(features), None
        return features, self.logits(features), self.memory(features, *self.remembered(window))

    def loss(self, window: Window, actions: Tensor, is_label: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the losses of choice, memory, denoising and refinement; labels are poses (B, 1, 10)."""
        motions, goal = self.motions, actions[:, 0]
        motion = geometry.motion_between(goal, window.observations[STATE][:, -1, :ACTION_DIM])
        index = motions.nearest(motion)
        features, logits, added = self(window)
        losses = {"choice_loss": F.cross_entropy(logits, index, reduction="none")}
        if added is not None:
            # Trains the memory alone: the choice without it must not depend on it.
            losses["memory_loss"] = F.cross_entropy(logits.detach() + added, index, reduction="none")
        if self.memory is not None and isinstance(self.memory.events, MotionCode):
            losses["code_loss"] = self.memory.events.loss(*self.remembered(window))
        residual = (motion - motions.anchors[index]) / motions.spread[index]
        losses["denoising_loss"] = self.denoiser.loss(features, index, residual)
        if self.refiner is not None:
            needed, cloud = motions.needs_refinement(index), window.observations[POINT_CLOUD][:, -1]
            losses["refinement_loss"] = self.refiner.loss_where(needed, cloud, goal, self.instruction(window))
        total = torch.stack(list(losses.values())).sum(dim=0)
        weight = is_label[:, 0].to(total.dtype)
        shares = weight / weight.sum().clamp(min=1)
        return total, weight, {name: (loss.detach() * shares).sum() for name, loss in losses.items()}

    def sample(self, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, 1, 10). Uniform ``noise`` (B, ...) in [0, 1): its first value selects the anchor, its last
        seven are the noise of residuals.
        """
        inference, tool = self.config.inference, self.tool(window)
        features, logits, added = self(window)
        logits = logits.float()
        if added is not None and inference.memory:
            logits = logits + added.float()
        choice, start = self._noises(len(tool), noise, logits)
        residuals = self.denoiser.sample(features, start, self.config.num_inference_steps)
        drawn = self.motions.anchors + residuals * self.motions.spread
        probabilities = (logits / inference.temperature).softmax(dim=-1)
        if inference.no_repeat:
            opens = self.motions.anchors[:, -1] >= CLOSED_HAND
            probabilities = allowed_probabilities(probabilities, *repeats_failure(self.past(window), drawn), opens)
        index = draw_anchor(probabilities, choice)
        motion = drawn[torch.arange(len(tool), device=tool.device), index]
        pose = geometry.pose_after(torch.cat([motion[:, :6], motion[:, 6:].clamp(0, 1)], dim=-1), tool)
        if self.refiner is not None:
            needed, cloud = self.motions.needs_refinement(index), window.observations[POINT_CLOUD][:, -1]
            pose = self.refiner.refine_where(needed, cloud, pose, self.instruction(window))
        return pose[:, None]

    def _noises(self, count: int, noise: Tensor | None, like: Tensor) -> tuple[Tensor, Tensor]:
        """Returns uniform numbers (B,) that select anchors, and Gaussian noise (B, 1, 7), from ``noise``."""
        drawn = torch.rand(count, 1 + geometry.MOTION_DIM, device=like.device)
        if noise is not None:
            given = noise.reshape(count, -1)
            drawn[:, 0], drawn[:, 1:] = given[:, 0], given[:, -geometry.MOTION_DIM :]
        uniform = drawn[:, 1:].clamp(1e-6, 1 - 1e-6)  # finite as a normal deviate
        return drawn[:, 0], torch.special.ndtri(uniform)[:, None]


def draw_anchor(probabilities: Tensor, noise: Tensor) -> Tensor:
    """Draws indices (B,) from probabilities (B, K) by uniform noise (B,)."""
    cumulative = probabilities.cumsum(dim=-1)
    draw = noise[:, None].to(cumulative.dtype) * cumulative[:, -1:]
    index = torch.searchsorted(cumulative, draw, right=True).squeeze(-1)
    return index.clamp(max=probabilities.shape[-1] - 1)


class TypicalMotions(nn.Module):
    """Centres of the demonstrated motions' clusters, as in Behavior Transformers.

    Attributes:
        anchors: (K, 7) motions in the tool's frame [m, rad, -].
        spread: (K, 7) standard deviations; zero before `fit`.
    """

    anchors: Tensor
    spread: Tensor

    def __init__(self, count: int) -> None:
        super().__init__()
        self.register_buffer("anchors", torch.zeros(count, geometry.MOTION_DIM))
        self.register_buffer("spread", torch.zeros(count, geometry.MOTION_DIM))

    def fit(self, motions: Tensor) -> None:
        """Fits the anchors to demonstrated motions (M, 7)."""
        anchors, spread = cluster_motions(motions.numpy(), len(self.anchors))
        self.anchors.copy_(anchors)
        self.spread.copy_(spread)

    def nearest(self, motion: Tensor) -> Tensor:
        """Returns the index (...) of the nearest anchor of each motion (..., 7)."""
        difference = (motion[..., None, :] - self.anchors) / geometry.constant(geometry.MOTION_UNITS, motion)
        return difference.square().sum(dim=-1).argmin(dim=-1)

    def needs_refinement(self, index: Tensor) -> Tensor:
        """Returns whether anchors (...) are approaches of an open hand whose end points vary.

        A closed hand is guided by the part that it holds, and a hand that releases stays where it is.
        """
        approaches = (self.anchors[:, -1] > CLOSED_HAND) & (self.anchors[:, :3].norm(dim=-1) > MIN_TRANSLATION_M)
        varying: Tensor = approaches & (self.spread[:, :3].amax(dim=-1) > MIN_ENDPOINT_SPREAD_M)
        return varying[index]


class Denoiser(nn.Module):
    """Denoises residuals of anchors, in units of their clusters' spread.

    In these units the residuals of a cluster have mean 0 and variance 1, and so have their noisy versions at each
    level. Sampling can therefore start amid the diffusion, at `TRUNCATION`, from Gaussian noise around the anchor.

    Args:
        width: number of features of an observation, and width of the layers.
        anchors: number of anchors.
    """

    def __init__(self, width: int, anchors: int) -> None:
        super().__init__()
        self.features, self.anchor = nn.Linear(width, width), nn.Embedding(anchors, width)
        self.noisy = nn.Linear(geometry.MOTION_DIM + 2, width)
        self.out = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, geometry.MOTION_DIM))

    def forward(self, features: Tensor, index: Tensor, noisy: Tensor, angle: Tensor) -> Tensor:
        """Returns clean residuals (B, K, 7) of noisy ones.

        Args:
            features: of the observations (B, W).
            index: anchors (B, K).
            noisy: residuals (B, K, 7) with a share cos a of signal and sin a of Gaussian noise.
            angle: a, (B, K) or for all ().
        """
        level = torch.stack([angle.cos(), angle.sin()], dim=-1).expand(*noisy.shape[:-1], 2)
        hidden = self.features(features)[:, None] + self.anchor(index) + self.noisy(torch.cat([noisy, level], dim=-1))
        clean: Tensor = self.out(hidden).float()
        return clean

    def loss(self, features: Tensor, index: Tensor, residual: Tensor) -> Tensor:
        """Returns the error (B,) of the residuals (B, 7) of anchors (B,), denoised from random levels."""
        residual, index = (
            value[:, None].expand(-1, NOISES_PER_MOTION, *value.shape[1:]) for value in (residual, index)
        )
        angle = TRUNCATION * torch.rand(index.shape, device=index.device)
        noisy = angle.cos()[..., None] * residual + angle.sin()[..., None] * torch.randn_like(residual)
        error = F.smooth_l1_loss(self(features, index, noisy, angle), residual, reduction="none")
        return error.mean(dim=(1, 2))

    def sample(self, features: Tensor, start: Tensor, steps: int) -> Tensor:
        """Draws a residual of each anchor (B, K, 7) from Gaussian noise (B, 1, 7) by DDIM, in float32."""
        count = self.anchor.num_embeddings
        index, sample = torch.arange(count, device=start.device).expand(len(start), -1), start.expand(-1, count, -1)
        angles = TRUNCATION * torch.linspace(1, 0, steps + 1, device=start.device)
        for angle, following in pairwise(angles):
            clean = self(features, index, sample, angle)
            noise = (sample - angle.cos() * clean) / angle.sin()
            sample = following.cos() * clean + following.sin() * noise
        return sample


class Refiner(nn.Module):
    """Network that predicts, from the points near a pose, its correction and whether there is something to hold.

    Its inputs exclude the chosen motion and the hand's pose: in training both are exact and would reveal the goal. They
    include the instruction (B, I), if policies use it: what there is to hold depends on the task.

    Args:
        steps: number of corrections at run time.
        neighbours: number of points near a pose that it sees.
        instruction_dim: length of the instruction; 0 without one.
    """

    def __init__(self, steps: int, neighbours: int, instruction_dim: int = 0) -> None:
        super().__init__()
        self.steps, self.neighbours = steps, neighbours
        self.encoder = PointNetEncoder(POINT_DIM, (64, 128), 128)
        layers = (nn.Linear(128 + instruction_dim, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 8))
        self.out = nn.Sequential(*layers)

    def forward(self, cloud: Tensor, pose: Tensor, instruction: Tensor) -> tuple[Tensor, Tensor]:
        """Returns corrections (B, 7) of poses (B, 10) in clouds (B, N, 3) [m], and logits (B,) of something to hold.

        Corrections are in `CORRECTION_UNITS`. Only training uses the logits.
        """
        points = geometry.points_seen(cloud, pose)
        distance = (points - geometry.constant(CENTRE, points)).norm(dim=-1)
        nearest = distance.topk(min(self.neighbours, points.shape[1]), dim=1, largest=False).indices
        points = points.gather(1, nearest[..., None].expand(-1, -1, 3))
        if self.training:
            points = points + NEAR_NOISE_M * torch.randn_like(points)
        features = self.encoder(geometry.point_features(points, NEAR_UNIT, NEAR_DIRECTION_SCALE))
        out = self.out(torch.cat([features, instruction], dim=-1)).float()
        return out[:, :7], out[:, 7]

    def loss_where(self, needed: Tensor, cloud: Tensor, goal: Tensor, instruction: Tensor) -> Tensor:
        """Returns the loss (B,) for goals (B, 10) in clouds (B, N, 3); zero where not ``needed`` (B,)."""
        rows = _rows_to_compute(needed)
        loss = self.loss(cloud[rows], goal[rows], instruction[rows]) * needed[rows]
        return torch.zeros_like(goal[:, 0]).index_add(0, rows, loss.to(goal.dtype))

    def refine_where(self, needed: Tensor, cloud: Tensor, pose: Tensor, instruction: Tensor) -> Tensor:
        """Returns poses (B, 10), refined where ``needed`` (B,)."""
        if surely_none(needed):
            return pose
        rows = _rows_to_compute(needed)
        refined = self.refined(cloud[rows], pose[rows], instruction[rows])
        return torch.where(needed[:, None], pose.index_copy(0, rows, refined), pose)

    def loss(self, cloud: Tensor, goal: Tensor, instruction: Tensor) -> Tensor:
        """Returns the error (B,) of corrections and logits, from proposals around the demonstrated goals (B, 10)."""
        rows = torch.arange(len(goal), device=goal.device)
        near = rows.repeat_interleave(PROPOSALS_PER_GOAL)
        proposed = geometry.pose_after(sample_proposals(goal[near]), goal[near])
        target = geometry.grasp_correction(goal[near], proposed) / geometry.constant(CORRECTION_UNITS, goal)
        elsewhere, far = sample_elsewhere(cloud, goal)
        both = torch.cat([near, rows])
        correction, logit = self(cloud[both], torch.cat([proposed, elsewhere]), instruction[both])
        error = F.smooth_l1_loss(correction[: len(near)], target, reduction="none").mean(dim=-1)
        is_near = torch.cat([torch.ones_like(error), torch.zeros_like(far)])
        held = F.binary_cross_entropy_with_logits(logit, is_near, reduction="none")
        error = error + held[: len(near)] / 2
        wrong = far * held[len(near) :] / 2
        return error.reshape(-1, PROPOSALS_PER_GOAL).mean(dim=1) + wrong

    def refined(self, cloud: Tensor, pose: Tensor, instruction: Tensor) -> Tensor:
        """Returns poses (B, 10) after ``steps`` corrections; their total shift ends at `REACH_M`. The gripper stays."""
        start = pose
        for _ in range(self.steps):
            correction, _ = self(cloud, pose, instruction)
            pose = geometry.corrected_grasp(pose, correction * geometry.constant(CORRECTION_UNITS, pose))
        shift = pose[:, POSITION_DIMS] - start[:, POSITION_DIMS]
        length = shift.norm(dim=-1, keepdim=True)
        kept = start[:, POSITION_DIMS] + shift * (REACH_M / length.clamp(min=REACH_M))
        return torch.cat([kept, pose[:, POSITION_DIMS.stop :]], dim=-1)


def _rows_to_compute(needed: Tensor) -> Tensor:
    """Returns the rows (R,) of (B,) bool to compute: on a GPU all, which is cheaper than a synchronisation.

    At least one, to be given zero weight: thus every weight has a gradient in every step.
    """
    if needed.device.type != "cpu":
        return torch.arange(len(needed), device=needed.device)
    rows = needed.nonzero().squeeze(-1)
    return rows if len(rows) else rows.new_zeros(1)


def sample_elsewhere(cloud: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
    """Returns proposals (B, 10) at random points of clouds (B, N, 3) [m], and whether they are far from goals (B,).

    They are turned from the goals (B, 10) as other proposals are.
    """
    index = torch.randint(cloud.shape[1], (len(goal),), device=goal.device)
    place = cloud[torch.arange(len(goal), device=goal.device), index]
    turned = geometry.pose_after(sample_proposals(goal), goal)
    at = turned[:, POSITION_DIMS] - goal[:, POSITION_DIMS] + place
    far = (at - goal[:, POSITION_DIMS]).norm(dim=-1) > ELSEWHERE_M
    return torch.cat([at, turned[:, POSITION_DIMS.stop :]], dim=-1), far.to(goal.dtype)


def sample_proposals(goal: Tensor) -> Tensor:
    """Draws motions (B, 7) from goals (B, 10) to the proposals of a training step."""
    share, twisted, turn = torch.rand(3, len(goal), 1, device=goal.device)
    offset = share * torch.randn(len(goal), 6, device=goal.device)
    twist = (twisted < TWIST_PROBABILITY) * (turn - 0.5) * torch.pi
    rotation = PROPOSAL_NOISE_RAD * offset[:, 3:] + F.pad(twist, (2, 0))
    return torch.cat([PROPOSAL_NOISE_M * offset[:, :3], rotation, goal[:, 9:10]], dim=-1)


def _leave_out_parts(head: TruncatedHead, weights: dict[str, Tensor], prefix: str, *_: object) -> None:
    """Removes the weights of a memory or a refiner from those that are loaded into a head that has none.

    Nothing else was trained with them, so the rest is the policy without a history or without refinement.
    """
    parts = {"memory": head.memory, "refiner": head.refiner}
    absent = tuple(f"{prefix}{name}." for name, part in parts.items() if part is None)
    for name in [name for name in weights if name.startswith(absent)]:
        del weights[name]
