"""Base of the heads in the tool's frame: their inputs."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from lerobot_adamanip.contract.schema import ACTION_DIM, EFFORT, GRIPPER_DIM, POINT_CLOUD, STATE
from lerobot_adamanip.episode.felt_tries import MIN_SHIFT_M, MIN_TURN_RAD
from lerobot_policy_adamanip.common import geometry
from lerobot_policy_adamanip.common.contacts import Past
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, instruction_dim

POINT_UNIT, DIRECTION_SCALE = 0.15, 0.03
"""Units of `geometry.point_features` [m]."""
POINT_DIM = 6
"""Number of `geometry.point_features` per point."""
POINT_NOISE_M = 0.002
"""Standard deviation of noise on points in training."""
EFFORT_UNIT = 20.0
"""Unit of joint torques [N m]."""


class ToolHead(nn.Module):
    """Base class of the heads in the tool's frame. States and actions are poses.

    A head's ``loss(window, actions, is_label)`` returns a loss per sample (B,), its weight (B,), and its parts as
    metrics, for labels ``actions`` (B, T, A) where ``is_label`` (B, T) is true. ``sample(window, noise)`` draws actions
    (B, T, A).
    """

    MIN_MOTION: ClassVar = (MIN_SHIFT_M, MIN_TURN_RAD)
    """Least motion of a contact event [m, rad]."""
    config: DP3AdaptiveConfig
    memory: nn.Module | None

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
        return Past(commands, states.float(), window.valid, self.MIN_MOTION)

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
