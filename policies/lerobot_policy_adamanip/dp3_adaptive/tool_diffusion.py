"""The head ``diffusion`` in the tool's frame: the paper's method with contact events, redraws and refinement.

LeRobot's U-Net denoises the next poses, conditioned on cloud, body and action history (paper, section 4.2 and eq. 2).
"""

from __future__ import annotations

import torch
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION_DIM, GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS, STATE
from lerobot_policy_adamanip.affordance.plans import with_gripper
from lerobot_policy_adamanip.common import tool_frame
from lerobot_policy_adamanip.common.contacts import ContactMemory, Past
from lerobot_policy_adamanip.dp3_adaptive.approach import refine, refinement_loss
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.diffusion import Denoiser, DiffusionHead
from lerobot_policy_adamanip.dp3_adaptive.motions import TypicalMotions
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import instruction_dim
from lerobot_policy_adamanip.dp3_adaptive.refinement import Refiner
from lerobot_policy_adamanip.dp3_adaptive.tool_inputs import (
    POINT_DIM,
    back_off_if_blocked,
    body_dim,
    body_inputs,
    past_of,
    point_inputs,
    tool_of,
)
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

POSITION_UNIT, ROTATION_UNIT = 0.02, 0.5
"""Units of a denoised pose: positions are scaled by asinh, so that an error is small relative to the motion [m]."""


class ToolDenoiser(Denoiser):
    """The trained network: cloud encoder, memory of contact events, LeRobot's conditional U-Net, and a refiner."""

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        memory = config.memory_dim if config.n_action_history_steps else 0
        super().__init__(config, POINT_DIM, config.encoder_out_dim + body_dim(config) + memory)
        self.motions = TypicalMotions(config.num_anchors, config.refinement_spread)
        self.memory = ContactMemory(config.memory_dim) if memory else None
        self.refiner = Refiner(config.refinement_points, instruction_dim(config)) if config.num_refinements else None


class ToolDiffusionHead(DiffusionHead):
    """Loss and sampling of a `ToolDenoiser`. States and actions are poses without normalisation."""

    def network(self) -> ToolDenoiser:
        """Returns an untrained network without typical motions."""
        return ToolDenoiser(self.config)

    def loss(
        self, model: ToolDenoiser, window: Window, actions: Tensor, is_label: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the denoising error per sample (B,) with the refiner's loss, its weight (B,), and its parts."""
        error, weight, _ = super().loss(model, window, actions, is_label)
        if model.refiner is None:
            return error, weight, {}
        goal = actions[:, 0]
        index = model.motions.nearest(tool_frame.motion_between(goal, tool_of(window)))
        refinement = refinement_loss(model.refiner, model.motions, window, goal, index) * is_label[:, 0]
        parts = {"denoising_loss": error.detach().mean(), "refinement_loss": refinement.detach().mean()}
        return error + refinement, weight, parts

    def condition(self, model: ToolDenoiser, window: Window, past: Past | None = None) -> Tensor:
        """Returns the conditioning vector (B, C); its part of the memory is zero without a contact event."""
        parts = [
            model.encoder(point_inputs(self.config, window, training=model.training)),
            body_inputs(self.config, window),
        ]
        if model.memory is not None:
            past = past or past_of(window)
            parts.append(model.memory(past.events(feedback=self.config.use_feedback), past.contact))
        return torch.cat(parts, dim=-1)

    def encode(self, actions: Tensor, window: Window) -> Tensor:
        """Returns poses (B, T, 10) as denoised values, relative to the present tool."""
        relative = tool_frame.relative_poses(actions, window.observations[STATE][:, -1:, :ACTION_DIM])
        position = torch.asinh(relative[..., POSITION_DIMS] / POSITION_UNIT)
        rotation, gripper = relative[..., ROTATION_DIMS] / ROTATION_UNIT, 2 * relative[..., GRIPPER_DIM:] - 1
        return torch.cat([position, rotation, gripper], dim=-1)

    def decode(self, values: Tensor, window: Window) -> Tensor:
        """Inverts `encode`; any values become poses."""
        position = POSITION_UNIT * torch.sinh(values[..., POSITION_DIMS])
        rotation = values[..., ROTATION_DIMS] * ROTATION_UNIT
        gripper = ((values[..., GRIPPER_DIM:] + 1) / 2).clamp(0, 1)
        tool = window.observations[STATE][:, -1:, :ACTION_DIM].float()
        return tool_frame.absolute_poses(torch.cat([position, rotation, gripper], dim=-1), tool)

    def sample(self, model: ToolDenoiser, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, T, 10) from ``noise`` (B, T, 10); None draws the noise.

        A chunk whose first action leads to nothing is drawn again, up to ``num_draws`` times. If all do, the first one
        counts; but if all are useless with the present grip, the hand lets go. A hand whose way is blocked backs off.
        """
        past = past_of(window)
        condition = self.condition(model, window, past)
        chunks, usable, useless = self._draw(model, window, condition, past, noise)
        for _ in range(self.config.num_draws - 1):
            if bool(usable.all()):
                break
            others, fits, again = self._draw(model, window, condition, past, None)
            better = (fits & ~usable) | (useless & ~again)
            chunks = torch.where(better[:, None, None], others, chunks)
            usable, useless = usable | fits, useless & again
        released = with_gripper(tool_of(window), 1.0)[:, None]
        chunks = torch.where(useless[:, None, None], released, chunks)
        if model.memory is None or not self.config.avoid_repeats:
            return chunks
        return back_off_if_blocked(self.config, past, chunks)

    def _draw(
        self, model: ToolDenoiser, window: Window, condition: Tensor, past: Past, noise: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Returns chunks (B, T, 10) with a refined first action, whether they are usable, and whether useless (B,).

        Useless are motions of a closed hand that have failed with its grip, or for which it has none.
        """
        chunk = self.decode(self.denoise(model, condition, noise), window)
        tool = tool_of(window)
        motion = tool_frame.motion_between(chunk[:, 0], tool)
        index = model.motions.nearest(motion)
        first, held = refine(self.config, model.refiner, model.motions.needs_refinement(index), window, chunk[:, 0])
        rejected = useless = model.motions.never_shown(index[:, None], tool)[:, 0]
        if model.memory is not None and self.config.avoid_repeats:
            found = past.repeats(motion[:, None], self.config.failed_below)
            failed, failed_now = (part[:, 0] for part in found)
            rejected = rejected | failed | past.goes_back(motion[:, None])[:, 0]
            useless = useless | failed_now
        return torch.cat([first[:, None], chunk[:, 1:]], dim=1), held & ~rejected, useless
