"""The heads in the tool's frame: what they learn, remember, refine and draw again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d, rotation_6d_from_matrix
from lerobot_policy_adamanip.common.config import EVENTS, MEMORY_KINDS
from lerobot_policy_adamanip.common.contacts import EVENT_DIM, MotionCode
from lerobot_policy_adamanip.common.geometry import motion_between, pose_after
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.common.motion_clusters import MIN_SPREAD, cluster_motions
from lerobot_policy_adamanip.dp3_adaptive import truncated
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import Inference
from lerobot_policy_adamanip.dp3_adaptive.truncated import Refiner, TypicalMotions

MakeTiny = Callable[..., tuple[Any, ...]]


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


# Training ------------------------------------------------------------------------------------------------------------


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
    policy.model.forward = lambda _: (torch.zeros(2, 1), logits, None)
    policy.model.denoiser.forward = lambda _, index, *noisy: residuals[rows[:, None], index]
    loss, _, _ = policy.model.loss(window, actions, real)
    torch.testing.assert_close(loss, torch.zeros(2), rtol=0, atol=1e-6)
    drawn = policy.model.sample(window, None)
    torch.testing.assert_close(drawn, actions, rtol=0, atol=1e-4)
    residuals[0, nearest[0], 0] += 1.0
    assert policy.model.loss(window, actions, real)[0][0] > 0.05


@pytest.mark.parametrize(("temperature", "share"), [(1.0, 0.75), (0.5, 0.9)])
def test_a_low_temperature_draws_unlikely_motions_less_often(
    make_anchors: MakeTiny, batch_of: Any, temperature: float, share: float
) -> None:
    policy, before, _, dataset = make_anchors(
        num_anchors=2, num_refinements=0, inference=Inference(temperature=temperature)
    )
    window, *_ = policy.eval().training_window(batch_of(dataset, before, *[0] * 400))
    goals = drawing(policy, window, LEFT, RIGHT)
    forward = policy.model.forward
    policy.model.forward = lambda _: (forward(_)[0], forward(_)[1] * np.log(3) / 2, None)  # three to one
    torch.manual_seed(0)
    is_left = (policy.model.sample(window, None)[:, 0] - goals[0]).abs().amax(dim=1) < 1e-4
    assert is_left.float().mean().item() == pytest.approx(share, abs=0.05)


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
    policy.fit_anchors(torch.from_numpy(np.repeat(motions, 10, axis=0)))
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(60):
        optimizer.zero_grad()
        loss, *_ = policy.model.loss(window, actions, real)
        loss.mean().backward()
        optimizer.step()
    policy.eval()
    torch.manual_seed(0)
    height = policy.model.sample(window, None)[:, 0, 2] - state[:, 2]
    torch.testing.assert_close(height.abs(), torch.full((40,), 0.03), rtol=0, atol=0.004)
    assert 8 <= int((height > 0).sum()) <= 32


# Memory --------------------------------------------------------------------------------------------------------------

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
    policy.fit_anchors(motion_between(goals, state[0, :, :10]))
    return Window({**window.observations, schema.STATE: state.expand(3, steps + 1, -1)}, history, valid), goals


@pytest.mark.parametrize("kind", MEMORY_KINDS)
def test_it_counts_what_failed(make_anchors: MakeTiny, batch_of: Any, kind: str) -> None:
    """After one failure the second is tried, after two the third: its memory says so without the rule."""
    policy, before, _, dataset = make_anchors(num_anchors=3, memory_kind=kind)
    window, goals = lifting(policy, policy.training_window(batch_of(dataset, before, *[6] * 3))[0])
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(80):
        optimizer.zero_grad()
        policy.model.loss(window, goals[:, None], torch.ones(3, 1, dtype=torch.bool))[0].mean().backward()
        optimizer.step()
    policy.eval()
    start = window.observations[schema.STATE][0, -1, 0]
    first = set()
    for seed in range(20):
        torch.manual_seed(seed)
        drawn = policy.model.sample(window, None)[:, 0, 0] - start
        torch.testing.assert_close(drawn[1:], LIFTS[1:], rtol=0, atol=0.003)
        first.add(round(drawn[0].item(), 2))
    assert first == {0.02, -0.02, 0.05}  # nothing has failed yet, and nothing is to be seen


@pytest.mark.parametrize("kind", MEMORY_KINDS)
def test_each_kind_of_memory_reads_its_key_frames(make_anchors: MakeTiny, batch_of: Any, kind: str) -> None:
    policy, before, _, dataset = make_anchors(memory_kind=kind)
    window, *_ = policy.eval().training_window(batch_of(dataset, before))
    past, read = policy.model.past(window), policy.model.remembered(window)[1]
    contact = past.contact | past.missed
    assert torch.equal(read, contact if kind == EVENTS else past.valid)
    assert not torch.equal(contact, past.valid)
    added = policy.model(window)[2]
    assert added is not None
    assert not added[~read.any(dim=1)].any()


@pytest.mark.parametrize("latest", [1, 2])
def test_an_evaluation_may_read_the_latest_events_alone(make_anchors: MakeTiny, batch_of: Any, latest: int) -> None:
    policy, before, _, dataset = make_anchors(memory_kind="window")
    window, *_ = policy.training_window(batch_of(dataset, before))
    every = policy.model.remembered(window)[1]
    policy.config.inference.latest_events = latest
    assert torch.equal(policy.model.remembered(window)[1], every), "a training reads all"
    read = policy.eval().model.remembered(window)[1]
    for row, kept in zip(every.tolist(), read.tolist(), strict=True):
        events = [step for step, is_event in enumerate(row) if is_event]
        assert [step for step, is_read in enumerate(kept) if is_read] == events[-latest:]
    assert every.sum(dim=1).max() > latest


def test_a_code_learns_the_past_motions_and_nothing_from_the_policy() -> None:
    torch.manual_seed(0)
    code, happened = MotionCode(64, 4), torch.randn(8, 4, EVENT_DIM)
    read = torch.arange(4) >= torch.arange(8)[:, None] % 4
    assert not code(happened, read).requires_grad
    optimizer, losses = torch.optim.AdamW(code.parameters(), lr=3e-3), []
    for _ in range(150):
        optimizer.zero_grad()
        losses.append(code.loss(happened, read).mean())
        losses[-1].backward()
        optimizer.step()
    assert losses[-1] < 0.05 * losses[0]
    unread = torch.where(read[..., None], happened, torch.randn_like(happened))
    assert torch.equal(code.loss(happened, read), code.loss(unread, read))


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
        drawn.append(policy.model.sample(policy.training_window(batch)[0], None))
    window, *_ = policies[0].training_window(batch)
    touched = policies[0].model.past(window).contact.any(dim=1)
    assert torch.equal(drawn[0][~touched], drawn[1][~touched])
    assert not torch.equal(drawn[0][touched], drawn[1][touched])
    added = policies[0].model(window)[2]
    assert added is not None
    assert torch.equal(added.any(dim=1), touched)


# Refinement and draws ------------------------------------------------------------------------------------------------


def test_the_action_moves_with_the_scene(make_anchors: MakeTiny, observation_of: Any) -> None:
    """Wherever the robot stands about the vertical, the same scene is met by the same motion."""
    policy, before, _, dataset = make_anchors()
    policy.eval()
    observation = observation_of(dataset, before, 5)
    turn, shift = Rotation.from_euler("z", 1.1), np.array([0.3, -0.5, 0.2])

    def poses(rows: torch.Tensor) -> torch.Tensor:
        moved = rows.clone().double()
        moved[..., :3] = torch.from_numpy(turn.apply(rows[..., :3].numpy()) + shift)
        matrices = turn.as_matrix() @ matrix_from_rotation_6d(rows[..., 3:9].numpy())
        moved[..., 3:9] = torch.from_numpy(rotation_6d_from_matrix(matrices))
        return moved.float()

    cloud = turn.apply(observation[schema.POINT_CLOUD].reshape(-1, 3).numpy()) + shift
    moved = {
        **observation,
        schema.POINT_CLOUD: torch.from_numpy(cloud).float().reshape(observation[schema.POINT_CLOUD].shape),
        schema.STATE: poses(observation[schema.STATE]),
    }
    noise = torch.rand(1, policy.config.horizon, 10)
    acted = []
    for seen in (observation, moved):
        policy.reset()
        torch.manual_seed(0)
        acted.append([policy.select_action(seen, noise=noise) for _ in range(3)])
    for one, other in zip(*acted, strict=True):
        torch.testing.assert_close(other, poses(one), rtol=0, atol=2e-3)


def test_approaches_with_a_varying_end_are_refined(make_anchors: MakeTiny) -> None:
    motions = make_anchors()[0].model.motions
    motions.anchors[:, 0], motions.anchors[:, 6], motions.spread[:] = 0.05, 1.0, torch.tensor(MIN_SPREAD)
    motions.spread[::2, 2] = 0.03
    assert motions.needs_refinement(torch.arange(6)).tolist() == [True, False] * 3
    motions.anchors[:4, 6] = torch.tensor([0.0, 1.0, 1.0, 1.0])  # a closed hand
    motions.anchors[2, :3] = 0.0  # and one that stays
    assert motions.needs_refinement(torch.arange(6)).tolist() == [False] * 4 + [True, False]
    index = torch.tensor([[4, 0], [1, 4]])
    assert motions.needs_refinement(index).tolist() == [[True, False], [False, True]]


def test_only_actions_that_aim_are_refined_and_to_the_same_poses(
    make_anchors: MakeTiny, batch_of: Any, observation_of: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, before, _, dataset = make_anchors()
    policy.eval()
    for model in (policy.model, policy.ema_model):
        model.motions.anchors[:, 0], model.motions.anchors[:, 6] = 0.05, 1.0
        model.motions.spread[:] = torch.tensor(MIN_SPREAD)
        model.motions.spread[::2, 2] = 0.03
    monkeypatch.setattr(TypicalMotions, "nearest", lambda _, motion: torch.arange(len(motion)) % 6)
    observation = observation_of(dataset, before, *range(20))
    noise = torch.rand(20, policy.config.horizon, 10)

    def acted() -> torch.Tensor:
        policy.reset()
        return policy.select_action(observation, noise=noise)

    looked: list[int] = []
    refine = Refiner.refined
    monkeypatch.setattr(Refiner, "refined", lambda *a: looked.append(len(a[2])) or refine(*a))
    few = acted()
    monkeypatch.setattr(truncated, "_rows_to_compute", lambda needed: torch.arange(len(needed)))
    torch.testing.assert_close(few, acted(), rtol=0, atol=1e-6)
    assert 0 < looked[0] < looked[1] == 20
    for model in (policy.model, policy.ema_model):
        model.motions.spread[:] = torch.tensor(MIN_SPREAD)
    acted()
    assert len(looked) == 2
    loss, metrics = policy.train().forward(batch_of(dataset, before, 0, 5, 8, 20))
    loss.backward()
    assert metrics["refinement_loss"] == 0.0
    assert not any(weight.grad.any() for weight in policy.model.refiner.parameters())


LEFT, RIGHT = (torch.tensor([0.0, side, 0.1, 0.0, 0.0, 0.0, 1.0]) for side in (-0.1, 0.1))
"""Two approaches."""


def drawing(policy: Any, window: Window, *motions: torch.Tensor) -> list[torch.Tensor]:
    """Makes a policy draw these motions one after another from an open hand; returns what it acts on, by anchor."""
    tool = window.observations[schema.STATE][:, -1, :10]
    policy.fit_anchors(torch.stack([LEFT, RIGHT]).repeat(20, 1))
    policy.model.motions.spread[:, :3] = 0.02
    goals = [pose_after(motion.expand(len(tool), 7), tool) for motion in motions]
    first = policy.model.motions.nearest(motions[0])
    logits = torch.zeros(len(tool), 2).index_fill(1, first, 2.0)
    policy.model.forward = lambda _: (torch.zeros(len(tool), 1), logits, None)
    policy.model.denoiser.forward = lambda *noisy: torch.zeros(len(tool), 2, 7)
    return goals
