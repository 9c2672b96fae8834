"""The head that draws a typical motion and corrects it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d, rotation_6d_from_matrix
from lerobot_policy_adamanip.common.motion_clusters import MIN_SPREAD, cluster_motions
from lerobot_policy_adamanip.common.tool_frame import motion_between, pose_after
from lerobot_policy_adamanip.dp3_adaptive import anchors
from lerobot_policy_adamanip.dp3_adaptive.refinement import Refiner
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
    nearest = ((motion[:, None] - policy.model.anchors) * unit).square().sum(-1).argmin(1)
    logits = torch.full((2, 6), -50.0).scatter(1, nearest[:, None], 50.0)
    residuals = torch.zeros(2, 6, 7)
    rows = torch.arange(2)
    residuals[rows, nearest] = (motion - policy.model.anchors[nearest]) / policy.model.spread[nearest]
    policy.head.predict = lambda *_, **__: (logits, residuals)
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
    policy.fit_anchors(np.repeat(motions, 10, axis=0))
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
    likely = torch.tensor([0.5, 0.0, 0.47, 0.01, 0.02, 0.0])
    policy.head.predict = lambda *_, **__: (likely.log().expand(50, 6), torch.zeros(50, 6, 7))
    noise = torch.linspace(0, 1 - 1e-6, 50)
    drawn = policy.head.sample(policy.model, window, noise)[:, 0]
    state = window.observations[schema.STATE][:1, -1, :10]
    known = [pose_after(policy.model.anchors[index : index + 1], state) for index in (0, 2)]
    which = [int(torch.allclose(row, known[1][0], atol=1e-5)) for row in drawn]
    assert all(torch.allclose(row, known[pick][0], atol=1e-5) for row, pick in zip(drawn, which, strict=True))
    assert which == sorted(which)
    assert sum(which) / 50 == pytest.approx(0.47 / 0.97, abs=0.03)


# What it looks at ---------------------------------------------------------------------------------------------------


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
    noise = torch.tensor([[0.37]])
    here = [policy.select_action(observation, noise=noise) for _ in range(3)]
    policy.reset()
    there = [policy.select_action(moved, noise=noise) for _ in range(3)]
    for one, other in zip(here, there, strict=True):
        torch.testing.assert_close(other, poses(one), rtol=0, atol=2e-3)


class Spy:
    """Records what the network is given."""

    def __init__(self, policy: Any) -> None:
        self.seen: list[list[torch.Tensor]] = []
        for model in (policy.model, policy.ema_model):
            model.register_forward_hook(
                lambda _, given, __: self.seen.append([part.detach().clone() for part in given])
            )


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
    assert not first[2].any()


def test_it_counts_what_failed(make_anchors: MakeTiny, batch_of: Any) -> None:
    """Nothing to be seen tells three modes apart: after one failure the second is tried, after two the third."""
    policy, before, _, dataset = make_anchors(num_anchors=3)
    window, *_ = policy.training_window(batch_of(dataset, before, *[6] * 3))
    pose = window.observations[schema.STATE][:1, -1, :10]
    steps = policy.config.n_action_history_steps
    lifts = torch.tensor([0.02, -0.02, 0.05])
    tries = pose.expand(3, 10).clone()
    tries[:, 0] += lifts
    history = torch.zeros(3, steps, 10) + pose
    valid = torch.zeros(3, steps, dtype=torch.bool)
    for row in range(1, 3):
        history[row, -row:] = tries[:row]
        valid[row, -row:] = True
    states = window.observations[schema.STATE][:1, -1:].expand(3, steps + 1, -1)
    window = Window({**window.observations, schema.STATE: states}, history, valid)
    policy.fit_anchors(motion_between(tries, pose).numpy())
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(80):
        optimizer.zero_grad()
        policy.head.loss(policy.model, window, tries[:, None], torch.ones(3, 1, dtype=torch.bool))[0].mean().backward()
        optimizer.step()
    policy.eval()
    for seed in range(5):
        torch.manual_seed(seed)
        drawn = policy.head.sample(policy.model, window, None)[:, 0, 0] - pose[0, 0]
        torch.testing.assert_close(drawn, lifts, rtol=0, atol=0.003)


# Refinement ---------------------------------------------------------------------------------------------------------


Scene = tuple[torch.Tensor, torch.Tensor]


def scenes(shape: np.ndarray, draw: np.random.Generator, *, swapped: bool = False) -> Scene:
    """Clouds of 16 shapes (N, 3) somewhere, and goals at their origins, half of them with swapped fingers."""
    turns, places = Rotation.random(16, random_state=int(draw.integers(1 << 30))), draw.uniform(-0.5, 0.5, (16, 3))
    clouds = np.stack([turn.apply(shape) + place for turn, place in zip(turns, places, strict=True)])
    grasps = turns * Rotation.from_euler("z", np.pi * (draw.integers(2, size=16) * swapped)[:, None])
    goals = np.c_[places, rotation_6d_from_matrix(grasps.as_matrix()), np.ones(16)]
    return torch.from_numpy(clouds).float(), torch.from_numpy(goals).float()


def taught(shown: list[Scene], *, steps: int) -> Refiner:
    """Returns a refiner after training on scenes."""
    refiner = Refiner(48)
    optimizer = torch.optim.AdamW(refiner.parameters(), lr=3e-3)
    for step in range(steps):
        optimizer.zero_grad()
        refiner.loss(*shown[step % len(shown)]).mean().backward()
        optimizer.step()
    return refiner.eval()


def test_fingers_are_turned_across_a_bar_whichever_way_they_were_shown() -> None:
    """Of two grasps that are alike either may have been demonstrated; a quarter turn away none is nearer."""
    torch.manual_seed(0)
    draw = np.random.default_rng(0)
    side, along = np.meshgrid(np.linspace(-0.006, 0.006, 3), np.linspace(-0.05, 0.05, 16))
    bar = np.c_[along.ravel(), side.ravel(), np.zeros(48)]
    refiner = taught([scenes(bar, draw, swapped=True) for _ in range(8)], steps=600)
    cloud, goal = scenes(bar, draw, swapped=True)
    twist = torch.zeros(16, 7)
    twist[:, 5] = torch.linspace(-np.pi / 2, np.pi / 2, 16)
    with torch.no_grad():
        found = refiner.refined(cloud, pose_after(twist, goal), 3)
    left = motion_between(found, goal)[:, 5].abs()
    assert (torch.minimum(left, np.pi - left) < 0.25).float().mean() > 0.9


def test_a_refiner_finds_what_it_was_shown_wherever_it_stands() -> None:
    """Goals are at a corner of a wedge: taught from poses beside them on a few scenes, found on others."""
    torch.manual_seed(0)
    draw = np.random.default_rng(0)
    plane = np.stack(np.meshgrid(np.linspace(0, 0.08, 7), np.linspace(0, 0.05, 6)), axis=-1).reshape(-1, 2)
    wedge = np.concatenate([np.c_[plane, np.zeros(42)], np.c_[plane[:, 0], np.zeros(42), plane[:, 1]]])
    refiner = taught([scenes(wedge, draw) for _ in range(4)], steps=400)
    cloud, goal = scenes(wedge, draw)
    off = torch.cat([torch.from_numpy(draw.normal(scale=0.015, size=(16, 3))).float(), torch.zeros(16, 4)], dim=1)
    with torch.no_grad():
        ends = [refiner.refined(cloud, pose_after(off, goal), steps)[:, :3] for steps in (0, 1, 3)]
    missed = [(end - goal[:, :3]).norm(dim=-1).median().item() for end in ends]
    assert missed[0] > 0.015
    assert missed[1] < 0.5 * missed[0]
    assert missed[2] < 0.006


def test_of_two_grasps_that_are_alike_the_less_turned_one_is_gone_to() -> None:
    turn = torch.zeros(4, 7)
    turn[:, 5] = torch.tensor([0.1, 1.4, 1.8, 3.0])
    home = torch.tensor([[0.5, 0.1, 0.4, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0]]).expand(4, -1)
    grasp = pose_after(turn, home)
    found = anchors._less_turned(grasp, home, home)
    torch.testing.assert_close(found[:2], grasp[:2])
    torch.testing.assert_close(motion_between(found, grasp)[2:, 5].abs(), torch.full((2,), torch.pi))
    # A hand that has been turned goes on to what was chosen, as demonstrations do.
    torch.testing.assert_close(anchors._less_turned(grasp, grasp, home), grasp)


def test_only_actions_that_aim_are_refined_and_to_the_same_poses(
    make_anchors: MakeTiny, batch_of: Any, observation_of: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, before, _, dataset = make_anchors()
    policy.eval()
    for model in (policy.model, policy.ema_model):
        model.anchors[:, 0], model.anchors[:, 6], model.spread[:] = 0.05, 1.0, torch.tensor(MIN_SPREAD)
        model.spread[::2, 2] = 0.03
    assert policy.model.needs_refinement(torch.arange(6)).tolist() == [True, False] * 3
    policy.model.anchors[:4, 6] = torch.tensor([0.0, 1.0, 1.0, 1.0])  # a closed hand
    policy.model.anchors[2, :3] = 0.0  # and one that stays
    assert policy.model.needs_refinement(torch.arange(6)).tolist() == [False] * 4 + [True, False]
    policy.model.anchors.copy_(policy.ema_model.anchors)
    observation = observation_of(dataset, before, *range(20))
    noise = torch.rand(20, 1)

    def acted() -> torch.Tensor:
        policy.reset()
        return policy.select_action(observation, noise=noise)

    looked: list[int] = []
    refine = Refiner.refined
    monkeypatch.setattr(Refiner, "refined", lambda *a: looked.append(len(a[2])) or refine(*a))
    few = acted()
    monkeypatch.setattr(anchors, "_rows_to_refine", lambda aims: torch.arange(len(aims)))
    torch.testing.assert_close(few, acted(), rtol=0, atol=1e-6)
    assert 0 < looked[0] < looked[1] == 20
    for model in (policy.model, policy.ema_model):
        model.spread[:] = torch.tensor(MIN_SPREAD)
    acted()
    assert len(looked) == 2
    loss, metrics = policy.train().forward(batch_of(dataset, before, 0, 5, 8, 20))
    loss.backward()
    assert metrics["refinement_loss"] == 0.0
    assert not any(weight.grad.any() for weight in policy.model.refiner.parameters())
