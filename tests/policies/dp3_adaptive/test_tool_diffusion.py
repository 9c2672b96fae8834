"""Diffusion in the tool's frame: encoding, condition, and redraws of chunks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import PRE_GRASP
from lerobot_adamanip.contract.rotations import rotation_6d_from_matrix
from lerobot_policy_adamanip.affordance.plans import with_gripper
from lerobot_policy_adamanip.common.tool_frame import pose_after
from lerobot_policy_adamanip.dp3_adaptive.tool_inputs import past_of, tool_of
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window

MakeTiny = Callable[..., tuple[Any, ...]]
PULL = torch.tensor([0.0, 0.0, -0.05, 0.0, 0.0, 0.0, 0.0])
TURN = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0])
OPEN = PULL + torch.eye(7)[6]


def poses(rows: int, steps: int) -> torch.Tensor:
    """Any poses (rows, steps, 10) within a metre."""
    draw = np.random.default_rng(0)
    turns = rotation_6d_from_matrix(Rotation.random(rows * steps, random_state=0).as_matrix())
    parts = [draw.uniform(-0.5, 0.5, (len(turns), 3)), turns, draw.uniform(size=(len(turns), 1))]
    return torch.from_numpy(np.concatenate(parts, axis=1)).float().reshape(rows, steps, 10)


def test_a_chunk_is_decoded_as_it_was_encoded_and_any_values_become_poses(make_tiny: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_tiny(preset="diffusion")
    window, actions, _ = policy.training_window(batch_of(dataset, before))
    head, bound = policy.head, policy.config.clip_sample_range
    assert head.encode(actions, window).abs().max() < bound
    for chunk in (actions, poses(*actions.shape[:2])):
        torch.testing.assert_close(head.decode(head.encode(chunk, window), window), chunk, rtol=0, atol=1e-5)
    staying = head.encode(window.observations[schema.STATE][:, -1:, :10], window)
    torch.testing.assert_close(staying[..., :3], torch.zeros(len(actions), 1, 3), rtol=0, atol=1e-4)
    made = head.decode(bound * (2 * torch.rand_like(actions) - 1), window)
    rows = made[..., 3:9].unflatten(-1, (2, 3))
    torch.testing.assert_close(rows @ rows.mT, torch.eye(2).expand(*made.shape[:2], 2, 2), rtol=0, atol=1e-5)
    assert ((made[..., 9] >= 0) & (made[..., 9] <= 1)).all()
    # Of a short motion and a long one, the same error of a value is small relative to each.
    near, far = (head.decode(staying + step * torch.eye(10)[2], window)[..., :3] for step in (0.1, 3.0))
    start = window.observations[schema.STATE][:, -1:, :3]
    assert ((far - start).norm(dim=-1) > 50 * (near - start).norm(dim=-1)).all()


def closed_hand(policy: Any, window: Window, *, command: torch.Tensor, opening: float) -> Window:
    """Returns a window of hands that stay; all their commands were one motion (7,)."""
    state = window.observations[schema.STATE][:, -1:].clone()
    state[..., 9] = opening
    steps = policy.config.n_action_history_steps
    commands = pose_after(command.expand(len(state), 1, 7), state[..., :10]).repeat(1, steps, 1)
    valid = torch.ones(len(state), steps, dtype=torch.bool)
    return Window({**window.observations, schema.STATE: state.repeat(1, steps + 1, 1)}, commands, valid)


def test_contact_events_alone_enter_the_condition(make_tiny: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_tiny(preset="diffusion")
    policy.eval()
    start, *_ = policy.training_window(batch_of(dataset, before, 6))

    def condition(command: torch.Tensor, opening: float = 0.2, share: float = 1.0) -> torch.Tensor:
        window = closed_hand(policy, start, command=command, opening=opening)
        valid = torch.arange(policy.config.n_action_history_steps) < share * policy.config.n_action_history_steps
        return policy.head.condition(policy.model, replace(window, valid=valid[None]))

    nothing = condition(PULL, share=0.0)
    assert not nothing[:, -policy.config.memory_dim :].any()
    assert torch.equal(condition(OPEN), nothing)
    assert torch.equal(condition(0.05 * PULL), nothing)
    assert torch.equal(condition(PULL, 0.0), condition(PULL, 0.0, share=0.0))  # it holds nothing
    different = [condition(PULL), condition(PULL, share=0.5), condition(TURN), nothing]
    assert len({tuple(each.flatten().tolist()) for each in different}) == 4


def test_a_chunk_that_repeats_a_failure_or_pulls_without_a_grip_is_drawn_again(
    make_tiny: MakeTiny, batch_of: Any
) -> None:
    policy, before, _, dataset = make_tiny(preset="diffusion", num_anchors=3, num_draws=2)
    policy.eval()
    policy.fit_anchors(torch.stack([PULL, TURN, OPEN]).repeat(20, 1), torch.full((60,), 0.2))
    start, *_ = policy.training_window(batch_of(dataset, before, 6, 3))

    def drawn(first: torch.Tensor, second: torch.Tensor, failed: torch.Tensor, opening: float) -> int:
        window = closed_hand(policy, start, command=failed, opening=opening)
        goals = [pose_after(motion.expand(2, 7), tool_of(window)) for motion in (first, second)]
        chunks = iter(policy.head.encode(goal[:, None].expand(2, policy.config.horizon, 10), window) for goal in goals)
        policy.head.denoise = lambda *_: next(chunks)
        found = policy.head.sample(policy.model, window, None)[:, 0]
        goals.append(with_gripper(tool_of(window), 1.0))
        return [bool(torch.allclose(found, goal, atol=1e-4)) for goal in goals].index(True)

    assert past_of(closed_hand(policy, start, command=PULL, opening=0.2)).contact.any()
    assert drawn(PULL, TURN, failed=PULL, opening=0.2) == 1
    assert drawn(TURN, PULL, failed=PULL, opening=0.2) == 0
    assert drawn(PULL, 0.9 * PULL, failed=PULL, opening=0.2) == 2  # nothing else: the hand lets go
    assert drawn(PULL, OPEN, failed=OPEN, opening=0.0) == 1  # an empty closed hand
    assert drawn(PULL, OPEN, failed=OPEN, opening=0.2) == 0
    policy.config.avoid_repeats = False
    assert drawn(PULL, TURN, failed=PULL, opening=0.2) == 0


def test_an_open_hand_whose_way_is_blocked_backs_off(make_tiny: MakeTiny, batch_of: Any) -> None:
    """With each head; not where it was sent nowhere, or with the rules switched off."""
    for preset in ("diffusion", "fast"):
        policy, before, _, dataset = make_tiny(preset=preset)
        policy.eval()
        start, *_ = policy.training_window(batch_of(dataset, before, 6))
        ahead = torch.eye(7)[2] * 0.05 + torch.eye(7)[6]
        blocked = closed_hand(policy, start, command=ahead, opening=1.0)
        tool = tool_of(blocked)
        retreat = pose_after(torch.tensor([[0.0, 0.0, -PRE_GRASP, 0.0, 0.0, 0.0, 1.0]]), tool)
        drawn = policy.head.sample(policy.model, blocked, None)
        torch.testing.assert_close(drawn, retreat[:, None].expand_as(drawn), rtol=0, atol=1e-6)
        staying = closed_hand(policy, start, command=torch.eye(7)[6], opening=1.0)
        for window, avoid in ((staying, True), (blocked, False)):
            policy.config.avoid_repeats = avoid
            assert not torch.allclose(policy.head.sample(policy.model, window, None)[:, 0], retreat, atol=1e-3)


def test_refinement_moves_the_first_action_of_a_chunk_alone(make_tiny: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_tiny(preset="diffusion", num_draws=1)
    policy.eval()
    window, actions, _ = policy.training_window(batch_of(dataset, before, 0, 3))
    motions = policy.model.motions
    motions.anchors[:, 2], motions.anchors[:, 6], motions.spread[:] = 0.1, 1.0, 0.02
    policy.head.denoise = lambda *_: policy.head.encode(actions, window)
    found = policy.head.sample(policy.model, window, None)
    torch.testing.assert_close(found[:, 1:], actions[:, 1:], rtol=0, atol=1e-5)
    assert not torch.isclose(found[:, 0, :3], actions[:, 0, :3], atol=1e-4).all(dim=-1).any()
