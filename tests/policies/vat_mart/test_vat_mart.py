"""The open-loop policy: what it plans, learns and looks at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from toy_demos import observed, toy_world, trained, turned_and_shifted

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Goal, Phase
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_policy_adamanip.common.geometry import angle_between, matrix_from_6d, rotation_vector
from lerobot_policy_adamanip.vat_mart.modeling_vat_mart import encode_trajectory, key_frames, perturb_grasp

MakePolicy = Callable[..., tuple[Any, ...]]


@pytest.fixture
def make(make_toy_policy: MakePolicy) -> MakePolicy:
    return lambda **changes: make_toy_policy("vat_mart", **{"proposals": 12, "training_proposals": 6, **changes})


@pytest.fixture(scope="module")
def taught(make_toy_policy: MakePolicy, batch_of: Any) -> tuple[Any, dict[str, Any]]:
    """A policy after training on every row that leads to a plan, and these rows as its batch."""
    torch.manual_seed(0)
    policy, before, _, dataset = make_toy_policy("vat_mart", proposals=12, training_proposals=6)
    rows = torch.nonzero(policy.labels.plan_of >= 0).flatten().tolist()
    batch = batch_of(dataset, before, *rows)
    trained(policy, batch, 240)
    return policy, batch


# Trajectories -------------------------------------------------------------------------------------------------------


def test_a_plan_approaches_closes_and_follows_its_key_frames(make: MakePolicy) -> None:
    policy, *_ = make()
    labels, place = policy.labels, policy.labels.grasps[:, :3] + 0.01
    code = encode_trajectory(labels.grasps, labels.waypoints, place)
    plan = key_frames(code, place)
    assert plan.shape[1:] == (3 + 8, 10)
    torch.testing.assert_close(plan[:, 1], labels.grasps, rtol=0, atol=1e-5)
    torch.testing.assert_close(plan[:, 3:], labels.waypoints, rtol=0, atol=1e-5)
    assert plan[:, :2, schema.GRIPPER_DIM].eq(1).all()
    assert plan[:, 2:, schema.GRIPPER_DIM].eq(0).all()


def test_a_spoilt_grasp_is_turned_or_shifted_and_nothing_else() -> None:
    trajectory = torch.randn(200, 10 + 2 * 9)
    trajectory[:, :6] = torch.tensor([1.0, 0, 0, 0, 1, 0])
    spoilt = perturb_grasp(trajectory)
    angle = angle_between(spoilt[:, :6], trajectory[:, :6])
    shift = (spoilt[:, 6:9] - trajectory[:, 6:9]).norm(dim=-1)
    assert torch.equal(spoilt[:, 9:], trajectory[:, 9:])
    turned = angle > 0.1
    assert 50 < int(turned.sum()) < 150
    assert not shift[turned].any()
    assert (shift[~turned] > 0.1).all()


# Training -----------------------------------------------------------------------------------------------------------


def test_later_modules_do_not_teach_earlier_ones(make: MakePolicy, batch_of: Any) -> None:
    """Actionability follows scores and proposals; neither follows it."""
    policy, before, _, dataset = make()
    cloud, _ = policy.observed(batch_of(dataset, before, 0, 9))
    policy._actionability_loss(cloud, cloud[:, :3]).sum().backward()
    moved = {name.split(".")[0] for name, weight in policy.model.named_parameters() if weight.grad is not None}
    assert moved == {"action_features", "actionability"}


def test_what_it_is_shown_it_plans_again(make: MakePolicy, batch_of: Any) -> None:
    policy, before, _, dataset = make(feature_dim=64)
    losses = trained(policy, batch_of(dataset, before, *[0] * 8), 200)
    assert np.mean(losses[-20:]) < 0.15 * np.mean(losses[:5])
    plan = policy.predict_action_chunk(batch_of(dataset, before, 0))
    wanted = policy.labels.grasps[policy.labels.plan_of[0]]
    assert (plan[0, 1, :3] - wanted[:3]).norm() < 0.008
    assert angle_between(plan[0, 1, 3:9], wanted[3:9]) < 0.1
    lifted = policy.labels.waypoints[policy.labels.plan_of[0], -1, 2] - wanted[2]
    assert plan[0, -1, 2] - plan[0, 1, 2] == pytest.approx(float(lifted), abs=0.008)


def turns_of(grasps: torch.Tensor, waypoints: torch.Tensor) -> torch.Tensor:
    """(..., K) [rad]: how far each key frame in contact is turned about the tool's axis, signed."""
    held = matrix_from_6d(grasps[..., 3:9])[..., None, :, :]
    return rotation_vector(held.transpose(-1, -2) @ matrix_from_6d(waypoints[..., 3:9]))[..., 2]


def test_what_is_proposed_was_shown_and_lies_not_between(taught: tuple[Any, dict[str, Any]]) -> None:
    """Both directions are drawn, and turned key frame by key frame as far as one demonstration does."""
    policy, batch = taught
    cloud, _ = policy.observed(batch)
    labels = policy.labels
    place = labels.grasps[labels.plan_of[batch["index"]], :3]
    drawn, _ = policy.model.proposed(cloud, place[:, None], 64)
    plan = key_frames(drawn[:, 0], place[:, None].expand(-1, 64, -1))
    grasps, waypoints = plan[..., 1, :], plan[..., 3:, :]
    found, shown = turns_of(grasps, waypoints).flatten(0, 1), turns_of(labels.grasps, labels.waypoints)
    like = (found[:, None] - shown).abs().amax(dim=-1).amin(dim=1) < 0.15 * shown.abs().max()
    assert like.float().mean() > 0.5
    shares = [(torch.sign(found[like, -1]) == sign).float().mean() for sign in (-1, 1)]
    assert min(shares) > 0.15


def test_the_scorer_learns_the_share_that_opens_and_that_nothing_opens_elsewhere(
    taught: tuple[Any, dict[str, Any]],
) -> None:
    policy, batch = taught
    cloud, _ = policy.observed(batch)
    labels, plan = policy.labels, policy.labels.plan_of[batch["index"]]
    grasp = labels.grasps[plan]
    code = encode_trajectory(grasp, labels.waypoints[plan], grasp[:, :3])
    places = torch.stack([grasp[:, :3], grasp[:, :3] + torch.tensor([0.0, 0.0, 0.15])], dim=1)
    with torch.no_grad():
        here, there = policy.model.score(cloud, places, torch.stack([code, code], dim=1)).sigmoid().unbind(dim=1)
    assert here.mean() == pytest.approx(float(labels.share[plan].mean()), abs=0.15)
    assert there.mean() < 0.5 * here.mean()


# Run time -----------------------------------------------------------------------------------------------------------


def test_a_finished_plan_stays_at_its_last_key_frame(make: MakePolicy) -> None:
    policy, *_ = make()
    policy.eval()
    observation = observed(toy_world("bottle_000", 3), np.random.default_rng(0))
    actions = torch.stack([policy.select_action(observation) for _ in range(14)])
    assert torch.equal(actions[10:], actions[10:11].expand(4, -1, -1))
    assert not torch.equal(actions[9], actions[10])


def played(policy: Any, direction: int) -> tuple[torch.Tensor, np.ndarray, bool]:
    """Lets a policy act at the first demonstration's bottle: what it sent, what was felt, whether it opened."""
    world, rng = toy_world("bottle_000", 0, {"direction": direction}), np.random.default_rng(0)
    policy.reset()
    torch.manual_seed(5)
    sent, felt = [], []
    for _ in range(11):
        sent.append(policy.select_action(observed(world, rng))[0])
        world.step(Goal(*pose_from_vector(sent[-1].numpy()), Phase.TRY))
        felt.append(world.feedback.tcp_in_base)
    return torch.stack(sent), np.stack(felt), any(world.successes)


def test_what_is_hidden_decides_what_comes_of_a_plan_and_changes_nothing_of_it(make: MakePolicy) -> None:
    """A demonstration's plan opens that bottle and stalls at one that turns the other way: the same bits are sent."""
    policy, *_ = make()
    policy.eval()
    labels, shown = policy.labels, policy.labels.plan_of[0]

    def proposed(cloud: torch.Tensor, places: torch.Tensor, *_: Any) -> tuple[torch.Tensor, torch.Tensor]:
        code = encode_trajectory(labels.grasps[shown], labels.waypoints[shown], places[0, 0])
        seen = 1e-3 * cloud.std()  # what is seen is in every number: who looked again would send other bits
        return (code + seen)[None, None, None], torch.ones(1, 1, 1)

    policy.model.proposed = proposed
    direction = int(toy_world("bottle_000", 0).hidden["direction"])
    (sent, felt, opened), (other, stalled, not_opened) = (played(policy, each) for each in (direction, -direction))
    assert opened
    assert not not_opened
    assert not np.array_equal(felt, stalled)
    assert torch.equal(sent, other)


def test_the_plan_is_shifted_with_the_scene(make: MakePolicy) -> None:
    policy, *_ = make()
    policy.eval()
    here, shift = observed(toy_world("bottle_000", 3), np.random.default_rng(0)), np.array([0.05, -0.1, 0.02])
    there = {
        schema.POINT_CLOUD: here[schema.POINT_CLOUD] + torch.from_numpy(shift).float(),
        schema.STATE: here[schema.STATE] + torch.cat([torch.from_numpy(shift).float(), torch.zeros(21)]),
    }
    noise = torch.randn(1, 1, 12, policy.config.latent_dim)
    plan = policy.predict_action_chunk(here, noise=noise)
    torch.testing.assert_close(
        policy.predict_action_chunk(there, noise=noise), turned_and_shifted(plan, 0.0, shift), rtol=0, atol=1e-3
    )


def test_episodes_of_a_batch_are_planned_each_by_itself(make: MakePolicy) -> None:
    policy, *_ = make()
    policy.eval()
    single = [observed(toy_world("bottle_000", seed), np.random.default_rng(seed)) for seed in (1, 2, 3)]
    batch = {key: torch.cat([each[key] for each in single]) for key in single[0]}
    noise = torch.randn(3, 1, 12, policy.config.latent_dim)
    together = policy.predict_action_chunk(batch, noise=noise)
    for row, each in enumerate(single):
        alone = policy.predict_action_chunk(each, noise=noise[row : row + 1])
        torch.testing.assert_close(together[row : row + 1], alone, rtol=0, atol=1e-4)
