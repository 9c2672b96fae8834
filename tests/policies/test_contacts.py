"""What a policy remembers of its tries: contact events alone, and failures until something has moved."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from lerobot_policy_adamanip.common.contacts import EVENT_DIM, ContactMemory, Past
from lerobot_policy_adamanip.common.tool_frame import fingers_swapped, motion_between, pose_after

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
    found = Past(*past).repeats(torch.stack(motions)[None], failed_below=0.25)
    return found[this_grip][0].tolist()


# Contact events -----------------------------------------------------------------------------------------------------


def test_only_motions_of_a_closed_hand_are_contact_events() -> None:
    past = played((PULL, 0.0), (0.1 * PULL, 1.0), (TURN, 1.0), (OPEN, 1.0), (OPEN, 0.0), (TURN, 0.0))
    assert Past(*past).contact[0].tolist() == [False, True, False, True, False, False, False]
    assert not Past(*past[:2], torch.zeros_like(past[2])).contact.any()


def test_a_closed_hand_that_holds_nothing_can_only_push() -> None:
    past = played((PULL, 1.0), (TURN, 1.0), (PUSH, 0.0), (-PUSH, 1.0), (0.3 * PUSH, 0.0), opening=EMPTY)
    assert Past(*past).contact[0].tolist() == [False, False, False, True, False, False]


def test_what_is_no_contact_event_leaves_no_trace_in_the_memory() -> None:
    memory, happened = ContactMemory(8), torch.randn(2, 6, EVENT_DIM)
    contact = torch.tensor([[0, 1, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0]], dtype=torch.bool)
    other = torch.where(contact[..., None], happened, torch.randn_like(happened))
    assert torch.equal(memory(happened, contact), memory(other, contact))
    assert not memory(happened, contact)[1].any()
    assert memory(happened, contact)[0].all()


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
    return Past(*past).goes_back(torch.stack(motions)[None])[0].tolist()


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
    assert Past(*past).is_blocked(failed_below=0.25).tolist() == [expected]
    assert not Past(*past[:2], torch.zeros_like(past[2])).is_blocked(failed_below=0.25).any()
    assert not Past(*played((FORWARD, 0.0))).is_blocked(failed_below=0.25).any()  # a closed hand tries
