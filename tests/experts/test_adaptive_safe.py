"""The adaptive expert at a kinematic safe: it opens every one, by trial and error, and never by looking."""

from __future__ import annotations

import copy
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import KinematicWorld, adaptive, as_bytes, placed_parts, run

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.experts import Feedback, Goal, KeyFrames, Outcome, Phase, make_expert
from lerobot_adamanip.experts.doors import PULL_ANGLES

fast = settings(max_examples=25, deadline=None)
seeds = st.integers(0, 2**31)
ids = st.integers(0, 60).map(lambda number: object_id("safe", number))
directions = st.sampled_from([-1, 1])
hiddens = st.fixed_dictionaries({"locked": st.booleans(), "direction": directions})
LOCKED: dict[str, Any] = {"locked": True, "direction": 1}
UNLOCKED: dict[str, Any] = {"locked": False, "direction": 1}


@fast
@given(ids, hiddens, seeds, seeds)
def test_it_opens_locked_and_unlocked_safes_of_either_direction(
    name: str, hidden: dict[str, Any], seed: int, layout: int
) -> None:
    safe = KinematicWorld(name, hidden, layout=layout)
    episode = run(safe, adaptive(safe, seed))
    assert episode.opened > 0.95 * PULL_ANGLES[-1]
    assert episode.failed_pulls() == hidden["locked"]


@fast
@given(ids, hiddens, seeds)
def test_it_pulls_before_it_turns_and_leaves_the_knob_of_an_open_safe_alone(
    name: str, hidden: dict[str, Any], seed: int
) -> None:
    safe = KinematicWorld(name, hidden)
    phases = run(safe, adaptive(safe, seed)).phases
    assert phases[:4] == [Phase.APPROACH, Phase.APPROACH, Phase.GRASP, Phase.TRY]
    assert (Phase.UNLOCK in phases) == hidden["locked"]
    assert phases[-1] is Phase.OPEN


@fast
@given(ids, directions, seeds)
def test_a_direction_that_failed_is_not_tried_again(name: str, direction: int, seed: int) -> None:
    safe = KinematicWorld(name, {"locked": True, "direction": direction})
    turns = run(safe, adaptive(safe, seed)).turns()
    wrong = [stalled for sign, stalled in turns if sign != direction]
    assert wrong in ([], [True])
    signs = [sign for sign, _ in turns]
    changes = sum(a != b for a, b in pairwise(signs))
    assert changes == len(wrong)
    assert signs[-1] == direction


@pytest.mark.parametrize("direction", [-1, 1])
def test_which_direction_comes_first_is_left_to_chance_and_not_to_the_truth(direction: int) -> None:
    firsts = []
    for seed in range(200):
        safe = KinematicWorld("safe_005", {"locked": True, "direction": direction})
        firsts.append(run(safe, adaptive(safe, seed), until="knob").turns()[0][0])
    assert np.mean(np.array(firsts) == 1) == pytest.approx(0.5, abs=0.12)


@fast
@given(ids, hiddens, hiddens, seeds)
def test_flipping_the_hidden_state_changes_nothing_until_it_is_felt(
    name: str, first: dict[str, Any], second: dict[str, Any], seed: int
) -> None:
    one, other = (run(safe, adaptive(safe, seed)) for safe in (KinematicWorld(name, h) for h in (first, second)))
    pairs = zip(one.felt, other.felt, strict=False)
    same = [a.tcp_in_base.tobytes() == b.tcp_in_base.tobytes() and a.outcome == b.outcome for a, b in pairs]
    felt_alike = same.index(False) if False in same else len(same)
    assert as_bytes(one.goals[: felt_alike + 1]) == as_bytes(other.goals[: felt_alike + 1])
    if felt_alike < len(same):
        assert one.phases[felt_alike] is (Phase.TRY if first["locked"] != second["locked"] else Phase.UNLOCK)


@fast
@given(ids, hiddens, seeds)
def test_an_expert_that_is_told_a_history_repeats_it_byte_for_byte(
    name: str, hidden: dict[str, Any], seed: int
) -> None:
    safe = KinematicWorld(name, hidden)
    episode = run(safe, adaptive(safe, seed))
    np.random.default_rng().random()
    again = adaptive(KinematicWorld(name, {"locked": not hidden["locked"], "direction": -hidden["direction"]}), seed)
    goals = [next(again)]
    for feedback in episode.felt[:-1]:
        goals.append(again.send(feedback))
    assert as_bytes(goals) == as_bytes(episode.goals)
    with pytest.raises(StopIteration):
        again.send(episode.felt[-1])


felt_things = st.lists(
    st.tuples(st.sampled_from(list(Outcome)), st.floats(0, 1), st.floats(-1, 1), st.floats(-1.5, 1.5)), max_size=60
)


def listen(frames: KeyFrames, history: list[tuple[Outcome, float, float, float]]) -> list[Goal]:
    goals = [next(frames)]
    for outcome, gripper, shift, turn in history:
        pose = goals[-1].tcp_in_base @ transform((0.0, 0.0, 0.1 * shift), rotation_about((0, 0, 1), turn))
        try:
            goals.append(frames.send(Feedback(pose, gripper, outcome)))
        except StopIteration:
            break
    return goals


@fast
@given(ids, felt_things, seeds)
def test_whatever_it_feels_it_depends_on_feedback_and_its_own_dice_alone(name: str, history: Any, seed: int) -> None:
    parts = placed_parts(make_object(name))
    before = copy.deepcopy(parts)
    both = []
    for noise in (1, 2):
        np.random.seed(noise)  # noqa: NPY002  (an expert must not draw from the global source)
        generator = np.random.default_rng(seed)
        both.append(listen(make_expert("safe", "adaptive", parts, generator=generator), history))
    assert as_bytes(both[0]) == as_bytes(both[1])
    assert all(np.isfinite(goal.action()).all() and 0 <= goal.gripper <= 1 for goal in both[0])
    for key, part in before.items():
        assert np.array_equal(part.grasp, parts[key].grasp)
        for then, now in zip(part.motions, parts[key].motions, strict=True):
            assert np.array_equal(then.axis, now.axis)
            assert np.array_equal(then.point, now.point)


@given(st.integers(1, 6), directions, seeds)
@fast
def test_as_many_failed_pulls_come_before_the_knob_as_asked_for(trials: int, direction: int, seed: int) -> None:
    safe = KinematicWorld("safe_011", {"locked": True, "direction": direction})
    episode = run(safe, adaptive(safe, seed, trials))
    before_knob = episode.phases[: episode.phases.index(Phase.RELEASE)]
    assert before_knob.count(Phase.TRY) == trials == episode.failed_pulls()
    assert episode.phases.count(Phase.TRY) == trials + 1
    assert episode.opened > 0.95 * PULL_ANGLES[-1]


@pytest.mark.parametrize("trials", [1, 4])
def test_a_door_that_gives_is_pulled_once(trials: int) -> None:
    safe = KinematicWorld("safe_011", UNLOCKED)
    assert run(safe, adaptive(safe, 0, trials)).phases.count(Phase.TRY) == 1


@fast
@given(hiddens, seeds, st.integers(1, 2))
def test_a_grip_that_is_torn_off_is_noticed_and_taken_again(hidden: dict[str, Any], seed: int, torn: int) -> None:
    safe = KinematicWorld("safe_020", hidden, torn=torn)
    episode = run(safe, adaptive(safe, seed))
    first_pull = episode.phases.index(Phase.TRY)
    assert episode.felt[first_pull].outcome is Outcome.REACHED
    assert episode.phases[first_pull + 1] is Phase.RELEASE, "an empty hand that got there has opened nothing"
    assert episode.opened > 0.95 * PULL_ANGLES[-1]


@fast
@given(ids, hiddens, seeds)
def test_a_hand_opens_before_it_leaves_and_moves_on_with_open_fingers(
    name: str, hidden: dict[str, Any], seed: int
) -> None:
    safe = KinematicWorld(name, hidden)
    episode = run(safe, adaptive(safe, seed))
    for before, goal in zip(episode.felt, episode.goals[1:], strict=False):
        if goal.phase in (Phase.RELEASE, Phase.APPROACH):
            assert goal.gripper == 1.0
        if goal.phase is Phase.GRASP or (goal.phase is Phase.RELEASE and before.gripper < 0.5):
            moved = np.linalg.norm(goal.tcp_in_base[:3, 3] - before.tcp_in_base[:3, 3])
            assert moved < 1e-9, "fingers open and close where the hand is"


def test_a_safe_that_nothing_opens_is_given_up() -> None:
    safe = KinematicWorld("safe_003", LOCKED, torn=1000)
    episode = run(safe, adaptive(safe), at_most=1000)
    assert episode.opened == 0.0
