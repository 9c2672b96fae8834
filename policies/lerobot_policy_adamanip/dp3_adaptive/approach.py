"""Refinement of drawn approaches, shared by the heads that work in the tool's frame."""

from __future__ import annotations

import torch
from torch import Tensor

from lerobot_adamanip.contract.schema import POINT_CLOUD, ROTATION_DIMS
from lerobot_policy_adamanip.common import tool_frame
from lerobot_policy_adamanip.common.losses import surely_none, valid_rows
from lerobot_policy_adamanip.common.torch_rotations import angle_between
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.motions import TypicalMotions
from lerobot_policy_adamanip.dp3_adaptive.refinement import Refiner
from lerobot_policy_adamanip.dp3_adaptive.tool_inputs import instruction_of, tool_of
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window


def refinement_loss(refiner: Refiner, motions: TypicalMotions, window: Window, goal: Tensor, index: Tensor) -> Tensor:
    """Returns the refiner's loss (B,) for goals (B, 10), zero where the anchor (B,) needs no refinement."""
    needed = motions.needs_refinement(index)
    rows = _rows_to_refine(needed)
    cloud, instruction = window.observations[POINT_CLOUD][rows, -1], instruction_of(window)[rows]
    loss = refiner.loss(cloud, goal[rows], instruction) * needed[rows]
    return torch.zeros_like(goal[:, 0]).index_add(0, rows, loss.to(goal.dtype))


def refine(
    config: DP3AdaptiveConfig, refiner: Refiner | None, needed: Tensor, window: Window, pose: Tensor
) -> tuple[Tensor, Tensor]:
    """Returns poses (B, 10), refined where ``needed`` (B,), and whether they can be used (B,).

    An approach cannot be used if there is nothing to hold at its end.
    """
    usable = torch.ones_like(needed)
    if refiner is None or surely_none(needed):
        return pose, usable
    rows = _rows_to_refine(needed)
    cloud, start = window.observations[POINT_CLOUD][rows, -1], pose[rows]
    instruction = instruction_of(window)[rows]
    refined, held = refiner.refined(cloud, start, instruction, config.num_refinements, config.refinement_reach)
    refined = _less_turned(refined, start, tool_of(window)[rows])
    pose = torch.where(needed[:, None], pose.index_copy(0, rows, refined), pose)
    return pose, usable.index_copy(0, rows, held) | ~needed


def _less_turned(refined: Tensor, chosen: Tensor, tool: Tensor) -> Tensor:
    """Returns poses (B, 10), with fingers swapped where that is a smaller turn.

    The turn is measured against the chosen pose, which is seldom wrong by more than a quarter turn, and against the
    hand: half a turn more is often out of the arm's reach.
    """
    swapped = tool_frame.fingers_swapped(refined)
    grasps, others = torch.stack([refined, swapped])[:, None], torch.stack([chosen, tool])
    turn, turn_swapped = angle_between(grasps[..., ROTATION_DIMS], others[..., ROTATION_DIMS]).sum(dim=1)
    return torch.where((turn_swapped < turn)[:, None], swapped, refined)


def _rows_to_refine(needed: Tensor) -> Tensor:
    """Returns the rows (R,) of (B,) bool to compute: on a GPU all, which is cheaper than a synchronisation."""
    if needed.device.type != "cpu":
        return torch.arange(len(needed), device=needed.device)
    return valid_rows(needed)
