"""Contact events, the memory of them, and each rule at inference with its switch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import PRE_GRASP
from lerobot_policy_adamanip.common.contacts import EVENT_DIM, ContactMemory, Past
from lerobot_policy_adamanip.common.geometry import fingers_swapped, motion_between, pose_after
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.dp3_adaptive import rules
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import Inference
from lerobot_policy_adamanip.dp3_adaptive.truncated import TypicalMotions

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
    return rules.repeats_failure(Past(*past), torch.stack(motions)[None])[this_grip][0].tolist()


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
    poses[:, -1] = fingers_swapped(poses[:, -1])
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


# Steps that are undone ----------------------------------------------------------------------------------------------


def approached(*steps: Step) -> Played:
    """Returns what an open hand did, in place of the hand that closed: see `played`."""
    commands, poses, valid = played(*((motion + torch.eye(7)[6], share) for motion, share in steps), opening=1.0)
    return commands[:, 1:], poses[:, 1:], valid[:, 1:]


def back(past: Played, *motions: Tensor) -> list[bool]:
    return rules.undoes_step(Past(*past), torch.stack(motions)[None])[0].tolist()


FORWARD, ASIDE = 4 * PUSH, 2 * PULL
CLOSE, RELEASE = torch.zeros(7), torch.eye(7)[6]


def to_open(motion: Tensor) -> Tensor:
    return motion + RELEASE


@pytest.mark.parametrize(
    ("steps", "motion", "expected"),
    [
        ([(FORWARD, 1.0)], ASIDE, False),
        ([(ASIDE, 1.0), (-ASIDE, 1.0)], ASIDE, True),  # wavers between two places
        ([(ASIDE, 1.0), (-ASIDE, 1.0)], -ASIDE, False),
        ([(ASIDE, 1.0), (FORWARD, 1.0)], -FORWARD, True),  # from the grasp, without having closed
        ([(ASIDE, 1.0), (FORWARD, 1.0)], FORWARD, False),
        ([(FORWARD, 0.1)], 0.9 * FORWARD, True),  # the same way is blocked
        ([(FORWARD, 0.1), (-FORWARD, 1.0)], 1.8 * FORWARD, False),  # from elsewhere it may be free
    ],
)
def test_an_open_hand_does_not_go_back_before_it_has_closed(steps: list[Step], motion: Tensor, expected: bool) -> None:
    past = approached(*steps)
    assert back(past, to_open(motion), motion) == [expected, False]  # closing on the way is something else


def test_a_hand_that_has_tried_may_go_back() -> None:
    """It closed, pulled in vain and let go: the way back to the place of before is no wavering."""
    commands, poses, valid = approached((ASIDE, 1.0), (FORWARD, 1.0))
    assert back((commands, poses, valid), to_open(-FORWARD)) == [True]
    tried = played((PULL, 0.0), (RELEASE, 1.0))
    shift = poses[:, -1:, :3] - tried[1][:, :1, :3]
    for part in tried[:2]:
        part[..., :3] += shift
    past = (
        torch.cat([commands, tried[0]], dim=1),
        torch.cat([poses, tried[1][:, 1:]], dim=1),
        torch.cat([valid, tried[2]], dim=1),
    )
    assert back(past, to_open(-FORWARD)) == [False]


@pytest.mark.parametrize(
    ("steps", "opening", "expected"),
    [
        ([], HOLDING, True),
        ([(CLOSE, 1.0)], HOLDING, True),  # waiting is no try
        ([(PULL, 0.0)], HOLDING, False),
        ([], EMPTY, False),  # nothing to try with
    ],
)
def test_what_is_held_is_tried_before_it_is_let_go(steps: list[Step], opening: float, expected: bool) -> None:
    assert back(played(*steps, opening=opening), RELEASE, TURN) == [expected, False]


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([], False),
        ([(FORWARD, 0.1)], True),
        ([(FORWARD, 0.5)], False),
        ([(-FORWARD, 0.0)], False),
        ([(CLOSE, 1.0)], False),
    ],
)
def test_the_way_of_an_open_hand_is_blocked_where_it_hardly_moves(steps: list[Step], expected: bool) -> None:
    past = approached(*steps) if steps else played()
    assert rules.is_blocked(Past(*past)).tolist() == [expected]
    assert not rules.is_blocked(Past(*past[:2], torch.zeros_like(past[2]))).any()
    assert not rules.is_blocked(Past(*played((FORWARD, 0.0)))).any()  # a closed hand tries


# Draws ----------------------------------------------------------------------------------------------------------------


def test_what_is_new_is_drawn_else_what_another_grip_failed_at_else_the_hand_lets_go() -> None:
    cases = set()
    for _ in range(300):
        probabilities, opens = (4 * torch.randn(5)).softmax(dim=0), torch.rand(5) < 0.3
        rejected = torch.rand(5) < 0.8
        useless = rejected & (torch.rand(5) < 0.8)
        new, other, releases = probabilities * ~rejected, probabilities * ~useless, probabilities * opens
        least = rules.MIN_PROBABILITY
        case = [bool(new.sum() >= least), bool(other.sum() >= least), bool(releases.any()), True].index(True)
        expected = (new, other, releases, probabilities)[case]
        rows = (part[None] for part in (probabilities, rejected, useless))
        torch.testing.assert_close(rules.allowed_probabilities(*rows, opens)[0], expected / expected.sum())
        cases.add(case)
    assert cases == {0, 1, 2, 3}


def test_what_is_unlikely_is_never_drawn() -> None:
    likely = torch.tensor([0.5, 0.0, 0.47, 0.01, 0.02, 0.0]).expand(200, 6)
    noise = torch.linspace(0, 1 - 1e-6, 200)
    drawn = rules.draw_anchor(Inference(probability_floor=True), likely, noise).tolist()
    assert drawn == sorted(drawn)
    assert set(drawn) == {0, 2}
    assert drawn.count(2) / 200 == pytest.approx(0.47 / 0.97, abs=0.02)
    assert set(rules.draw_anchor(Inference(), likely, noise).tolist()) == {0, 2, 3, 4}


def test_of_two_grasps_that_are_alike_the_less_turned_one_is_gone_to() -> None:
    turn = torch.zeros(4, 7)
    turn[:, 5] = torch.tensor([0.1, 1.4, 1.8, 3.0])
    home = torch.tensor([[0.5, 0.1, 0.4, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0]]).expand(4, -1)
    grasp = pose_after(turn, home)
    less = rules.swap_fingers(Inference(swap_fingers=True), grasp, home, home)
    torch.testing.assert_close(less[:2], grasp[:2])
    torch.testing.assert_close(motion_between(less, grasp)[2:, 5].abs(), torch.full((2,), torch.pi))
    # If the chosen pose is turned too, it is kept, as in demonstrations.
    torch.testing.assert_close(rules.swap_fingers(Inference(swap_fingers=True), grasp, grasp, home), grasp)
    assert torch.equal(rules.swap_fingers(Inference(), grasp, home, home), grasp)


def test_a_hand_does_what_was_shown_in_its_state_and_an_empty_one_may_open() -> None:
    opens, pulls, pushes = torch.eye(7)[6], -0.05 * torch.eye(7)[2], 0.05 * torch.eye(7)[2]
    shown = torch.stack([opens, pulls, pushes, torch.zeros(7)])
    openings = torch.tensor([0.3, 0.3, 0.3, 1.0]).repeat(100)
    openings[1:16:4] = 0.0  # 4 of 100 pulls: a grip that was lost
    openings[2:24:4] = 0.0  # 6 of 100 pushes
    motions = TypicalMotions(4)
    motions.fit(shown.repeat(100, 1), openings)
    for opening, allowed in (
        (0.0, [True, False, True, False]),
        (0.3, [True] * 3 + [False]),
        (1.0, [False] * 3 + [True]),
    ):
        tool = torch.cat([AT_REST[:9], torch.tensor([opening])])[None]
        assert motions.shown_from(tool)[0, motions.nearest(shown)].tolist() == [bool(each) for each in allowed]


# In a policy -------------------------------------------------------------------------------------------------------

PULL_OPEN = to_open(PULL)


def closed_hand(policy: Any, window: Window, *, command: Tensor, opening: float) -> Window:
    """Returns a window of hands that stay; all their commands were one motion (7,)."""
    state = window.observations[schema.STATE][:, -1:].clone()
    state[..., 9] = opening
    steps = policy.config.n_action_history_steps
    commands = pose_after(command.expand(len(state), 1, 7), state[..., :10]).repeat(1, steps, 1)
    valid = torch.ones(len(state), steps, dtype=torch.bool)
    return Window({**window.observations, schema.STATE: state.repeat(1, steps + 1, 1)}, commands, valid)


class Drawn:
    """A policy whose network wants one motion after another; says which one it acts on."""

    def __init__(self, policy: Any, window: Window, *motions: Tensor) -> None:
        self.policy, self.window, self.motions = policy.eval(), window, torch.stack(motions)
        policy.fit_anchors(self.motions.repeat(20, 1), torch.full((20 * len(motions),), HOLDING))
        order = policy.model.motions.nearest(self.motions)
        logits = torch.zeros(len(motions)).index_put((order,), -2.0 * torch.arange(len(motions)))
        forward = policy.model.forward
        policy.model.forward = lambda window: (forward(window)[0], logits[None], forward(window)[2])
        policy.model.denoiser.forward = lambda *noisy: torch.zeros(1, len(motions), 7)

    def acts_on(self, **switches: bool) -> Tensor:
        """Returns the motion (7,) to the action, with the network's likeliest draw first."""
        self.policy.config.inference = Inference(temperature=1.0, **switches)
        action = self.policy.model.sample(self.window, torch.full((1, 1), 0.5))[:, 0]
        return motion_between(action, self.policy.model.tool(self.window))[0]


CASES: list[tuple[str, Tensor, float, tuple[Tensor, Tensor], int]] = [
    ("no_repeat", PULL, HOLDING, (PULL, TURN), 1),
    ("no_repeat", PULL, HOLDING, (TURN, PULL), 0),
    ("no_undo", 0.1 * PULL, HOLDING, (PULL_OPEN, TURN), 1),
    ("hand_state_mask", PULL_OPEN, EMPTY, (PULL, PULL_OPEN), 1),
]
"""Switch, earlier command of a hand that did not move, its opening, motions in the network's order, acted on."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_each_rule_decides_a_draw_and_can_be_switched_on_alone(
    make_anchors: MakeTiny, batch_of: Any, case: tuple[str, Tensor, float, tuple[Tensor, Tensor], int]
) -> None:
    """The memory is untrained: the rule alone decides."""
    switch, command, opening, motions, expected = case
    policy, before, _, dataset = make_anchors(num_anchors=2, num_refinements=0)
    start, *_ = policy.training_window(batch_of(dataset, before, 6))
    drawn = Drawn(policy, closed_hand(policy, start, command=command, opening=opening), *motions)
    names = {item.name for item in fields(Inference)} - {"memory", "rules", "temperature", switch}
    for switches in ({"rules": True}, {switch: True}):
        torch.testing.assert_close(drawn.acts_on(**switches), motions[expected], rtol=0, atol=1e-4)
    for switches in ({}, dict.fromkeys(names, True)):
        torch.testing.assert_close(drawn.acts_on(**switches), motions[0], rtol=0, atol=1e-4)


def test_an_open_hand_whose_way_is_blocked_backs_off(make_anchors: MakeTiny, batch_of: Any) -> None:
    """Not where it was sent nowhere, or with the rule switched off."""
    policy, before, _, dataset = make_anchors(inference=Inference(rules=True))
    policy.eval()
    start, *_ = policy.training_window(batch_of(dataset, before, 6))
    blocked = closed_hand(policy, start, command=to_open(FORWARD), opening=1.0)
    retreat = pose_after(torch.tensor([[0.0, 0.0, -PRE_GRASP, 0.0, 0.0, 0.0, 1.0]]), policy.model.tool(blocked))
    drawn = policy.model.sample(blocked, None)
    torch.testing.assert_close(drawn, retreat[:, None].expand_as(drawn), rtol=0, atol=1e-6)
    staying = closed_hand(policy, start, command=RELEASE, opening=1.0)
    for window, switch in ((staying, True), (blocked, False)):
        policy.config.inference = Inference(back_off=switch)
        assert not torch.allclose(policy.model.sample(window, None)[:, 0], retreat, atol=1e-3)


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
