"""Inputs of the heads that work in the tool's frame: points, body, and contact events."""

from __future__ import annotations

import torch
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION_DIM, EFFORT, GRIPPER_DIM, POINT_CLOUD, STATE
from lerobot_policy_adamanip.affordance.plans import backed_off, with_gripper
from lerobot_policy_adamanip.common import tool_frame
from lerobot_policy_adamanip.common.contacts import Past
from lerobot_policy_adamanip.common.losses import surely_none
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, instruction_dim
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

POINT_UNIT, DIRECTION_SCALE = 0.15, 0.03
"""Units of `point_features` [m]."""
POINT_DIM = 6
"""Number of `point_features` per point."""
EFFORT_UNIT = 20.0
"""Unit of joint torques [N m]."""


def past_of(window: Window) -> Past:
    """Returns the past of a window whose states and actions are poses without normalisation."""
    commands = window.history.float()
    poses = window.observations[STATE][:, -commands.shape[1] - 1 :, :ACTION_DIM].float()
    return Past(commands, poses, window.valid)


def back_off_if_blocked(config: DP3AdaptiveConfig, past: Past, actions: Tensor) -> Tensor:
    """Returns actions (B, T, 10); an open hand whose way is blocked backs off from the present pose instead."""
    blocked = past.is_blocked(config.failed_below)
    if surely_none(blocked):
        return actions
    return torch.where(blocked[:, None, None], backed_off(with_gripper(past.poses[:, -1], 1.0))[:, None], actions)


def tool_of(window: Window) -> Tensor:
    """Returns the present tool poses (B, 10)."""
    return window.observations[STATE][:, -1, :ACTION_DIM].float()


def instruction_of(window: Window) -> Tensor:
    """Returns the instruction as a vector (B, 64), or (B, 0) for a policy that does not use it."""
    unused = window.observations[STATE][:, :, :0]
    return window.observations.get(INSTRUCTION, unused)[:, -1]


def point_inputs(config: DP3AdaptiveConfig, window: Window, *, training: bool) -> Tensor:
    """Returns features (B, N, 6) of the present cloud; in training of a random subset, with noise."""
    cloud = window.observations[POINT_CLOUD][:, -1, : config.coarse_points]
    if training:
        count = config.training_points
        if count < cloud.shape[1]:
            # Unsorted: the encoder ignores the order of points.
            kept = torch.rand(cloud.shape[:2], device=cloud.device).topk(count, dim=1, sorted=False).indices
            cloud = cloud.gather(1, kept[..., None].expand(-1, -1, cloud.shape[-1]))
        cloud = cloud + config.point_noise_std * torch.randn_like(cloud)
    seen = tool_frame.points_seen(cloud, window.observations[STATE][:, -1, :ACTION_DIM])
    return tool_frame.point_features(seen, POINT_UNIT, DIRECTION_SCALE)


def body_inputs(config: DP3AdaptiveConfig, window: Window) -> Tensor:
    """Returns (B, `body_dim`): upward direction, gripper opening, and torques and instruction if they are used."""
    tool = window.observations[STATE][:, -1, :ACTION_DIM]
    body = [tool_frame.upwards(tool), tool[:, GRIPPER_DIM:]]
    if config.use_effort:
        body.append(window.observations[EFFORT][:, -1] / EFFORT_UNIT)
    return torch.cat([*body, instruction_of(window)], dim=-1)


def body_dim(config: DP3AdaptiveConfig) -> int:
    """Returns the number of `body_inputs`."""
    effort = config.feature_size(EFFORT) if config.use_effort else 0
    return 4 + effort + instruction_dim(config)
