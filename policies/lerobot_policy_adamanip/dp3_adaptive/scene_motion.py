"""The motion that augmentation gives to the scenes of a batch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION_DIM, GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.common.tool_frame import mirrored_poses

SCENE_MOTION = "scene_motion"
"""Key of an augmented batch: its `SceneMotion`, by which history and labels are moved too."""


@dataclass(frozen=True)
class SceneMotion:
    """Scenes of a batch, mirrored, turned about a vertical, then shifted.

    Attributes:
        mirrored: (B,) bool, left for right; None if no scene is.
        rotation: (B, 3, 3).
        shift: (B, 3) [m].
        center: (x, y, z) [m], robot base frame, of the vertical.
    """

    mirrored: Tensor | None
    rotation: Tensor
    shift: Tensor
    center: tuple[float, float, float]

    def points(self, points: Tensor) -> Tensor:
        """Returns points (B, ..., 3+) moved [m]; numbers after the first three stay."""
        if self.mirrored is not None:
            other_side = torch.cat([points[..., :1], -points[..., 1:2], points[..., 2:]], dim=-1)
            points = self._where_mirrored(other_side, points)
        return self._turned(points)

    def poses(self, poses: Tensor) -> Tensor:
        """Returns poses (B, ..., 10+) moved; numbers after the first ten stay."""
        if self.mirrored is not None:
            other_side = torch.cat([mirrored_poses(poses[..., :ACTION_DIM]), poses[..., ACTION_DIM:]], dim=-1)
            poses = self._where_mirrored(other_side, poses)
        position = self._turned(poses[..., POSITION_DIMS])
        # Rotation 6D holds the matrix' first two rows; a turn about z mixes only these.
        rows = poses[..., ROTATION_DIMS].reshape(*poses.shape[:-1], 2, 3)
        turn = self.rotation[:, :2, :2].to(poses.dtype).reshape(len(poses), *(1,) * (poses.dim() - 2), 2, 2)
        return torch.cat([position, (turn @ rows).flatten(-2), poses[..., GRIPPER_DIM:]], dim=-1)

    def _where_mirrored(self, changed: Tensor, plain: Tensor) -> Tensor:
        assert self.mirrored is not None
        return torch.where(self.mirrored.reshape(-1, *(1,) * (plain.dim() - 1)), changed, plain)

    def _turned(self, points: Tensor) -> Tensor:
        center = torch.as_tensor(self.center, dtype=points.dtype, device=points.device)
        flat, turn = points[..., :3].reshape(len(points), -1, 3), self.rotation.transpose(1, 2).to(points.dtype)
        turned = (flat - center) @ turn + center + self.shift[:, None].to(points.dtype)
        return torch.cat([turned.reshape(*points.shape[:-1], 3), points[..., 3:]], dim=-1)
