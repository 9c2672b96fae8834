"""Hand-written rules that act at inference, beside the trained network.

Each rule has a switch in `configuration_dp3_adaptive.Inference`. `TruncatedHead.sample` applies them in this order:
hand-state mask, no repeat, no undo, fall-back if no motion is left, probability floor, swapped fingers, redraws (a loop
of the head), backing off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_adamanip.contract.keyframes import CLOSED_HAND, EMPTY_HAND, OPEN_HAND, PRE_GRASP
from lerobot_adamanip.contract.schema import GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS
from lerobot_adamanip.episode.felt_tries import MIN_SHIFT_M
from lerobot_policy_adamanip.common import geometry
from lerobot_policy_adamanip.common.contacts import Past, surely_none
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import Inference

FAILED_SHARE = 0.25
"""A motion has failed if the arm did less than this share of it."""
SAME_PLACE_M, SAME_DIRECTION = 0.06, 0.5
"""Motions are the same if their tools start this near [m], and their directions have at least this cosine."""
SAME_GOAL_M, SAME_GOAL_RAD = 0.03, 0.5
"""Goals are the same if they are this near; demonstrated approaches are further apart."""
UNDO_PENALTY = 20.0
"""Subtracted from the logits of motions that undo a step, so that every other motion is more probable."""
MIN_PROBABILITY = 0.03
"""Anchors below it are masked before sampling. A group of motions with a smaller sum counts as not allowed."""


@dataclass(frozen=True)
class Limits:
    """Masks of motions that rules limit, each (B, K) bool.

    Attributes:
        rejected: not drawn: demonstrations do not start the motion in this state of the hand, or it repeats a failure.
        useless: not drawn even if all motions are rejected: as ``rejected``, with failures of the present grip only.
        undoing: undoes a step; less probable by `UNDO_PENALTY`.
    """

    rejected: Tensor
    useless: Tensor
    undoing: Tensor


def limit_motions(rules: Inference, motions: Tensor, shown: Tensor, past: Past | None) -> Limits:
    """Returns the limits of motions (B, K, 7) from the present pose; ``past`` is None for a policy without a history.

    ``shown`` (B, K) is whether demonstrations start the motions with a hand in the present state, see `hand_state`.
    """
    never = ~shown if rules.uses("hand_state_mask") else torch.zeros_like(shown)
    failed, failed_now, undoing = (torch.zeros_like(never) for _ in range(3))
    if past is not None and rules.uses("no_repeat"):
        failed, failed_now = repeats_failure(past, motions)
    if past is not None and rules.uses("no_undo"):
        undoing = undoes_step(past, motions)
    return Limits(never | failed, never | failed_now, undoing)


def hand_state(opening: Tensor) -> Tensor:
    """Returns 0 for hands that are closed and empty, 1 for those that hold something, 2 for open ones, (...)."""
    return (opening >= EMPTY_HAND).long() + (opening > OPEN_HAND).long()


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


def undoes_step(past: Past, motions: Tensor) -> Tensor:
    """Returns a mask (B, K) of motions (B, K, 7) that undo a step before anything was tried.

    An open hand undoes a step if it goes back to a goal that it was sent to since it last closed. A closed hand undoes
    its grasp if it opens without a contact event.
    """
    was_open = past.poses[..., GRIPPER_DIM] > OPEN_HAND
    went = past.valid & past.opens & was_open[:, :-1] & ~_up_to_now(past.valid & ~past.opens)
    holds = (past.poses[:, -1:, GRIPPER_DIM] >= EMPTY_HAND) & ~was_open[:, -1:] & past.valid[:, -1:]
    tried = (past.contact & ~_up_to_now(past.valid & past.opens)).any(dim=1, keepdim=True)
    undoes = holds & ~past.opens[:, -1:] & ~tried
    if not surely_none(went):
        undoes = undoes | _sent_before(past, motions, went) & was_open[:, -1:]
    return undoes & (motions[..., -1] >= CLOSED_HAND)


def _sent_before(past: Past, motions: Tensor, went: Tensor) -> Tensor:
    """Returns which motions (B, K, 7) end where a step ``went`` (B, H) that arrived or began where the hand is."""
    steps, goals = past.commands.shape[1], geometry.pose_after(motions, past.poses[:, -1:])
    poses = torch.cat([past.commands, past.poses, goals], dim=1)
    places = torch.cat([poses[..., POSITION_DIMS], geometry.matrix_from_6d(poses[..., ROTATION_DIMS]).flatten(-2)], -1)
    sent, felt, ends = places[:, :steps], places[:, steps : 2 * steps + 1], places[:, 2 * steps + 1 :]
    arrived, here = _same(sent, felt[:, 1:]), _same(felt[:, :-1], felt[:, -1:])
    return (_same(sent[:, :, None], ends[:, None]) & (went & (arrived | here))[..., None]).any(dim=1)


def _same(first: Tensor, second: Tensor) -> Tensor:
    """Returns whether positions and rotation matrices (..., 12) are the same but for centimetres, (...), broadcast."""
    near = (first[..., :3] - second[..., :3]).square().sum(dim=-1) < SAME_GOAL_M**2
    trace = (first[..., 3:] * second[..., 3:]).sum(dim=-1)
    result: Tensor = near & (trace > 1 + 2 * math.cos(SAME_GOAL_RAD))
    return result


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


def draw_anchor(rules: Inference, probabilities: Tensor, noise: Tensor) -> Tensor:
    """Draws indices (B,) from probabilities (B, K) by uniform noise (B,), after masking those below the floor."""
    floor = MIN_PROBABILITY if rules.uses("probability_floor") else 0.0
    unlikely = (probabilities < floor) & (probabilities < probabilities.amax(dim=-1, keepdim=True))
    cumulative = probabilities.masked_fill(unlikely, 0.0).cumsum(dim=-1)
    draw = noise[:, None].to(cumulative.dtype) * cumulative[:, -1:]
    index = torch.searchsorted(cumulative, draw, right=True).squeeze(-1)
    return index.clamp(max=probabilities.shape[-1] - 1)


def swap_fingers(rules: Inference, refined: Tensor, chosen: Tensor, tool: Tensor) -> Tensor:
    """Returns refined poses (B, 10), with fingers swapped where that is a smaller turn.

    The turn is measured against the ``chosen`` pose, which is seldom wrong by more than a quarter turn, and against the
    hand: half a turn more is often out of the arm's reach.
    """
    if not rules.uses("swap_fingers"):
        return refined
    swapped = geometry.fingers_swapped(refined)
    grasps, others = torch.stack([refined, swapped])[:, None], torch.stack([chosen, tool])
    turn, turn_swapped = geometry.angle_between(grasps[..., ROTATION_DIMS], others[..., ROTATION_DIMS]).sum(dim=1)
    return torch.where((turn_swapped < turn)[:, None], swapped, refined)


def back_off(rules: Inference, past: Past | None, actions: Tensor) -> Tensor:
    """Returns actions (B, T, 10); an open hand whose way is blocked backs off from the present pose instead."""
    if past is None or not rules.uses("back_off"):
        return actions
    blocked = is_blocked(past)
    if surely_none(blocked):
        return actions
    retreat = geometry.backed_off(geometry.with_gripper(past.poses[:, -1], 1.0), PRE_GRASP)
    return torch.where(blocked[:, None, None], retreat[:, None], actions)


def is_blocked(past: Past) -> Tensor:
    """Returns whether an open hand's way is blocked (B,): it did less than `FAILED_SHARE` of its last motion.

    A retreat, which is the way out, does not count.
    """
    last, start, end = past.commands[:, -1], past.poses[:, -2], past.poses[:, -1]
    sent, undone = (last[:, POSITION_DIMS] - pose[:, POSITION_DIMS] for pose in (start, end))
    far = sent.norm(dim=-1).clamp(min=MIN_SHIFT_M)
    ahead = (sent * geometry.matrix_from_6d(start[:, ROTATION_DIMS])[..., 2]).sum(dim=-1)
    is_open = past.opens[:, -1] & (start[:, GRIPPER_DIM] > OPEN_HAND)
    stopped = undone.norm(dim=-1) > (1 - FAILED_SHARE) * far
    result: Tensor = past.valid[:, -1] & is_open & (ahead > -far / 2) & stopped
    return result
