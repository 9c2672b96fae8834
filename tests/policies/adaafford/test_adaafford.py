"""The policy that adapts: what it concludes, learns, decides and remembers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from toy_demos import observed, toy_world, trained

from lerobot_adamanip.contract import schema
from lerobot_policy_adamanip.adaafford.interactions import InteractionMemory
from lerobot_policy_adamanip.adaafford.network import action_numbers, decode_proposal, encode_proposal, trim_padding
from lerobot_policy_adamanip.affordance.plans import GRASP_DIM, PART_RADIUS_M
from lerobot_policy_adamanip.common.geometry import motion_between

MakePolicy = Callable[..., tuple[Any, ...]]
SMALL: dict[str, Any] = {
    "hidden_dim": 16, "held_proposals": 6, "contact_points": 3, "contact_proposals": 3,
}  # fmt: skip


@pytest.fixture
def make(make_toy_policy: MakePolicy, adaptive_toy_root: Path) -> MakePolicy:
    """Still untrained, it approaches with an open hand: which is to be learnt."""

    def build(**changes: Any) -> tuple[Any, ...]:
        policy, *rest = make_toy_policy("adaafford", adaptive_toy_root, **{**SMALL, **changes})
        policy.model.actor.decoder[-1].bias.data[9] = 1.0
        return policy, *rest

    return build


def acting(policy: Any) -> tuple[Any, torch.Tensor, torch.Tensor]:
    """A policy at run time, the cloud (1, N, 3) that it sees and the pose (10,) of its open hand."""
    cloud, pose = policy.eval().observed(observed(toy_world("bottle_000", 1), np.random.default_rng(0)))
    return policy, cloud, pose[0]


def told(policy: Any, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Tokens (1, H, 22) and features of places (1, H, F) of real interactions."""
    labels, numbers = policy.labels, torch.nonzero(policy.labels.tried).flatten()[:count][None]
    tokens = policy.model.tokens(labels.before[numbers], labels.command[numbers], labels.after[numbers])
    return tokens, torch.randn(1, count, policy.config.feature_dim)


# Summaries ----------------------------------------------------------------------------------------------------------


def test_a_summary_is_a_weighted_mean_that_knows_numbers_but_no_order(make: MakePolicy) -> None:
    policy, *_ = make()
    model, (tokens, features) = policy.model, told(policy, 5)
    valid, order = torch.ones(1, 5, dtype=torch.bool), torch.tensor([3, 0, 4, 1, 2])
    z = model.summary(tokens, features, valid)
    each = torch.cat([model.summary(*(part[:, k : k + 1] for part in (tokens, features, valid))) for k in range(5)])
    assert ((z >= each.amin(dim=0) - 1e-4) & (z <= each.amax(dim=0) + 1e-4)).all()
    twice = model.summary(tokens.repeat(1, 2, 1), features.repeat(1, 2, 1), valid.repeat(1, 2))
    torch.testing.assert_close(twice, z, rtol=0, atol=1e-4)
    torch.testing.assert_close(model.summary(tokens[:, order], features[:, order], valid), z)
    renumbered = torch.cat([tokens[:, order, :-1], tokens[..., -1:]], dim=-1)
    assert not torch.allclose(model.summary(renumbered, features[:, order], valid), z, atol=1e-5)
    some = torch.tensor([[True, True, False, False, False]])
    short = model.summary(tokens[:, :2], features[:, :2], some[:, :2])
    torch.testing.assert_close(model.summary(tokens, features, some), short)
    assert not model.summary(tokens, features, torch.zeros_like(valid)).any()
    assert not policy.summarise(torch.rand(1, 120, 3), InteractionMemory(4)).any()
    assert trim_padding(torch.tensor([[4, -1, -1], [1, 2, -1]])).tolist() == [[4, -1], [1, 2]]
    assert trim_padding(torch.full((2, 3), -1)).tolist() == [[-1], [-1]]


def test_actions_and_proposals_are_their_numbers_again(make: MakePolicy) -> None:
    policy, *_ = make()
    labels = policy.labels
    place = labels.before[:, :3] + 0.01
    code = encode_proposal(labels.before, labels.command, labels.opening, place)
    grasp, command = decode_proposal(code, place)
    torch.testing.assert_close(grasp[:, :9], labels.before[:, :9], rtol=0, atol=1e-5)
    torch.testing.assert_close(grasp[:, 9], labels.opening)
    torch.testing.assert_close(command[:, :9], labels.command[:, :9], rtol=0, atol=1e-4)
    assert not command[:, 9].any()
    torch.testing.assert_close(action_numbers(grasp, command), code[:, [*range(6), *range(10, 16)]], rtol=0, atol=1e-4)


# Training -----------------------------------------------------------------------------------------------------------


def test_it_learns_from_what_was_felt(make: MakePolicy, batch_of: Any) -> None:
    """Outcomes are predicted better from interactions before them than from nothing."""
    policy, before, _, dataset = make()
    labels = policy.labels
    told_something = torch.nonzero((labels.history[:, 0] >= 0) & (labels.candidates[:, 0] >= 0)).flatten().tolist()
    batch = batch_of(dataset, before, *told_something)
    losses = trained(policy, batch, 90)
    assert np.mean(losses[-10:]) < 0.6 * np.mean(losses[:5])
    with torch.no_grad():
        cloud, _ = policy.observed(batch)
        asked = policy._interactions(trim_padding(labels.candidates[batch["index"]]))
        seen = policy._interactions(trim_padding(labels.history[batch["index"]]))
        tokens = policy.model.tokens(seen.before, seen.command, seen.after)
        z = policy.model.summary(tokens, policy.model.features(cloud, seen.before[..., :3]), seen.valid)
        features = policy.model.features(cloud, asked.before[..., :3])
        informed, blind = (policy._success_error(asked, features, each).mean() for each in (z, torch.zeros_like(z)))
    assert informed < 0.7 * blind


@pytest.mark.nightly
def test_what_is_proposed_is_what_was_tried(make: MakePolicy, batch_of: Any) -> None:
    """And not the mean of two directions, which is hardly a motion."""
    policy, before, _, dataset = make()
    labels = policy.labels
    known = torch.nonzero(labels.candidates[:, 0] >= 0).flatten().tolist()[::4]
    batch = batch_of(dataset, before, *known)
    trained(policy, batch, 600)
    cloud, _ = policy.observed(batch)
    asked = policy._interactions(trim_padding(labels.candidates[batch["index"]]))
    with torch.no_grad():
        given = policy.model.actor_features(cloud, asked.before[..., :3])
        drawn = policy.model.actor.proposals(given, 64)[..., GRASP_DIM:]
    tried = action_numbers(asked.before, asked.command)[asked.tried][:, None, 6:]
    nearest = (drawn[asked.tried] - tried).abs().amax(dim=-1).amin(dim=1)
    assert (nearest < 0.3 * tried.squeeze(1).abs().amax(dim=-1)).float().mean() > 0.8


def test_actions_away_from_contacts_are_taught_to_fail(
    make: MakePolicy, batch_of: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Proposals too; but not one that, from beside a part, is a grasp of it."""
    policy, before, _, dataset = make(num_astray=40)
    labels = policy.labels
    batch = batch_of(dataset, before, *torch.nonzero(labels.candidates[:, 0] >= 0).flatten().tolist())
    cloud, _ = policy.observed(batch)
    known = policy._interactions(trim_padding(labels.candidates[batch["index"]]))
    held = known.before[..., :3]
    policy.model.actor.decoder[-1].bias.data[6:9] = torch.tensor([0.6, 0.0, 0.0])  # 3 cm from the points it starts at
    negatives = policy._negatives(cloud, known, held, held[:, :1] + 1.0)
    torch.testing.assert_close(negatives.places[:, :1], held[:, :1] + 1.0)
    torch.testing.assert_close(negatives.actions[:, :1], action_numbers(known.before, known.command)[:, :1])
    near = (torch.cdist(negatives.places[:, 1:], held) <= PART_RADIUS_M).any(dim=-1)
    assert near.any()
    assert not near.all()
    assert negatives.valid[:, 0].all()
    assert (negatives.valid[:, 1:] == ~near).all()
    logits = torch.zeros(negatives.valid.shape, requires_grad=True)
    monkeypatch.setattr(policy.model, "success_logits", lambda *_: logits)
    monkeypatch.setattr(policy.model, "predicted_information", lambda *_: torch.zeros(logits.shape))
    policy._negative_error(negatives, torch.zeros(1), torch.zeros(1)).sum().backward()
    assert logits.grad is not None
    assert ((logits.grad > 0) == negatives.valid).all()


# Run time -----------------------------------------------------------------------------------------------------------


def test_a_memory_keeps_the_latest_counts_all_and_knows_what_is_held() -> None:
    memory, pose = InteractionMemory(2), torch.tensor([0.5, 0, 0.6, 1, 0, 0, 0, -1, 0, 1.0])
    closed, step = pose * torch.tensor([1.0] * 9 + [0.0]), 0.01 * torch.eye(10)[0]
    for command in (closed, *(closed + number * step for number in range(4))):
        memory.sent = (pose, command)
        memory.observe(pose)
    assert (memory.made, len(memory.interactions)) == (4, 2)
    assert memory.interactions[-1][1][0] == pytest.approx(0.53)
    for opening, felt, holds in ((1.0, 0.3, True), (1.0, 0.0, False), (0.0, 0.0, True)):
        memory = InteractionMemory(2)
        for before in [pose] if opening else [pose + 10 * step, pose]:  # in place a grasp, on its way a push
            memory.sent = (before, closed)
            memory.observe(closed)
        assert memory.opening == opening
        assert memory.holds(torch.cat([closed[:9], torch.tensor([felt])])) is holds


def test_it_remembers_at_run_time_what_its_labels_say(make: MakePolicy) -> None:
    """Given the commands of a demonstration, its memory is what training looks up, row by row."""
    policy, *_, dataset = make()
    policy.eval()
    rows = range(dataset.meta.episodes[0]["dataset_from_index"], dataset.meta.episodes[0]["dataset_to_index"] - 1)
    labels, plan, seen = policy.labels, policy._plan, []

    def recorded(cloud: Any, pose: Any, memory: InteractionMemory) -> Any:
        seen.append((memory.made, memory.sent is None))
        return plan(cloud, pose, memory)

    policy._plan = recorded
    for row in rows:
        item = dataset[row]
        observation = {key: item[key][None] for key in (schema.POINT_CLOUD, schema.STATE)}
        seen.clear()
        policy.predict_action_chunk(observation)
        policy.select_action(observation)
        assert seen == seen[:1] * 2, "a chunk is planned with the same memory as the action that follows"
        numbers = labels.history[row][labels.history[row] >= 0]
        memory = policy._memories[0]
        assert memory.made == len(numbers)
        for number, parts in zip(numbers, memory.interactions, strict=True):
            for part, known in zip(parts, (labels.before, labels.command, labels.after), strict=True):
                torch.testing.assert_close(part, known[number])
        policy.replace_latest(item[schema.ACTION][None])
    assert policy._memories[0].made > 1


def in_contact(policy: Any, moved: bool, outside: bool = False) -> InteractionMemory:
    """A memory of one motion in contact that was felt to succeed or not; before it, of any way to the part."""
    memory, pose = InteractionMemory(8), torch.tensor([0.5, 0, 0.6, 1, 0, 0, 0, -1, 0, 1.0])
    closed, turned = pose.clone(), pose.clone()
    closed[9], turned[9], turned[0] = 0.3, 0.0, 0.52
    ways = [pose + 0.1, pose - 0.1] if outside else []
    for command in [*ways, pose]:
        memory.sent = (command, command)
        memory.observe(pose)
    grip = pose.clone()
    grip[9] = 0.0
    memory.sent = (pose, grip)
    memory.observe(closed)
    memory.sent = (closed, turned)
    memory.observe(turned if moved else closed)
    return memory


def test_conclusions_follow_from_what_was_felt_in_contact_and_from_nothing_else(make: MakePolicy) -> None:
    policy, *_ = make()
    cloud = torch.rand(1, 120, 3)
    z, other = (policy.summarise(cloud, in_contact(policy, moved)) for moved in (True, False))
    assert not torch.allclose(z, other, atol=1e-4)
    assert torch.equal(policy.summarise(cloud, in_contact(policy, True, outside=True)), z)


def judging(policy: Any, likely: Callable[[torch.Tensor], torch.Tensor], tells: float) -> None:
    """Lets C be a function of where actions start (..., 10), and G a number."""

    def judged(cloud: Any, z: Any, before: torch.Tensor, command: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        found = likely(before)
        return found, torch.full_like(found, tells)

    policy.model.scores = judged


def test_what_is_held_is_kept_unless_something_else_promises_more(make: MakePolicy) -> None:
    policy, cloud, pose = acting(make(contact_margin=0.1)[0])
    held, memory = pose.clone(), in_contact(policy, True)
    held[9] = 0.3
    for elsewhere, kept in ((0.55, True), (0.65, False)):

        def likely(before: torch.Tensor, other: float = elsewhere, here: torch.Tensor = held[:3]) -> torch.Tensor:
            return torch.where((before[..., :3] - here).norm(dim=-1) < 1e-4, 0.5, other)

        judging(policy, likely, 0.0)
        plan = policy._plan(cloud, held, memory)
        assert (len(plan) == 1) is kept
    assert plan.shape == (5, 10)


def test_candidates_hold_the_last_motion_again_and_the_way_back(make: MakePolicy) -> None:
    policy, cloud, _ = acting(make()[0])
    memory = in_contact(policy, True)
    before, command, after = memory.interactions[-1]
    commands, scores = policy._held_motions(cloud, after, policy.summarise(cloud, memory), memory)
    assert len(commands) == len(scores) == policy.config.held_proposals + 2
    again, back = commands[-2:]
    torch.testing.assert_close(motion_between(again, after)[:6], motion_between(command, before)[:6], rtol=0, atol=1e-4)
    torch.testing.assert_close(back[:9], before[:9])
    assert not commands[:, 9].any()


def test_information_counts_for_the_first_interactions_and_where_there_is_some(make: MakePolicy) -> None:
    policy, *_ = make(explorations=2, least_information=0.05)
    cloud, before = torch.rand(1, 120, 3), torch.randn(4, 10)
    memory, z = InteractionMemory(8), torch.zeros(1, 16)
    for made, tells, wanted in ((0, 0.2, 0.5), (1, 0.2, 0.5), (2, 0.2, 0.3), (0, 0.04, 0.3)):
        judging(policy, lambda pose: torch.full(pose.shape[:-1], 0.3), tells)
        memory.made = made
        torch.testing.assert_close(policy._scores(cloud, z, before, before, memory), torch.full((4,), wanted))
