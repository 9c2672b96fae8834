"""The memoryless policy: what it draws, and what it learns of where to take hold."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from toy_demos import observed, play, toy_world, trained

from lerobot_adamanip.contract import schema
from lerobot_policy_adamanip.affordance.demonstrations import read_demonstrations
from lerobot_policy_adamanip.common.geometry import motion_between, pose_after, reverse
from lerobot_policy_adamanip.sampling.contact_labels import motions_in_contact

MakePolicy = Callable[..., tuple[Any, ...]]
Observation = dict[str, torch.Tensor]


@pytest.fixture
def make(make_toy_policy: MakePolicy) -> MakePolicy:
    """Still untrained, it approaches with an open hand: which is to be learnt."""

    def build(**changes: Any) -> tuple[Any, ...]:
        policy, *rest = make_toy_policy("sampling", **{"num_motions": 3, **changes})
        policy.model.grasps.decoder[-1].bias.data[-1] = 1.0
        return policy, *rest

    return build


def seen_by(opening: float) -> Observation:
    """An observation of a bottle by a hand of this opening."""
    observation = observed(toy_world("bottle_000", 1), np.random.default_rng(0))
    observation[schema.STATE][:, schema.GRIPPER_DIM] = opening
    return observation


# The set of motions -------------------------------------------------------------------------------------------------


def test_a_motion_and_its_reverse_lead_back() -> None:
    motion = 0.3 * torch.randn(20, 7)
    tool = torch.tensor([0.5, 0.1, 0.7, 1, 0, 0, 0, 0, 1, 0.0]).expand(20, 10)
    there = pose_after(motion, tool)
    back = pose_after(reverse(motion), there)
    torch.testing.assert_close(back[:, :9], tool[:, :9], rtol=0, atol=1e-5)
    torch.testing.assert_close(reverse(reverse(motion)), motion, rtol=0, atol=1e-5)


def test_the_set_is_closed_under_reversal_and_typical_of_what_was_shown(make: MakePolicy) -> None:
    policy, *_ = make()
    motions, shown = policy.model.motions, policy.labels.motions
    assert motions.shape == (6, 7)
    torch.testing.assert_close(motions[3:], reverse(motions[:3]))
    unit = torch.tensor([20.0, 20, 20, 2, 2, 2, 0])
    away = ((shown[:, None] - motions) * unit).norm(dim=-1).amin(dim=1)
    assert away.max() < 1.0
    assert not motions[:, 6].any()  # the hand stays closed


def test_motions_in_contact_are_those_between_closing_and_opening(make: MakePolicy) -> None:
    *_, dataset = make()
    demonstrations = read_demonstrations(dataset.meta)
    found = torch.from_numpy(motions_in_contact(demonstrations))
    tries = int((demonstrations.tried >= 0).sum())
    assert len(found) == tries  # a bottle's cap is held from the grasp on
    rows = np.flatnonzero(demonstrations.tried >= 0)
    commands, poses = (torch.from_numpy(each[rows]) for each in (demonstrations.commands, demonstrations.poses))
    torch.testing.assert_close(found, motion_between(commands, poses))


# Draws --------------------------------------------------------------------------------------------------------------


def test_every_motion_and_taking_hold_anew_are_drawn_alike(make: MakePolicy) -> None:
    policy, *_ = make()
    held = seen_by(0.3)
    cloud, pose = policy.observed(held)
    known = pose_after(policy.model.motions, pose.expand(6, 10))
    torch.manual_seed(0)
    drawn = [policy.draw_macro(cloud[0], pose[0]) for _ in range(350)]
    counts = [sum(len(each) == 1 and torch.allclose(each[0], one, atol=1e-5) for each in drawn) for one in known]
    counts.append(sum(len(each) > 1 for each in drawn))
    assert sum(counts) == 350
    assert all(30 <= count <= 75 for count in counts), counts


def test_a_push_includes_a_motion_since_nothing_is_held_then(make: MakePolicy) -> None:
    policy, *_ = make()
    policy.eval()
    cloud, pose = policy.observed(seen_by(1.0))
    closed = pose.clone()
    closed[:, schema.GRIPPER_DIM] = 0.0
    policy.model.draw_grasps = lambda cloud: closed
    macro = policy.draw_macro(cloud[0], pose[0])
    assert macro.shape == (3, 10)
    assert not macro[:, schema.GRIPPER_DIM].any()
    reached = motion_between(macro[2:], macro[1:2])
    assert (reached - policy.model.motions).abs().amax(dim=-1).min() < 1e-4


def test_what_was_tried_and_felt_changes_no_draw(make: MakePolicy) -> None:
    """After whatever has happened, the same observation and the same draw give the same macro action."""
    policy, *_ = make()
    seen = seen_by(0.3)
    random = [{key: torch.rand_like(value) for key, value in seen.items()} for _ in range(4)]
    torch.manual_seed(11)
    alone = policy.eval().predict_action_chunk(seen)[0]
    for history in ([], random, random[::-1]):
        policy.reset()
        for observation in history:
            policy.select_action(observation)
        while not policy._plans.finished(1):
            policy._plans.pop()
        torch.manual_seed(11)
        assert torch.equal(policy.select_action(seen)[0], alone[0])


def test_success_within_a_budget_is_that_of_independent_draws(make: MakePolicy) -> None:
    """A part that one of M motions opens: each draw does with 1 in M + 1, and as often costs five key frames instead.

    ``P(n) = 1 / (M + 1) + (M - 1) / (M + 1) P(n - 1) + 1 / (M + 1) P(n - 5)``; ``P(n) = 0`` with no key frames left.
    """
    policy, *_ = make()
    policy.eval()
    cloud, pose = policy.observed(seen_by(0.3))
    policy.model.draw_grasps = lambda cloud: pose * torch.cat([torch.ones(9), torch.zeros(1)]) + torch.eye(10)[9]
    episodes, budget, motions = 300, 12, len(policy.model.motions)
    opening = pose_after(policy.model.motions[2:3], pose)
    batch = {schema.POINT_CLOUD: cloud.expand(episodes, -1, -1), schema.STATE: pose.expand(episodes, -1)}
    opened = torch.zeros(episodes, dtype=torch.bool)
    torch.manual_seed(3)
    for _ in range(budget):
        opened |= torch.isclose(policy.select_action(batch), opening, atol=1e-5).all(dim=1)

    @functools.cache
    def chance(left: int) -> float:
        if left <= 0:
            return 0.0
        return (1 + (motions - 1) * chance(left - 1) + chance(left - 5)) / (motions + 1)

    wanted = chance(budget)
    assert opened.float().mean() == pytest.approx(wanted, abs=3.5 * (wanted * (1 - wanted) / episodes) ** 0.5)


# Training -----------------------------------------------------------------------------------------------------------


def test_contacts_can_be_made_while_nothing_has_moved_and_the_hand_is_away(make: MakePolicy) -> None:
    policy, *_, dataset = make()
    demonstrations, labels = read_demonstrations(dataset.meta), policy.labels
    for rows in demonstrations.episodes():
        (contact,) = demonstrations.contacts(rows)
        counting = np.flatnonzero(labels.contacts_of[demonstrations.index[rows], 0].numpy() >= 0) + rows.start
        assert rows.start in counting
        assert counting[-1] < contact.first
        (made,) = set(labels.contacts_of[counting, 0].tolist())
        np.testing.assert_array_equal(labels.grasps[made], contact.grasp)


def test_it_learns_to_take_hold_and_then_tries_everything(make: MakePolicy, batch_of: Any) -> None:
    policy, before, _, dataset = make(feature_dim=64)
    batch = batch_of(dataset, before, *([0, 1] * 8))
    losses = trained(policy, batch, 200)
    assert np.mean(losses[-20:]) < 0.25 * np.mean(losses[:5])
    cloud, _ = policy.observed({key: value[:1] for key, value in batch.items() if key.startswith("observation")})
    grasps = torch.cat([policy.model.draw_grasps(cloud) for _ in range(5)])
    wanted = policy.labels.grasps[policy.labels.contacts_of[0, 0]]
    assert (grasps[:, :3] - wanted[:3]).norm(dim=-1).median() < 0.008
    tried = set()
    for seed in range(6):
        world = toy_world("bottle_000", 0)
        play(policy, world, seed=seed, at_most=10)
        tried |= {(move.joint, move.sign) for move in world.moves if move is not None}
    assert {("cap", -1), ("cap", 1), ("lift", 1)} <= tried


def test_another_action_than_its_own_ends_a_macro(make: MakePolicy) -> None:
    policy, *_ = make()
    drawn: list[int] = []
    draw = policy.draw_macro
    policy.draw_macro = lambda *seen: (drawn.append(1), draw(*seen))[1]
    action = policy.select_action(seen_by(1.0))
    policy.select_action(seen_by(1.0))
    assert len(drawn) == 1
    policy.replace_latest(action)
    policy.select_action(seen_by(1.0))
    assert len(drawn) == 2
