"""The rule ``no_repeat``, written by hand: at inference, no motion that failed is drawn until something has moved.

Off by default: it is the baseline that the learned memory is compared with.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_adamanip.contract.keyframes import CLOSED_HAND, EMPTY_HAND
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_policy_adamanip.common import geometry
from lerobot_policy_adamanip.common.contacts import Past, surely_none

FAILED_SHARE = 0.25
"""A motion has failed if the arm did less than this share of it."""
SAME_PLACE_M, SAME_DIRECTION = 0.06, 0.5
"""Motions are the same if their tools start this near [m], and their directions have at least this cosine."""
MIN_PROBABILITY = 0.03
"""A group of motions with a smaller sum counts as not allowed."""


def repeats_failure(past: Past, motions: Tensor) -> tuple[Tensor, Tensor]:
    """Returns two masks (B, K) of motions (B, K, 7) from the present pose that repeat a failed contact event.

    An event failed if less than `FAILED_SHARE` of its motion was done, or if the hand lost its grip. The first mask has
    the failures since something last moved. The second has those of them with the present grip, i.e. since the hand was
    last open. Motions are compared in the base frame, so the way in which a part is held does not matter.
    """
    tool, reached = past.poses[:, :-1], past.poses[:, 1:]
    sent, undone = (_scaled(motion) for motion in past.motions)
    lost = (tool[..., GRIPPER_DIM] >= EMPTY_HAND) & (reached[..., GRIPPER_DIM] < EMPTY_HAND)
    failed = past.contact & (lost | (undone.norm(dim=-1) > (1 - FAILED_SHARE) * sent.norm(dim=-1)))
    near = (tool[..., POSITION_DIMS] - past.poses[:, -1:, POSITION_DIMS]).norm(dim=-1) < SAME_PLACE_M
    since_moved = failed & near & ~_up_to_now(past.contact & ~failed)
    closed = motions[..., -1] < CLOSED_HAND
    if surely_none(since_moved):
        return torch.zeros_like(closed), torch.zeros_like(closed)
    before, ahead = _in_base(sent, tool), _in_base(_scaled(motions), past.poses[:, -1:])
    same = F.cosine_similarity(before[:, :, None], ahead[:, None], dim=-1) > SAME_DIRECTION
    this_grip = since_moved & ~_up_to_now(past.valid & past.opens)
    return (since_moved[..., None] & same).any(dim=1) & closed, (this_grip[..., None] & same).any(dim=1) & closed


def _up_to_now(event: Tensor) -> Tensor:
    """Returns which steps (B, H) have an event (B, H) at or after them."""
    return event.flip(1).cumsum(dim=1).flip(1) > 0


def _scaled(motion: Tensor) -> Tensor:
    """Returns translation and rotation (..., 6) of motions (..., 7) in `geometry.MOTION_UNITS`."""
    return motion[..., :6] / geometry.constant(geometry.MOTION_UNITS, motion)[:6]


def _in_base(scaled: Tensor, tool: Tensor) -> Tensor:
    """Rotates translations and rotation vectors (B, K, 6) from the frames of tools (B, 1 or K, 10) to the base's."""
    frame = geometry.matrix_from_6d(tool[..., ROTATION_DIMS]).transpose(-1, -2)
    parts = (scaled[..., :3], scaled[..., 3:])
    return torch.cat([(part[..., None, :] @ frame).squeeze(-2) for part in parts], dim=-1)


def allowed_probabilities(probabilities: Tensor, rejected: Tensor, useless: Tensor, opens: Tensor) -> Tensor:
    """Returns the probabilities (B, K) of the motions that may be drawn; their sum is 1.

    These are the motions that are not ``rejected`` (B, K). If their sum is below `MIN_PROBABILITY`: those that are not
    ``useless`` (B, K). If that sum is below it, too: those that open the hand, ``opens`` (K,).
    """
    new, other = probabilities.masked_fill(rejected, 0.0), probabilities.masked_fill(useless, 0.0)
    likely = [part.sum(dim=-1, keepdim=True) >= MIN_PROBABILITY for part in (new, other)]
    allowed = torch.where(likely[0], new, torch.where(likely[1], other, probabilities * opens))
    allowed = torch.where(allowed.sum(dim=-1, keepdim=True) > 0.0, allowed, probabilities)
    return allowed / allowed.sum(dim=-1, keepdim=True)
