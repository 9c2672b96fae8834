"""The head that draws a typical motion and corrects it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d
from lerobot_policy_adamanip.common.motion_clusters import MIN_SPREAD, cluster_motions
from lerobot_policy_adamanip.common.tool_frame import motion_between, pose_after
from lerobot_policy_adamanip.dp3_adaptive import anchors
from lerobot_policy_adamanip.dp3_adaptive.tool_inputs import past_of
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

MakeTiny = Callable[..., tuple[Any, ...]]


# Anchors ------------------------------------------------------------------------------------------------------------


def test_anchors_stand_where_motions_are_and_know_their_spread() -> None:
    draw = np.random.default_rng(0)
    middles = np.array([[0.018, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0.5, 0], [0.1, 0, 0.1, 0, 0, 0, 1]], np.float32)
    wide = np.array([0.0005, 0, 0, 0, 0, 0.05, 0], np.float32)
    rows = np.concatenate([middle + wide * draw.normal(size=(300, 7)) for middle in middles])
    anchors, spread = cluster_motions(rows.astype(np.float32), 3)
    for middle in middles:
        away = (anchors - torch.from_numpy(middle)).abs()
        nearest = int(away.sum(1).argmin())
        assert (away[nearest] < torch.tensor([2e-4, 1e-6, 1e-6, 1e-6, 1e-6, 0.02, 1e-6])).all()
        assert spread[nearest, 5] == pytest.approx(0.05, rel=0.2)
        np.testing.assert_allclose(spread[nearest, :5], MIN_SPREAD[:5])
    for part, least in zip(cluster_motions(rows[:2].astype(np.float32), 5), (-1.0, 0.002), strict=True):  # too few
        assert part.shape == (5, 7)
        assert (part >= least).all()


# Training -----------------------------------------------------------------------------------------------------------


def test_the_right_anchor_and_the_right_correction_cost_nothing(make_anchors: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_anchors(num_refinements=0)
    window, actions, real = policy.training_window(batch_of(dataset, before, 2, 11))
    motion = motion_between(actions, window.observations[schema.STATE][:, -1:, :10])[:, 0]
    unit = torch.tensor([20.0, 20, 20, 2, 2, 2, 1])
    nearest = ((motion[:, None] - policy.model.motions.anchors) * unit).square().sum(-1).argmin(1)
    logits = torch.full((2, 6), -50.0).scatter(1, nearest[:, None], 50.0)
    residuals = torch.zeros(2, 6, 7)
    rows = torch.arange(2)
    residuals[rows, nearest] = (motion - policy.model.motions.anchors[nearest]) / policy.model.motions.spread[nearest]
    policy.head.predict = lambda *_: (logits, residuals, None, None)
    loss, _, _ = policy.head.loss(policy.model, window, actions, real)
    torch.testing.assert_close(loss, torch.zeros(2), rtol=0, atol=1e-6)
    drawn = policy.head.sample(policy.model, window, None)
    torch.testing.assert_close(drawn, actions, rtol=0, atol=1e-4)
    residuals[0, nearest[0], 0] += 1.0
    assert policy.head.loss(policy.model, window, actions, real)[0][0] > 0.05


def test_what_can_go_either_way_is_drawn_either_way_and_never_between(make_anchors: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_anchors()
    window, actions, real = policy.training_window(batch_of(dataset, before, *[6] * 40))
    state = window.observations[schema.STATE][:, -1, :10]
    up = torch.where(torch.arange(40)[:, None, None] % 2 == 0, 0.03, -0.03)
    actions = state[:, None] + up * torch.eye(10)[2]
    rows = np.array([[0.0, 0, 0, 0, 0, 0, float(state[0, 9])]], np.float32)
    frame = matrix_from_rotation_6d(state[0, 3:9].numpy())
    motions = np.concatenate([rows, rows])
    motions[0, :3], motions[1, :3] = 0.03 * frame[2], -0.03 * frame[2]
    policy.fit_anchors(torch.from_numpy(np.repeat(motions, 10, axis=0)), state[:20, 9])
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(60):
        optimizer.zero_grad()
        loss, *_ = policy.head.loss(policy.model, window, actions, real)
        loss.mean().backward()
        optimizer.step()
    policy.eval()
    torch.manual_seed(0)
    height = policy.head.sample(policy.model, window, None)[:, 0, 2] - state[:, 2]
    torch.testing.assert_close(height.abs(), torch.full((40,), 0.03), rtol=0, atol=0.004)
    assert 8 <= int((height > 0).sum()) <= 32


def test_what_is_unlikely_is_never_drawn(make_anchors: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_anchors(num_refinements=0)
    window, *_ = policy.training_window(batch_of(dataset, before, *[3] * 50))
    policy.model.motions.starts[:] = True
    likely = torch.tensor([0.5, 0.0, 0.47, 0.01, 0.02, 0.0])
    policy.head.predict = lambda *_: (likely.log().expand(50, 6), torch.zeros(50, 6, 7), None, None)
    noise = torch.linspace(0, 1 - 1e-6, 50)
    drawn = policy.head.sample(policy.model, window, noise)[:, 0]
    state = window.observations[schema.STATE][:1, -1, :10]
    known = [pose_after(policy.model.motions.anchors[index : index + 1], state) for index in (0, 2)]
    which = [int(torch.allclose(row, known[1][0], atol=1e-5)) for row in drawn]
    assert all(torch.allclose(row, known[pick][0], atol=1e-5) for row, pick in zip(drawn, which, strict=True))
    assert which == sorted(which)
    assert sum(which) / 50 == pytest.approx(0.47 / 0.97, abs=0.03)


# What it looks at ---------------------------------------------------------------------------------------------------


class Spy:
    """Records what the network is given: points and body, then features, events and contacts for its memory."""

    def __init__(self, policy: Any) -> None:
        self.seen: list[list[torch.Tensor]] = []
        for model in (policy.model, policy.ema_model):
            model.register_forward_hook(lambda _, given, __: self.seen.append(_copied(given)))
            model.memory.register_forward_hook(lambda _, given, __: self.seen[-1].extend(_copied(given)))


def _copied(given: tuple[torch.Tensor, ...]) -> list[torch.Tensor]:
    return [part.detach().clone() for part in given]


def test_training_and_run_time_see_the_same(make_anchors: MakeTiny, batch_of: Any, observation_of: Any) -> None:
    policy, before, _, dataset = make_anchors()
    policy.eval()
    spy = Spy(policy)
    episode = dataset.meta.episodes[1]
    for index in range(episode["dataset_from_index"], episode["dataset_to_index"]):
        batch = batch_of(dataset, before, index)
        policy.forward(batch)
        trained = spy.seen.pop()
        policy.select_action(observation_of(dataset, before, index))
        for one, other in zip(trained, spy.seen.pop(), strict=True):
            torch.testing.assert_close(other, one, rtol=0, atol=1e-6)
        policy.replace_latest(batch[schema.ACTION])  # it executed what was recorded


def test_the_first_frame_cannot_see_its_label(make_anchors: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_anchors()
    policy.eval()
    spy = Spy(policy)
    window, labels, real = policy.training_window(batch_of(dataset, before, 0))
    assert window.observations[schema.POINT_CLOUD].shape == (1, 1, 48, 3)  # the present one alone
    assert window.observations[schema.STATE].shape == (1, policy.config.n_action_history_steps + 1, 24)
    assert all(torch.equal(padded, labels[0, 0]) for padded in window.history[0])
    for history in (window.history, window.history * 0.5 + 1.0):
        policy.head.loss(policy.model, replace(window, history=history), labels, real)
    first, second = spy.seen
    assert all(torch.equal(one, other) for one, other in zip(first, second, strict=True))
    assert not first[3].any()
    assert not first[4].any()


# What it remembers --------------------------------------------------------------------------------------------------

LIFTS = torch.tensor([0.02, -0.02, 0.05])
"""Three motions of a held part [m]. The observation does not show which one will work."""


def lifting(policy: Any, window: Window) -> tuple[Window, torch.Tensor]:
    """Returns a window of a hand that holds something, before and after the first lifts failed; and the lifts' goals.

    Fits the policy's anchors to the lifts.
    """
    state = window.observations[schema.STATE][:1, -1:].clone()
    state[..., 9] = 0.2
    steps = policy.config.n_action_history_steps
    goals = state[0, :, :10].repeat(3, 1)
    goals[:, 0] += LIFTS
    history = state[:, :, :10].repeat(3, steps, 1)
    for row in range(1, 3):
        history[row, -row:] = goals[:row]
    valid = torch.arange(steps) >= steps - torch.arange(3)[:, None]
    policy.fit_anchors(motion_between(goals, state[0, :, :10]), torch.full((3,), 0.2))
    return Window({**window.observations, schema.STATE: state.expand(3, steps + 1, -1)}, history, valid), goals


def test_it_counts_what_failed(make_anchors: MakeTiny, batch_of: Any) -> None:
    """After one failure the second is tried, after two the third: its memory says so without `avoid_repeats`."""
    policy, before, _, dataset = make_anchors(num_anchors=3, avoid_repeats=False)
    window, goals = lifting(policy, policy.training_window(batch_of(dataset, before, *[6] * 3))[0])
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(80):
        optimizer.zero_grad()
        policy.head.loss(policy.model, window, goals[:, None], torch.ones(3, 1, dtype=torch.bool))[0].mean().backward()
        optimizer.step()
    policy.eval()
    start = window.observations[schema.STATE][0, -1, 0]
    first = set()
    for seed in range(20):
        torch.manual_seed(seed)
        drawn = policy.head.sample(policy.model, window, None)[:, 0, 0] - start
        torch.testing.assert_close(drawn[1:], LIFTS[1:], rtol=0, atol=0.003)
        first.add(round(drawn[0].item(), 2))
    assert first == {0.02, -0.02, 0.05}  # nothing has failed yet, and nothing is to be seen


def test_what_failed_is_not_drawn_again(make_anchors: MakeTiny, batch_of: Any) -> None:
    """The memory is untrained: the rule alone decides. A longer lift the same way is the same, and may fail too."""
    policy, before, _, dataset = make_anchors(num_anchors=3)
    window, _ = lifting(policy, policy.training_window(batch_of(dataset, before, *[6] * 3))[0])
    predict, start = policy.head.predict, window.observations[schema.STATE][0, -1, 0]
    policy.head.predict = lambda *given: (torch.zeros(3, 3), torch.zeros(3, 3, 7), *predict(*given)[2:])
    every = {0.02, -0.02, 0.05}
    for avoid, wanted in ((True, [every, {-0.02}, every]), (False, [every] * 3)):
        policy.config.avoid_repeats, found = avoid, [set(), set(), set()]
        for noise in torch.linspace(0, 0.99, 12):
            drawn = policy.head.sample(policy.model, window, noise.expand(3))[:, 0, 0] - start
            for lifts, lift in zip(found, drawn.tolist(), strict=True):
                lifts.add(round(lift, 2))
        assert found == wanted


def test_an_open_hand_is_not_sent_again_where_it_could_not_go(make_anchors: MakeTiny, batch_of: Any) -> None:
    """Without training: the rule alone decides. Its latest key frame stayed, so it does not back off."""
    policy, before, _, dataset = make_anchors(num_anchors=3, num_refinements=0)
    window, _ = lifting(policy, policy.training_window(batch_of(dataset, before, *[6] * 3))[0])
    state = window.observations[schema.STATE].clone()
    state[..., 9] = 1.0
    goals = state[0, -1, :10].repeat(3, 1)
    goals[:, 0] += 4 * LIFTS  # apart, and not where the hand is
    policy.fit_anchors(motion_between(goals, state[0, :1, :10]), torch.ones(3))
    history = state[:, :-1, :10].clone()
    history[:, -2] = goals
    window = Window({**window.observations, schema.STATE: state}, history, torch.ones_like(window.valid))
    predict, start = policy.head.predict, state[0, -1, 0]
    policy.head.predict = lambda *given: (torch.zeros(3, 3), torch.zeros(3, 3, 7), *predict(*given)[2:])
    for avoid in (True, False):
        policy.config.avoid_repeats, drawn = avoid, []
        for noise in torch.linspace(0, 0.99, 12):
            drawn.append(policy.head.sample(policy.model, window, noise.expand(3))[:, 0, 0] - start)
        for row, lift in enumerate(4 * LIFTS):
            assert any(torch.isclose(each[row], lift, atol=1e-4) for each in drawn) != avoid


def test_before_the_first_contact_it_is_the_policy_without_a_history(make_anchors: MakeTiny, batch_of: Any) -> None:
    """To the bit, losses and weights too: nothing that the memory learns reaches the rest."""
    policies, losses = [], []
    for steps in (4, 0):
        torch.manual_seed(0)
        policy, before, _, dataset = make_anchors(n_action_history_steps=steps)
        optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
        for step in range(6):
            torch.manual_seed(step)
            optimizer.zero_grad()
            loss, parts = policy.forward(batch_of(dataset, before, *range(step, 40, 2)))
            loss.backward()
            optimizer.step()
            losses.append({name: value for name, value in parts.items() if name != "memory_loss"})
        policies.append(policy.eval())
    assert losses[:6] == losses[6:]
    remembering, plain = (dict(policy.model.named_parameters()) for policy in policies)
    assert {name for name in remembering if name not in plain} == {
        f"memory.{name}" for name, _ in policies[0].model.memory.named_parameters()
    }
    assert all(torch.equal(weight, remembering[name]) for name, weight in plain.items())
    batch, drawn = batch_of(dataset, before), []
    for policy in policies:
        torch.manual_seed(1)
        drawn.append(policy.head.sample(policy.model, policy.training_window(batch)[0], None))
    window, *_ = policies[0].training_window(batch)
    touched = past_of(window).contact.any(dim=1)
    assert torch.equal(drawn[0][~touched], drawn[1][~touched])
    assert not torch.equal(drawn[0][touched], drawn[1][touched])
    added = policies[0].head.predict(policies[0].model, window)[2]
    assert added is not None
    assert torch.equal(added.any(dim=1), touched)


# Rejected anchors ---------------------------------------------------------------------------------------------------


def test_what_is_new_is_drawn_else_what_another_grip_failed_at_else_the_hand_lets_go() -> None:
    least, cases = 0.03, set()
    for _ in range(300):
        probabilities, opens = (4 * torch.randn(5)).softmax(dim=0), torch.rand(5) < 0.3
        rejected = torch.rand(5) < 0.8
        useless = rejected & (torch.rand(5) < 0.8)
        new, other, releases = probabilities * ~rejected, probabilities * ~useless, probabilities * opens
        case = [bool(new.sum() >= least), bool(other.sum() >= least), bool(releases.any()), True].index(True)
        wanted = (new, other, releases, probabilities)[case]
        given = (part[None] for part in (probabilities, rejected, useless))
        allowed = anchors._allowed(*given, opens, least=least)[0]
        torch.testing.assert_close(allowed, wanted / wanted.sum())
        cases.add(case)
    assert cases == {0, 1, 2, 3}


def test_a_hand_does_what_was_shown_in_its_state_and_an_empty_one_may_open(
    make_anchors: MakeTiny, batch_of: Any
) -> None:
    policy, before, _, dataset = make_anchors(num_anchors=4, num_refinements=0, n_action_history_steps=0)
    opens, pulls, pushes = torch.eye(7)[6], -0.05 * torch.eye(7)[2], 0.05 * torch.eye(7)[2]
    shown = torch.stack([opens, pulls, pushes, torch.zeros(7)])
    openings = torch.tensor([0.3, 0.3, 0.3, 1.0]).repeat(100)
    openings[1:16:4] = 0.0  # 4 of 100 pulls: a grip that was lost
    openings[2:24:4] = 0.0  # 6 of 100 pushes
    policy.fit_anchors(shown.repeat(100, 1), openings)
    motions = policy.model.motions
    kinds = motions.nearest(shown)
    assert motions.starts[kinds, 0].tolist() == [True, False, True, False]
    window, *_ = policy.training_window(batch_of(dataset, before, *[6] * 60))
    policy.head.predict = lambda *_: (torch.zeros(60, 4), torch.zeros(60, 4, 7), None, None)
    for opening, allowed in ((0.0, {0, 2}), (0.3, {0, 1, 2}), (1.0, {3})):
        window.observations[schema.STATE][..., 9] = opening
        drawn = policy.head.sample(policy.model, window, torch.linspace(0, 0.99, 60))[:, 0]
        found = motions.nearest(motion_between(drawn, window.observations[schema.STATE][:, -1, :10]))
        assert {kinds.tolist().index(int(index)) for index in found} == allowed
