"""The head ``anchors``: draws one of the demonstrations' typical motions, adds a residual and refines the pose.

Motions in contact are millimetres long, approaches decimetres. Motions are clustered (k-means, as in Behavior
Transformers), and the network classifies the next cluster, which keeps the two directions of a knob apart. The
residual's unit is the spread of its cluster, so its error is small relative to the motion. It is no diffusion.

The memory moves the choice alone, and only after a contact event. Before, the network's logits are those without a
history; the rules of `avoid_repeats` act earlier.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.keyframes import CLOSED_HAND
from lerobot_adamanip.contract.schema import ACTION_DIM, STATE
from lerobot_policy_adamanip.common import tool_frame
from lerobot_policy_adamanip.common.contacts import ContactMemory, Past
from lerobot_policy_adamanip.common.encoders import make_encoder
from lerobot_policy_adamanip.dp3_adaptive.approach import refine, refinement_loss
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
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

GOING_BACK = 20.0
"""Logit taken from motions that go back: any other one is more probable, but if all do, the likeliest still is."""


class MemoryOfChoices(nn.Module):
    """Adds to the logits of anchors what the contact events say of them; exactly zero without a contact event."""

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        super().__init__()
        self.events = ContactMemory(config.memory_dim)
        self.hidden = nn.Sequential(nn.Linear(config.trunk_dim + config.memory_dim, 128), nn.ReLU())
        self.logits = nn.Linear(128, config.num_anchors)
        nn.init.zeros_(self.logits.weight)
        nn.init.zeros_(self.logits.bias)

    def forward(self, features: Tensor, happened: Tensor, contact: Tensor) -> Tensor:
        """Features (B, W), which get no gradient, `Past.events` (B, H, 16), `Past.contact` (B, H) -> (B, K)."""
        added: Tensor = self.logits(self.hidden(torch.cat([features.detach(), self.events(happened, contact)], dim=-1)))
        return added * contact.any(dim=1, keepdim=True)


class AnchorNetwork(nn.Module):
    """Network from cloud and body to logits of anchors and a residual for each; with a memory and a refiner."""

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        super().__init__()
        self.motions = TypicalMotions(config.num_anchors, config.refinement_spread)
        self.encoder = make_encoder(
            config.encoder, POINT_DIM, config.encoder_dims, config.encoder_out_dim, config.num_points
        )
        features, width = config.encoder_out_dim + body_dim(config), config.trunk_dim
        self.trunk = nn.Sequential(nn.Linear(features, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.logits = nn.Linear(width, config.num_anchors)
        self.residuals = nn.Linear(width, config.num_anchors * tool_frame.MOTION_DIM)
        self.refiner = Refiner(config.refinement_points, instruction_dim(config)) if config.num_refinements else None
        # Last, so that the weights above start as those of a network without a memory.
        self.memory = MemoryOfChoices(config) if config.n_action_history_steps else None
        self.register_load_state_dict_pre_hook(_leave_out_memory)  # type: ignore[no-untyped-call]

    def forward(self, points: Tensor, body: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, N, 6), (B, 4+) -> features (B, W), logits (B, K), residuals (B, K, 7) in units of the anchors' spread."""
        features = self.trunk(torch.cat([self.encoder(points), body], dim=-1))
        residuals = self.residuals(features).reshape(-1, *self.motions.anchors.shape)
        return features, self.logits(features), residuals


def _leave_out_memory(network: AnchorNetwork, weights: dict[str, Tensor], prefix: str, *_: object) -> None:
    """Removes the weights of a memory from those that are loaded into a network that has none.

    Nothing else was trained with it, so the rest is the policy without a history.
    """
    if network.memory is None:
        for name in [name for name in weights if name.startswith(f"{prefix}memory.")]:
            del weights[name]


class AnchorHead:
    """Loss and sampling of an `AnchorNetwork`. States and actions are poses without normalisation."""

    def __init__(self, config: DP3AdaptiveConfig) -> None:
        self.config = config

    def network(self) -> AnchorNetwork:
        """Returns an untrained network without anchors."""
        return AnchorNetwork(self.config)

    def predict(self, model: AnchorNetwork, window: Window) -> tuple[Tensor, Tensor, Tensor | None, Past]:
        """Returns logits (B, K) and residuals (B, K, 7) without memory, what it adds to the logits, and the past."""
        points, body = point_inputs(self.config, window, training=model.training), body_inputs(self.config, window)
        features, logits, residuals = model(points, body)
        past = past_of(window)
        if model.memory is None:
            return logits, residuals, None, past
        added = model.memory(features, past.events(feedback=self.config.use_feedback), past.contact)
        return logits, residuals, added, past

    def loss(
        self, model: AnchorNetwork, window: Window, actions: Tensor, is_label: Tensor
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns a loss per sample (B,), its weight (B,), and its parts as metrics.

        Labels are the poses ``actions`` (B, 1, 10) where ``is_label`` (B, 1) is true.
        """
        motions, goal = model.motions, actions[:, 0]
        motion = tool_frame.motion_between(goal, window.observations[STATE][:, -1, :ACTION_DIM])
        index = motions.nearest(motion)
        logits, residuals, added, _ = self.predict(model, window)
        losses = {"choice_loss": F.cross_entropy(logits, index, reduction="none")}
        if added is not None:
            # Trains the memory alone: what is chosen without it must not depend on there being one.
            losses["memory_loss"] = F.cross_entropy(logits.detach() + added, index, reduction="none")
        target = (motion - motions.anchors[index]) / motions.spread[index]
        predicted = residuals[torch.arange(len(index), device=index.device), index]
        losses["residual_loss"] = F.smooth_l1_loss(predicted, target, reduction="none").mean(dim=-1)
        if model.refiner is not None:
            losses["refinement_loss"] = refinement_loss(model.refiner, motions, window, goal, index)
        total = torch.stack(list(losses.values())).sum(dim=0)
        return total, is_label[:, 0].to(total.dtype), {name: loss.detach().mean() for name, loss in losses.items()}

    def sample(self, model: AnchorNetwork, window: Window, noise: Tensor | None) -> Tensor:
        """Draws actions (B, 1, 10). Uniform ``noise`` (B, ...) in [0, 1): its first value selects the first anchor.

        An anchor that leads to nothing is drawn again, up to ``num_draws`` times; if all do, the first one counts. A
        hand whose way is blocked backs off.
        """
        tool, motions = tool_of(window), model.motions
        logits, residuals, added, past = self.predict(model, window)
        logits, drawn = logits.float(), motions.anchors + residuals.float() * motions.spread
        rejected = useless = motions.never_shown(torch.arange(logits.shape[1], device=logits.device), tool)
        if added is not None:
            logits = logits + added.float()
            if self.config.avoid_repeats:
                failed, failed_now = past.repeats(drawn, self.config.failed_below)
                rejected, useless = rejected | failed, useless | failed_now
                logits = logits - GOING_BACK * past.goes_back(drawn)
        opens = motions.anchors[:, -1] >= CLOSED_HAND
        rows, noises = torch.arange(len(tool), device=tool.device), self._noises(len(tool), noise, logits)
        result, done = None, torch.zeros_like(rejected[:, 0])
        for number in range(self.config.num_draws):
            probabilities = _allowed(
                logits.softmax(dim=-1), rejected, useless, opens, least=self.config.min_probability
            )
            index = _draw(probabilities, noises[:, number], self.config.min_probability)
            motion = drawn[rows, index]
            pose = tool_frame.pose_after(torch.cat([motion[:, :6], motion[:, 6:].clamp(0, 1)], dim=-1), tool)
            pose, usable = refine(self.config, model.refiner, motions.needs_refinement(index), window, pose)
            result = pose if result is None else torch.where((usable & ~done)[:, None], pose, result)
            done = done | usable
            if bool(done.all()):
                break
            rejected = rejected.index_put((rows, index), ~done | rejected[rows, index])
        assert result is not None
        if added is not None and self.config.avoid_repeats:
            return back_off_if_blocked(self.config, past, result[:, None])
        return result[:, None]

    def _noises(self, count: int, noise: Tensor | None, like: Tensor) -> Tensor:
        """Returns uniform numbers (B, num_draws), beginning with those of ``noise``."""
        noises = torch.rand(count, self.config.num_draws, device=like.device)
        if noise is None:
            return noises
        given = noise.reshape(count, -1)[:, : self.config.num_draws]
        return torch.cat([given, noises[:, given.shape[1] :]], dim=1)


def _allowed(probabilities: Tensor, rejected: Tensor, useless: Tensor, opens: Tensor, *, least: float) -> Tensor:
    """Returns the probabilities (B, K) of what may be drawn; their sum is 1.

    That is what is not rejected; if it is less probable than ``least``, what is not useless with the present grip; if
    that is improbable too, what opens the hand, (K,) bool. Rejected and useless (B, K) are as in `Past.repeats`.
    """
    new, other = probabilities.masked_fill(rejected, 0.0), probabilities.masked_fill(useless, 0.0)
    likely = [part.sum(dim=-1, keepdim=True) >= least for part in (new, other)]
    allowed = torch.where(likely[0], new, torch.where(likely[1], other, probabilities * opens))
    allowed = torch.where(allowed.sum(dim=-1, keepdim=True) > 0.0, allowed, probabilities)
    return allowed / allowed.sum(dim=-1, keepdim=True)


def _draw(probabilities: Tensor, noise: Tensor, least: float) -> Tensor:
    """Draws indices (B,) from probabilities (B, K) by uniform noise (B,), after masking those below ``least``."""
    unlikely = (probabilities < least) & (probabilities < probabilities.amax(dim=-1, keepdim=True))
    cumulative = probabilities.masked_fill(unlikely, 0.0).cumsum(dim=-1)
    draw = noise[:, None].to(cumulative.dtype) * cumulative[:, -1:]
    index = torch.searchsorted(cumulative, draw, right=True).squeeze(-1)
    return index.clamp(max=probabilities.shape[-1] - 1)
