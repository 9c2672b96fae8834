"""Refinement of a pose from the points around it, in the frame of the pose itself.

A network that encodes a whole cloud locates a handle only to centimetres. In the frame of a proposed pose, the points
around it look the same wherever the object stands, and each demonstrated goal gives any number of training poses. The
method is pose denoising that starts at an anchor instead of at noise, as in truncated diffusion.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import POSITION_DIMS
from lerobot_policy_adamanip.common import tool_frame
from lerobot_policy_adamanip.common.encoders import make_encoder
from lerobot_policy_adamanip.common.losses import logistic_loss
from lerobot_policy_adamanip.common.torch_rotations import SMALL, matrix_from_rotation_vector

CORRECTION_UNITS = (0.01, 0.01, 0.01, 0.05, 0.05, 0.1, 0.1)
"""Units of a `_correction` [m, m, m, rad, rad, -, -]."""
CENTRE = (0.0, 0.0, 0.04)
"""Centre of the nearest points, in a proposed tool's frame [m]: the part is ahead of the fingers."""
POINT_UNIT, DIRECTION_SCALE = 0.1, 0.02
"""Units of `point_features` [m]."""
PROPOSAL_NOISE_M, PROPOSAL_NOISE_RAD = 0.03, 0.15
"""Largest standard deviation of proposals in training."""
TWIST_PROBABILITY = 0.5
"""Share of proposals that are also turned about the approach by any angle. Whether a lever lies or stands is visible
only from nearby, and fingers that close along it hold nothing."""
PROPOSALS_PER_GOAL = 4
"""Number of proposals near each goal: few rows of a batch need refinement, and this network is small. One more is
elsewhere on the cloud, where there is nothing to hold."""
ELSEWHERE_M = 0.08
"""Least distance of that one from the goal."""
POINT_NOISE_M = 0.001
"""Standard deviation of the noise on points in training."""


class Refiner(nn.Module):
    """Network that predicts, from the points near a pose, its correction and whether there is something to hold.

    Its inputs exclude the chosen motion and the hand's pose: in training both are exact and would reveal the goal. They
    include the instruction (B, I), if policies use it: what there is to hold depends on the task.
    """

    def __init__(self, neighbours: int, instruction_dim: int = 0) -> None:
        super().__init__()
        self.neighbours = neighbours
        self.encoder = make_encoder("mlp", 6, (64, 128), 128, neighbours)
        layers = (nn.Linear(128 + instruction_dim, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 8))
        self.out = nn.Sequential(*layers)

    def forward(self, cloud: Tensor, pose: Tensor, instruction: Tensor) -> tuple[Tensor, Tensor]:
        """Returns corrections (B, 7) of poses (B, 10) in clouds (B, N, 3) [m], and logits (B,) of something to hold.

        Corrections are in `CORRECTION_UNITS`.
        """
        points = tool_frame.points_seen(cloud, pose)
        distance = (points - tool_frame.constant(CENTRE, points)).norm(dim=-1)
        nearest = distance.topk(min(self.neighbours, points.shape[1]), dim=1, largest=False).indices
        points = points.gather(1, nearest[..., None].expand(-1, -1, 3))
        if self.training:
            points = points + POINT_NOISE_M * torch.randn_like(points)
        features = self.encoder(tool_frame.point_features(points, POINT_UNIT, DIRECTION_SCALE))
        out = self.out(torch.cat([features, instruction], dim=-1)).float()
        return out[:, :7], out[:, 7]

    def loss(self, cloud: Tensor, goal: Tensor, instruction: Tensor) -> Tensor:
        """Returns the error (B,) of corrections and logits, from proposals around the demonstrated goals (B, 10)."""
        rows = torch.arange(len(goal), device=goal.device)
        near = rows.repeat_interleave(PROPOSALS_PER_GOAL)
        proposed = tool_frame.pose_after(sample_proposals(goal[near]), goal[near])
        target = _correction(goal[near], proposed) / tool_frame.constant(CORRECTION_UNITS, goal)
        elsewhere, far = sample_elsewhere(cloud, goal)
        both = torch.cat([near, rows])
        correction, logit = self(cloud[both], torch.cat([proposed, elsewhere]), instruction[both])
        error = F.smooth_l1_loss(correction[: len(near)], target, reduction="none").mean(dim=-1)
        error = error + logistic_loss(logit[: len(near)], torch.ones_like(error)) / 2
        wrong = far * logistic_loss(logit[len(near) :], torch.zeros_like(far)) / 2
        return error.reshape(-1, PROPOSALS_PER_GOAL).mean(dim=1) + wrong

    def refined(
        self, cloud: Tensor, pose: Tensor, instruction: Tensor, steps: int, reach: float
    ) -> tuple[Tensor, Tensor]:
        """Returns poses (B, 10) after ``steps`` corrections, and whether there is something to hold (B,).

        There is nothing if the corrections add up to more than ``reach`` [m]; they are cut there. The gripper stays.
        """
        start, logit = pose, torch.zeros_like(pose[:, 0])
        for _ in range(steps):
            correction, logit = self(cloud, pose, instruction)
            pose = _corrected(pose, correction * tool_frame.constant(CORRECTION_UNITS, pose))
        shift = pose[:, POSITION_DIMS] - start[:, POSITION_DIMS]
        length = shift.norm(dim=-1, keepdim=True)
        kept = start[:, POSITION_DIMS] + shift * (reach / length.clamp(min=reach))
        pose = torch.cat([kept, pose[:, POSITION_DIMS.stop :]], dim=-1)
        return pose, (logit >= 0) & (length.squeeze(-1) < reach)


def sample_elsewhere(cloud: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
    """Returns proposals (B, 10) at random points of clouds (B, N, 3) [m], and whether they are far from goals (B,).

    They are turned from the goals (B, 10) as other proposals are.
    """
    index = torch.randint(cloud.shape[1], (len(goal),), device=goal.device)
    place = cloud[torch.arange(len(goal), device=goal.device), index]
    turned = tool_frame.pose_after(sample_proposals(goal), goal)
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


def _correction(goal: Tensor, proposed: Tensor) -> Tensor:
    """Returns corrections from proposed poses to goals (B, 10): translation, tilt of the approach, turn about it.

    A grasp with swapped fingers is equivalent. So the turn is encoded as cosine and sine of its doubled angle, equal
    for both grasps and continuous. A plain angle would be learnt as the mean of a quarter turn to either side.
    """
    motion = tool_frame.motion_between(goal, proposed)
    turned = matrix_from_rotation_vector(motion[:, 3:6])
    approach = turned[:, :, 2]
    across = approach[:, :2].norm(dim=-1, keepdim=True)
    angle = torch.atan2(across, approach[:, 2:])
    tilt = approach[:, [1, 0]] * tool_frame.constant((-1.0, 1.0), goal) * angle / across.clamp(min=SMALL)
    left = matrix_from_rotation_vector(F.pad(tilt, (0, 1))).transpose(1, 2) @ turned
    twice = 2 * torch.atan2(left[:, 1, :1], left[:, 0, :1])
    return torch.cat([motion[:, :3], tilt, twice.cos(), twice.sin()], dim=-1)


def _corrected(pose: Tensor, correction: Tensor) -> Tensor:
    """Inverts `_correction`: poses (B, 10) and corrections (B, 7) -> poses (B, 10), turned the shorter way."""
    way, twice = correction[:, :5], correction[:, 5:]
    turn = torch.atan2(twice[:, 1:], twice[:, :1]) / 2
    gripper = pose[:, 9:10]
    tilted = tool_frame.pose_after(torch.cat([F.pad(way, (0, 1)), gripper], dim=-1), pose)
    return tool_frame.pose_after(torch.cat([F.pad(turn, (5, 0)), gripper], dim=-1), tilted)
