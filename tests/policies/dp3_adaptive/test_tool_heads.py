"""What holds for both heads in the tool's frame: actions move with the scene, and what leads to nothing is redrawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d, rotation_6d_from_matrix
from lerobot_policy_adamanip.common.motion_clusters import MIN_SPREAD
from lerobot_policy_adamanip.common.tool_frame import motion_between, pose_after
from lerobot_policy_adamanip.dp3_adaptive import approach
from lerobot_policy_adamanip.dp3_adaptive.motions import TypicalMotions
from lerobot_policy_adamanip.dp3_adaptive.refinement import Refiner
from lerobot_policy_adamanip.dp3_adaptive.tool_inputs import past_of
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

MakeTiny = Callable[..., tuple[Any, ...]]
every_head = pytest.mark.parametrize("preset", ["fast", "diffusion"])


@every_head
def test_the_action_moves_with_the_scene(make_tiny: MakeTiny, observation_of: Any, preset: str) -> None:
    """Wherever the robot stands about the vertical, the same scene is met by the same motion."""
    policy, before, _, dataset = make_tiny(preset=preset)
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


def test_the_past_holds_commands_and_the_poses_before_them(make_tiny: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_tiny(preset="fast")
    rows = [dataset[index] for index in range(3, 8)]
    past = past_of(policy.training_window(batch_of(dataset, before, 7))[0])
    assert past.valid.all()
    assert torch.equal(past.poses[0], torch.stack([row[schema.STATE][:10] for row in rows]))
    assert torch.equal(past.commands[0], torch.stack([row[schema.EXECUTED] for row in rows[:-1]]))


# Approaches ---------------------------------------------------------------------------------------------------------


def test_approaches_with_a_varying_end_are_refined(make_tiny: MakeTiny) -> None:
    motions = make_tiny(preset="fast")[0].model.motions
    motions.anchors[:, 0], motions.anchors[:, 6], motions.spread[:] = 0.05, 1.0, torch.tensor(MIN_SPREAD)
    motions.spread[::2, 2] = 0.03
    assert motions.needs_refinement(torch.arange(6)).tolist() == [True, False] * 3
    motions.anchors[:4, 6] = torch.tensor([0.0, 1.0, 1.0, 1.0])  # a closed hand
    motions.anchors[2, :3] = 0.0  # and one that stays
    assert motions.needs_refinement(torch.arange(6)).tolist() == [False] * 4 + [True, False]
    index = torch.tensor([[4, 0], [1, 4]])
    assert motions.needs_refinement(index).tolist() == [[True, False], [False, True]]


@every_head
def test_only_actions_that_aim_are_refined_and_to_the_same_poses(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    policy, before, _, dataset = make_tiny(preset=preset, num_draws=1)
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
    monkeypatch.setattr(approach, "_rows_to_refine", lambda needed: torch.arange(len(needed)))
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


# Redraws ------------------------------------------------------------------------------------------------------------

LEFT, RIGHT = (torch.tensor([0.0, side, 0.1, 0.0, 0.0, 0.0, 1.0]) for side in (-0.1, 0.1))
"""Two approaches."""


def drawing(policy: Any, window: Window, *motions: torch.Tensor) -> list[torch.Tensor]:
    """Makes a policy draw these motions one after another from an open hand; returns what it acts on, by anchor."""
    tool = window.observations[schema.STATE][:, -1, :10]
    policy.fit_anchors(torch.stack([LEFT, RIGHT]).repeat(20, 1), torch.ones(40))
    policy.model.motions.spread[:, :3] = 0.02
    goals = [pose_after(motion.expand(len(tool), 7), tool) for motion in motions]
    if policy.config.head == "anchors":
        first = policy.model.motions.nearest(motions[0])
        logits = torch.zeros(len(tool), 2).index_fill(1, first, 2.0)
        policy.head.predict = lambda *_: (logits, torch.zeros(len(tool), 2, 7), None, None)
        return goals
    chunks = iter(policy.head.encode(goal[:, None].expand(-1, policy.config.horizon, -1), window) for goal in goals)
    policy.head.denoise = lambda *_: next(chunks)
    return goals


Case = tuple[list[bool], int, int]
CASES: list[Case] = [([True, True], 2, 0), ([False, True], 2, 1), ([False, True], 1, 0), ([False, False], 2, 0)]
"""Whether there is something to hold at the end of each approach, num_draws, which approach is acted on."""


@every_head
@pytest.mark.parametrize("case", CASES, ids=str)
def test_an_approach_without_anything_to_hold_is_drawn_again(
    make_tiny: MakeTiny, batch_of: Any, monkeypatch: pytest.MonkeyPatch, preset: str, case: Case
) -> None:
    """If all draws lead to nothing, the first one is executed. The executed pose is always a refined one."""
    held, draws, wanted = case
    policy, before, _, dataset = make_tiny(preset=preset, num_anchors=2, num_draws=draws, n_action_history_steps=0)
    window, *_ = policy.eval().training_window(batch_of(dataset, before, 0, 3))
    window.observations[schema.STATE][..., 9] = 1.0
    goals = drawing(policy, window, LEFT, RIGHT)

    def refined(_: Any, cloud: torch.Tensor, pose: torch.Tensor, *_given: Any) -> tuple[torch.Tensor, ...]:
        is_left = motion_between(pose, window.observations[schema.STATE][:, -1, :10])[:, 1] < 0
        return pose + 0.001 * torch.eye(10)[0], torch.where(is_left, *map(torch.tensor, held))

    monkeypatch.setattr(Refiner, "refined", refined)
    found = policy.head.sample(policy.model, window, torch.zeros(2, 1))[:, 0]
    torch.testing.assert_close(found, goals[wanted] + 0.001 * torch.eye(10)[0], rtol=0, atol=1e-5)


@every_head
def test_episodes_of_a_batch_are_redrawn_each_for_itself(
    make_tiny: MakeTiny, batch_of: Any, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    policy, before, _, dataset = make_tiny(preset=preset, num_anchors=2, num_draws=2, n_action_history_steps=0)
    window, *_ = policy.eval().training_window(batch_of(dataset, before, 0, 3))
    window.observations[schema.STATE][..., 9] = 1.0
    left, right = drawing(policy, window, LEFT, RIGHT)
    answers = iter([torch.tensor([True, False]), torch.tensor([False, True])])
    monkeypatch.setattr(Refiner, "refined", lambda _, cloud, pose, *more: (pose, next(answers)))
    found = policy.head.sample(policy.model, window, torch.zeros(2, 1))[:, 0]
    torch.testing.assert_close(found, torch.stack([left[0], right[1]]), rtol=0, atol=1e-5)
