"""Looks again from where it would go: corrects a pose by the points around it, seen from the pose itself.

A network that condenses a whole cloud knows where a handle is to centimetres. Around a proposed pose the same few
points look the same wherever the object stands, and every demonstrated goal teaches it from any number of poses beside
it: a denoising of poses that starts at an anchor instead of at noise, as truncated diffusion does.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_policy_adamanip.common.encoders import make_encoder
from lerobot_policy_adamanip.common.tool_frame import (
    constant,
    motion_between,
    point_features,
    points_seen,
    pose_after,
)
from lerobot_policy_adamanip.common.torch_rotations import SMALL, matrix_from_rotation_vector

CORRECTION_UNITS = (0.01, 0.01, 0.01, 0.05, 0.05, 0.1, 0.1)
"""What counts as one in a correction [m, m, m, rad, rad, -, -], see `_correction`."""
AHEAD = (0.0, 0.0, 0.04)
"""Around this place in a proposed tool's frame points are gathered [m]: what the fingers are sent to is ahead."""
NEAR, SHARP = 0.1, 0.02
"""A point is told by where it is in the first unit, and by its direction, which is sharp within the second [m]."""
BESIDE_POSITION, BESIDE_ROTATION = 0.03, 0.15
"""Proposals in training are up to this far off, as standard deviations [m, rad]."""
TWISTED = 0.5
"""This share of them is also turned about the approach, by any angle: whether a lever lies or stands is seen only from
nearby, and fingers that close along it hold nothing."""
PROPOSALS = 4
"""Beside each demonstrated goal: few rows of a batch aim at anything, and this network is small."""
JITTER = 0.001
"""Standard deviation of the noise on points in training [m]."""


class Refiner(nn.Module):
    """Proposes a correction of a pose from the points near it.

    It is told neither which motion was chosen nor where the hand is. In training both are right: they would give
    the goal away, and the points would not be looked at.

    Args:
        neighbours: points looked at.
    """

    def __init__(self, neighbours: int) -> None:
        super().__init__()
        self.neighbours = neighbours
        self.encoder = make_encoder("mlp", 6, (64, 128), 128, neighbours)
        self.out = nn.Sequential(nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 7))

    def forward(self, cloud: Tensor, pose: Tensor) -> Tensor:
        """Clouds (B, N, 3) [m], proposed poses (B, 10) -> (B, 7) in `CORRECTION_UNITS`."""
        points = points_seen(cloud, pose)
        distance = (points - constant(AHEAD, points)).norm(dim=-1)
        nearest = distance.topk(min(self.neighbours, points.shape[1]), dim=1, largest=False).indices
        points = points.gather(1, nearest[..., None].expand(-1, -1, 3))
        if self.training:
            points = points + JITTER * torch.randn_like(points)
        correction: Tensor = self.out(self.encoder(point_features(points, NEAR, SHARP)))
        return correction

    def loss(self, cloud: Tensor, goal: Tensor) -> Tensor:
        """Returns the error (B,) of correcting poses beside the demonstrated goal (B, 10)."""
        cloud, goal = (part.repeat_interleave(PROPOSALS, dim=0) for part in (cloud, goal))
        proposed = pose_after(_beside(goal), goal)
        found = self(cloud, proposed).float()
        wanted = _correction(goal, proposed) / constant(CORRECTION_UNITS, goal)
        error = F.smooth_l1_loss(found, wanted, reduction="none").mean(dim=-1)
        return error.reshape(-1, PROPOSALS).mean(dim=1)

    def refined(self, cloud: Tensor, pose: Tensor, steps: int) -> Tensor:
        """Returns poses (B, 10) after so many corrections; the gripper stays as it is."""
        for _ in range(steps):
            pose = _corrected(pose, self(cloud, pose).float() * constant(CORRECTION_UNITS, pose))
        return pose


def _beside(goal: Tensor) -> Tensor:
    """Returns motions (B, 7) from goals (B, 10) to what is proposed in training."""
    share, twisted, turn = torch.rand(3, len(goal), 1, device=goal.device)
    aside = share * torch.randn(len(goal), 6, device=goal.device)
    twist = (twisted < TWISTED) * (turn - 0.5) * torch.pi
    rotation = BESIDE_ROTATION * aside[:, 3:] + F.pad(twist, (2, 0))
    return torch.cat([BESIDE_POSITION * aside[:, :3], rotation, goal[:, 9:10]], dim=-1)


def _correction(goal: Tensor, proposed: Tensor) -> Tensor:
    """Returns what leads from proposed poses to goals (B, 10): the way, the tilt of the approach, the turn about it.

    Two fingers hold alike when they have changed places. So of the turn its doubled angle is told, by cosine and sine:
    the same for both, without a jump. As an angle it would be learnt as the mean of a quarter turn to the left and one
    to the right, which is none.

    Returns:
        (B, 7): position [m, m, m], tilt about x and y [rad, rad], cosine and sine of twice the turn [-, -].
    """
    motion = motion_between(goal, proposed)
    turned = matrix_from_rotation_vector(motion[:, 3:6])
    approach = turned[:, :, 2]
    across = approach[:, :2].norm(dim=-1, keepdim=True)
    angle = torch.atan2(across, approach[:, 2:])
    tilt = approach[:, [1, 0]] * constant((-1.0, 1.0), goal) * angle / across.clamp(min=SMALL)
    left = matrix_from_rotation_vector(F.pad(tilt, (0, 1))).transpose(1, 2) @ turned
    twice = 2 * torch.atan2(left[:, 1, :1], left[:, 0, :1])
    return torch.cat([motion[:, :3], tilt, twice.cos(), twice.sin()], dim=-1)


def _corrected(pose: Tensor, correction: Tensor) -> Tensor:
    """The inverse of `_correction`: poses (B, 10) and corrections (B, 7) -> poses (B, 10), turned the shorter way."""
    way, twice = correction[:, :5], correction[:, 5:]
    turn = torch.atan2(twice[:, 1:], twice[:, :1]) / 2
    gripper = pose[:, 9:10]
    tilted = pose_after(torch.cat([F.pad(way, (0, 1)), gripper], dim=-1), pose)
    return pose_after(torch.cat([F.pad(turn, (5, 0)), gripper], dim=-1), tilted)
