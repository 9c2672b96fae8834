"""Typical motions of the demonstrations, and what is known of each; part of a network, saved with its weights."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_adamanip.contract.keyframes import CLOSED_HAND, EMPTY_HAND, OPEN_HAND
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_policy_adamanip.common import tool_frame
from lerobot_policy_adamanip.common.motion_clusters import cluster_motions

MIN_TRANSLATION_M = 0.02
"""Least length of an approach that is refined."""
MIN_SHARE = 0.05
"""Least share of a motion's demonstrations that start with a hand in some state, for such a hand to do it."""


class TypicalMotions(nn.Module):
    """Centres of the demonstrated motions' clusters, as in Behavior Transformers.

    Attributes:
        anchors: (K, 7) motions in the tool's frame [m, rad, -].
        spread: (K, 7) standard deviations; zero before `fit`.
        starts: (K, 3) bool, whether a hand that is closed and empty, that holds something, or that is open may do it.
    """

    anchors: Tensor
    spread: Tensor
    starts: Tensor

    def __init__(self, count: int, refinement_spread: float) -> None:
        super().__init__()
        self.refinement_spread = refinement_spread
        self.register_buffer("anchors", torch.zeros(count, tool_frame.MOTION_DIM))
        self.register_buffer("spread", torch.zeros(count, tool_frame.MOTION_DIM))
        self.register_buffer("starts", torch.ones(count, 3, dtype=torch.bool))

    def fit(self, motions: Tensor, openings: Tensor) -> None:
        """Fits the anchors to demonstrated motions (M, 7), of hands with measured openings (M,) at their start."""
        anchors, spread = cluster_motions(motions.numpy(), len(self.anchors))
        self.anchors.copy_(anchors)
        self.spread.copy_(spread)
        shown = F.one_hot(self.nearest(motions), len(anchors)).float().T @ F.one_hot(_state(openings), 3).float()
        self.starts.copy_(shown > MIN_SHARE * shown.sum(dim=1, keepdim=True))
        self.starts[:, 0] |= anchors[:, -1] >= CLOSED_HAND

    def nearest(self, motion: Tensor) -> Tensor:
        """Returns the index (...) of the nearest anchor of each motion (..., 7)."""
        difference = (motion[..., None, :] - self.anchors) / tool_frame.constant(tool_frame.MOTION_UNITS, motion)
        return difference.square().sum(dim=-1).argmin(dim=-1)

    def needs_refinement(self, index: Tensor) -> Tensor:
        """Returns whether anchors (...) are approaches of an open hand whose end points vary.

        A closed hand is guided by the part that it holds, and a hand that releases stays where it is.
        """
        approaches = (self.anchors[:, -1] > CLOSED_HAND) & (self.anchors[:, :3].norm(dim=-1) > MIN_TRANSLATION_M)
        varying: Tensor = approaches & (self.spread[:, :3].amax(dim=-1) > self.refinement_spread)
        return varying[index]

    def never_shown(self, index: Tensor, tool: Tensor) -> Tensor:
        """Returns whether demonstrations never do anchors (B, K) with a hand in the state of the tools (B, 10), (B, K).

        A hand that is empty, that holds something, or that is open does what demonstrations do in this state; an empty
        one may also open.
        """
        return ~self.starts[index, _state(tool[:, GRIPPER_DIM])[:, None]]


def _state(opening: Tensor) -> Tensor:
    """Returns 0 for hands that are closed and empty, 1 for those that hold something, 2 for open ones, (...)."""
    return (opening >= EMPTY_HAND).long() + (opening > OPEN_HAND).long()
