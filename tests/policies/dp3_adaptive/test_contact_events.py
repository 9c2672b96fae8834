"""Contact events, the memory of them, and the rule ``no_repeat``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from lerobot_adamanip.contract import schema
from lerobot_policy_adamanip.common.contacts import END, EVENT_DIM, ContactMemory, Past
from lerobot_policy_adamanip.common.geometry import motion_between, pose_after
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.dp3_adaptive import no_repeat
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import Inference

MakeTiny = Callable[..., tuple[Any, ...]]
HOLDING, EMPTY = 0.2, 0.0
AT_REST = torch.tensor([0.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, HOLDING])
"""A closed hand that holds something."""
PULL = torch.tensor([-0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
PUSH = torch.tensor([0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
TURN = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0])
OPEN = PULL + torch.eye(7)[6]
Step = tuple[Tensor, float]
Played = tuple[Tensor, Tensor, Tensor]


def played(*steps: Step, opening: float = HOLDING) -> Played:
    """Returns commands (1, H, 10), poses (1, H + 1, 10) and validity of motions, each followed by a share of it.

    The first is the key frame in which the hand closed.
    """
    poses = [torch.cat([AT_REST[:9], torch.tensor([opening])])] * 2
    commands = [AT_REST]
    for motion, share in steps:
        commands.append(pose_after(motion, poses[-1]))
        done = pose_after(torch.cat([motion[:6] * share, motion[6:]]), poses[-1])
        poses.append(torch.cat([done[:9], motion[6:].clamp(min=opening)]))
    return torch.stack(commands)[None], torch.stack(poses)[None], torch.ones(1, len(commands), dtype=torch.bool)


def repeats(past: Played, *motions: Tensor, this_grip: bool = False) -> list[bool]:
    """Returns whether motions would repeat a failure of the past, or one of the present grip."""
    return no_repeat.repeats_failure(Past(*past), torch.stack(motions)[None])[this_grip][0].tolist()


# Contact events -----------------------------------------------------------------------------------------------------


def test_only_motions_of_a_closed_hand_are_contact_events() -> None:
    past = played((PULL, 0.0), (0.1 * PULL, 1.0), (TURN, 1.0), (OPEN, 1.0), (OPEN, 0.0), (TURN, 0.0))
    assert Past(*past).contact[0].tolist() == [False, True, False, True, False, False, False]
    assert not Past(*past[:2], torch.zeros_like(past[2])).contact.any()


@pytest.mark.parametrize("is_dense", [False, True])
def test_at_control_rate_a_motion_that_still_settles_is_no_contact_event(is_dense: bool) -> None:
    past = Past(*played((PULL, -0.6), (PULL, 0.0), (PULL, 0.9), (TURN, -0.6)), is_dense=is_dense)
    assert past.contact[0].tolist() == [False, not is_dense, True, True, not is_dense]


def test_a_closed_hand_that_holds_nothing_can_only_push() -> None:
    past = played((PULL, 1.0), (TURN, 1.0), (PUSH, 0.0), (-PUSH, 1.0), (0.3 * PUSH, 0.0), opening=EMPTY)
    assert Past(*past).contact[0].tolist() == [False, False, False, True, False, False]


def test_an_open_hand_that_closes_in_place_on_nothing_has_missed() -> None:
    open_hand = torch.cat([AT_REST[:9], torch.tensor([1.0])])
    for reached, shift, missed in ((EMPTY, 0.0, True), (HOLDING, 0.0, False), (EMPTY, 0.02, False)):
        closing = pose_after(shift * torch.eye(7)[2], open_hand)
        after = torch.cat([closing[:9], torch.tensor([reached])])
        commands, poses = torch.stack([open_hand, closing])[None], torch.stack([open_hand, open_hand, after])[None]
        assert Past(commands, poses, torch.ones(1, 2, dtype=torch.bool)).missed[0].tolist() == [False, missed]
        assert not Past(commands, poses, torch.zeros(1, 2, dtype=torch.bool)).missed.any()


def test_what_is_no_contact_event_leaves_no_trace_in_the_memory() -> None:
    memory, happened = ContactMemory(8), torch.randn(2, 6, EVENT_DIM)
    contact = torch.tensor([[0, 1, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0]], dtype=torch.bool)
    other = torch.where(contact[..., None], happened, torch.randn_like(happened))
    assert torch.equal(memory(happened, contact), memory(other, contact))
    assert not memory(happened, contact)[1].any()
    assert memory(happened, contact)[0].all()


def test_the_end_of_an_earlier_episode_is_read_and_is_no_try() -> None:
    commands, poses, valid = played((PULL, 0.0), (TURN, 0.0), (PULL, 0.0))
    before = Past(commands, poses, valid)
    commands = commands.clone()
    commands[:, 2, 9] = END
    past = Past(commands, poses, valid)
    assert before.contact[0].tolist() == [False, True, True, True]
    assert past.contact[0].tolist() == [False, True, False, False]  # what follows begins with another hand
    assert past.ends[0].tolist() == [False, False, True, False]
    assert not Past(commands, poses, torch.zeros_like(valid)).ends.any()
    rows, others = past.events()[0], torch.tensor([0, 1, 3])
    assert torch.equal(rows[2, :6], before.events()[0][2, :6]), "what was commanded is known"
    assert rows[2, 6:].tolist() == [END] + [0.0] * (EVENT_DIM - 8) + [1.0], "what came of it is not"
    assert torch.equal(rows[others], before.events()[0][others])


def test_without_feedback_an_event_is_the_command_alone() -> None:
    commands, poses, valid = played((PULL, 0.5), (TURN, 1.0))
    other = poses.clone()
    other[:, -1, :3] += 0.02  # the arm went elsewhere than it was sent
    plain = [Past(commands, each, valid).events(feedback=False) for each in (poses, other)]
    felt = [Past(commands, each, valid).events() for each in (poses, other)]
    assert torch.equal(*plain)
    assert not torch.equal(*felt)
    torch.testing.assert_close(plain[0][..., :7], felt[0][..., :7])


def test_the_order_of_contact_events_is_remembered() -> None:
    memory, happened, contact = ContactMemory(8), torch.randn(1, 4, EVENT_DIM), torch.tensor([[1, 0, 1, 1]]).bool()
    alone, every = happened[:, [0, 2, 3]], torch.ones(1, 3, dtype=torch.bool)
    torch.testing.assert_close(memory(happened, contact), memory(alone, every))
    assert not torch.allclose(memory(alone.flip(1), every), memory(alone, every), atol=1e-4)


# Failures -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("steps", "wanted"),
    [
        ([], [False, False, False, False]),
        ([(PULL, 0.0)], [True, False, False, False]),
        ([(PULL, 1.0)], [False, False, False, False]),
        ([(PULL, 0.1), (TURN, 0.1)], [True, True, False, False]),
        ([(PULL, 0.0), (TURN, 1.0)], [False, False, False, False]),  # the turn has moved something
        ([(TURN, 1.0), (TURN, 0.1)], [False, True, False, False]),  # it went so far, and no further
        ([(PULL, 0.0), (OPEN, 0.0)], [True, False, False, False]),  # with another grip, too
        ([(PULL, 0.23)], [True, False, False, False]),
        ([(PULL, 0.27)], [False, False, False, False]),  # done in part: may go on
    ],
)
def test_failures_are_not_repeated_until_something_has_moved(steps: list[Step], wanted: list[bool]) -> None:
    past = played(*steps)
    assert repeats(past, PULL, TURN, -TURN, OPEN) == wanted
    released = any(motion is OPEN for motion, _ in steps)
    assert repeats(past, PULL, TURN, -TURN, OPEN, this_grip=True) == ([False] * 4 if released else wanted)


def test_a_failure_is_the_same_whichever_way_round_the_part_is_held() -> None:
    """Seen from a hand that was turned half way about its approach, the same motion has another sign."""
    commands, poses, valid = played((PULL, 0.0), (TURN, 0.0))
    goals = [pose_after(motion, poses[0, -1]) for motion in (PULL, -PULL)]
    # Turned by pi about the approach: an equivalent grasp.
    poses[:, -1] *= torch.tensor([1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
    pull, back = (torch.cat([motion_between(goal, poses[0, -1])[:3], torch.zeros(4)]) for goal in goals)
    torch.testing.assert_close(pull, -PULL, rtol=0, atol=1e-6)
    assert repeats((commands, poses, valid), pull, back, TURN, -TURN) == [True, False, True, False]


def test_a_lost_grip_is_a_failure_however_far_the_hand_went() -> None:
    commands, poses, valid = played((TURN, 1.0))
    poses[:, -1, 9] = EMPTY
    assert repeats((commands, poses, valid), TURN, -TURN) == [True, False]
    earlier = played((PULL, 0.0), (TURN, 1.0))
    earlier[1][:, -1, 9] = EMPTY
    assert repeats(earlier, PULL, TURN) == [True, True]  # nothing has moved since the pull


def test_a_failure_elsewhere_forbids_nothing() -> None:
    commands, poses, valid = played((PULL, 0.0))
    poses[:, -1, 0] += 0.1
    assert repeats((commands, poses, valid), PULL) == [False]


# Draws ----------------------------------------------------------------------------------------------------------------


def test_what_is_new_is_drawn_else_what_another_grip_failed_at_else_the_hand_lets_go() -> None:
    cases = set()
    for _ in range(300):
        probabilities, opens = (4 * torch.randn(5)).softmax(dim=0), torch.rand(5) < 0.3
        rejected = torch.rand(5) < 0.8
        useless = rejected & (torch.rand(5) < 0.8)
        new, other, releases = probabilities * ~rejected, probabilities * ~useless, probabilities * opens
        least = no_repeat.MIN_PROBABILITY
        case = [bool(new.sum() >= least), bool(other.sum() >= least), bool(releases.any()), True].index(True)
        expected = (new, other, releases, probabilities)[case]
        rows = (part[None] for part in (probabilities, rejected, useless))
        torch.testing.assert_close(no_repeat.allowed_probabilities(*rows, opens)[0], expected / expected.sum())
        cases.add(case)
    assert cases == {0, 1, 2, 3}


# In a policy -------------------------------------------------------------------------------------------------------


def closed_hand(policy: Any, window: Window, *, command: Tensor, opening: float) -> Window:
    """Returns a window of hands that stay; all their commands were one motion (7,)."""
    state = window.observations[schema.STATE][:, -1:].clone()
    state[..., 9] = opening
    steps = policy.config.n_action_history_steps
    commands = pose_after(command.expand(len(state), 1, 7), state[..., :10]).repeat(1, steps, 1)
    valid = torch.ones(len(state), steps, dtype=torch.bool)
    return Window({**window.observations, schema.STATE: state.repeat(1, steps + 1, 1)}, commands, valid)


@pytest.mark.parametrize("switch", [False, True])
@pytest.mark.parametrize(("failed", "repeated"), [(PULL, True), (TURN, False)])
def test_a_policy_with_the_rule_does_not_draw_what_failed(
    make_anchors: MakeTiny, batch_of: Any, failed: Tensor, repeated: bool, switch: bool
) -> None:
    """The memory is untrained, and the network prefers to pull."""
    policy, before, _, dataset = make_anchors(num_anchors=2, num_refinements=0)
    policy.eval().fit_anchors(torch.stack([PULL, TURN]).repeat(20, 1))
    start, *_ = policy.training_window(batch_of(dataset, before, 6))
    window, head = closed_hand(policy, start, command=failed, opening=HOLDING), policy.model
    logits = torch.zeros(1, 2).index_fill(1, head.motions.nearest(PULL)[None], 2.0)
    forward = head.forward
    head.forward = lambda window: (forward(window)[0], logits, forward(window)[2])
    head.denoiser.forward = lambda *noisy: torch.zeros(1, 2, 7)
    policy.config.inference = Inference(temperature=1.0, no_repeat=switch)
    action = head.sample(window, torch.full((1, 1), 0.5))[:, 0]
    expected = TURN if switch and repeated else PULL
    torch.testing.assert_close(motion_between(action, head.tool(window))[0], expected, rtol=0, atol=1e-4)


def test_the_memory_can_be_switched_off_alone(make_anchors: MakeTiny, batch_of: Any) -> None:
    """Then the action is that of a hand without contact events, and the loss is as before."""
    policy, before, _, dataset = make_anchors(num_refinements=0)
    policy.eval()
    with torch.no_grad():
        for weight in policy.model.memory.parameters():
            weight.normal_()
    batch = batch_of(dataset, before, *[6] * 20)
    start, *_ = policy.training_window(batch)
    window = closed_hand(policy, start, command=TURN, opening=HOLDING)
    untouched = replace(window, valid=~window.valid)
    noise = torch.rand(20, policy.config.horizon, 10)
    drawn, losses = [], []
    for memory in (True, False):
        policy.config.inference = Inference(memory=memory)
        drawn.append([policy.model.sample(each, noise) for each in (window, untouched)])
        torch.manual_seed(0)
        losses.append(policy.forward(batch)[0])
    assert not torch.equal(drawn[0][0], drawn[1][0])
    assert torch.equal(drawn[1][0], drawn[1][1])
    assert torch.equal(drawn[0][1], drawn[1][1])
    assert torch.equal(*losses)
