"""Looks again from where it would go: corrects a pose by the points around it, seen from the pose itself.

A network that condenses a whole cloud knows where a handle is to centimetres. Around a proposed pose the same few
points look the same wherever the object stands, and every demonstrated goal teaches it from any number of poses beside
it: a denoising of poses that starts at an anchor instead of at noise, as truncated diffusion does.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_policy_adamanip.encoders import make_encoder
from lerobot_policy_adamanip.tool_frame import (
    MOTION_UNITS,
    constant,
    motion_between,
    point_features,
    points_seen,
    pose_after,
)

CORRECTION_UNITS = (0.01, 0.01, 0.01, 0.05, 0.05, 0.05)
"""What counts as one in a correction [m, m, m, rad, rad, rad]."""
AHEAD = (0.0, 0.0, 0.04)
"""Around this place in a proposed tool's frame points are gathered [m]: what the fingers are sent to is ahead."""
NEAR, SHARP = 0.1, 0.02
"""A point is told by where it is in the first unit, and by its direction, which is sharp within the second [m]."""
BESIDE_POSITION, BESIDE_ROTATION = 0.03, 0.15
"""Proposals in training are up to this far off, as standard deviations [m, rad]."""
JITTER = 0.001
"""Standard deviation of the noise on points in training [m]."""


class Refiner(nn.Module):
    """Proposes a correction of a pose from the points near it.

    Args:
        num_anchors: which of them the pose comes from tells what is looked for.
        neighbours: points looked at.
    """

    def __init__(self, num_anchors: int, neighbours: int) -> None:
        super().__init__()
        self.neighbours = neighbours
        self.encoder = make_encoder("mlp", 6, (64, 128), 128, neighbours)
        self.embedding = nn.Embedding(num_anchors, 32)
        self.out = nn.Sequential(
            nn.Linear(128 + 32 + 6, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 6)
        )

    def forward(self, cloud: Tensor, pose: Tensor, tool: Tensor, anchor: Tensor) -> Tensor:
        """Clouds (B, N, 3) [m], proposed and present poses (B, 10), anchors (B,) -> (B, 6) in `CORRECTION_UNITS`."""
        points = points_seen(cloud, pose)
        distance = (points - constant(AHEAD, points)).norm(dim=-1)
        nearest = distance.topk(min(self.neighbours, points.shape[1]), dim=1, largest=False).indices
        points = points.gather(1, nearest[..., None].expand(-1, -1, 3))
        if self.training:
            points = points + JITTER * torch.randn_like(points)
        local = self.encoder(point_features(points, NEAR, SHARP))
        way = motion_between(pose, tool)[:, :6] / constant(MOTION_UNITS[:6], points)
        correction: Tensor = self.out(torch.cat([local, self.embedding(anchor), way], dim=-1))
        return correction

    def loss(self, cloud: Tensor, goal: Tensor, tool: Tensor, anchor: Tensor) -> Tensor:
        """Returns the error (B,) of correcting a pose beside the demonstrated goal (B, 10)."""
        share = torch.rand(len(goal), 1, device=goal.device)
        aside = share * torch.randn(len(goal), 6, device=goal.device)
        aside = torch.cat([BESIDE_POSITION * aside[:, :3], BESIDE_ROTATION * aside[:, 3:], goal[:, 9:10]], dim=-1)
        proposed = pose_after(aside, goal)
        wanted = motion_between(goal, proposed)[:, :6] / constant(CORRECTION_UNITS, goal)
        found = self(cloud, proposed, tool, anchor)
        return F.smooth_l1_loss(found.float(), wanted, reduction="none").mean(dim=-1)

    def refined(self, cloud: Tensor, pose: Tensor, tool: Tensor, anchor: Tensor, steps: int) -> Tensor:
        """Returns poses (B, 10) after so many corrections; the gripper stays as it is."""
        for _ in range(steps):
            correction = self(cloud, pose, tool, anchor).float() * constant(CORRECTION_UNITS, pose)
            pose = pose_after(torch.cat([correction, pose[:, 9:10]], dim=-1), pose)
        return pose
