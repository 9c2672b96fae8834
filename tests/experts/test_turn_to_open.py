"""Experts at what is turned and then opened: which way and how far is found out, and a try comes when it may."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import TURNED_TO_OPEN, Episode, KinematicWorld, Move, adaptive, cached_object, object_names, run, static

from lerobot_adamanip.catalog import seen_objects
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.experts import EXPERTS, Feedback, Goal, Phase
from lerobot_adamanip.experts.turn_to_open import TurnToOpen
from lerobot_adamanip.objects import PartAnnotation

fast = settings(max_examples=8, deadline=None)
seeds = st.integers(0, 2**31 - 1)
fractions = st.floats(0.5, 1.0)
directions = st.sampled_from([-1, 1])
every_turned = pytest.mark.parametrize("category", TURNED_TO_OPEN)
SWUNG = ("window", "door")


def upstream_s(category: str) -> TurnToOpen:
    """The sequence of upstream's code, which shares joints and opening with the paper's."""
    return EXPERTS[category].others["upstream"]


STYLES = {category: upstream_s(category) for category in TURNED_TO_OPEN}


def first_object(category: str) -> str:
    return seen_objects(category)[0]


def hidden(name: str, direction: int, fraction: float) -> dict[str, Any]:
    """A hidden state by the share of the object's range that an episode has."""
    key = STYLES[name.rsplit("_", 1)[0]].key
    return {"direction": direction, "turn_range": fraction * cached_object(name).joint(key).limits[1]}


def drawn_world(category: str, data: st.DataObject, direction: int, fraction: float) -> KinematicWorld:
    """Any object of the category, in a hidden state."""
    name = data.draw(object_names(category))
    return KinematicWorld(name, hidden(name, direction, fraction))


def opens(episode: Episode) -> list[tuple[int, Move]]:
    """Tries at the joint that opens: how many moves came before, and the move."""
    return [(i, move) for i, move in enumerate(episode.moves) if move.joint == episode.world.final]


@pytest.mark.parametrize("category", [*TURNED_TO_OPEN, "safe"])
@fast
@given(st.data(), directions, seeds)
def test_a_direction_that_failed_is_not_tried_again(
    category: str, data: st.DataObject, direction: int, seed: int
) -> None:
    drawn = {"direction": direction, **({"locked": True} if category == "safe" else {})}
    world = KinematicWorld(data.draw(object_names(category)), drawn)
    episode = run(world, adaptive(world, seed))
    signs = [sign for sign, _ in episode.turns()]
    wrong = [stalled for sign, stalled in episode.turns() if sign != direction]
    assert wrong in ([], [True])
    assert sum(a != b for a, b in pairwise(signs)) == len(wrong)
    assert signs[-1] == direction


@pytest.mark.parametrize("category", [*TURNED_TO_OPEN, "safe"])
@pytest.mark.parametrize("direction", [-1, 1])
def test_which_direction_comes_first_is_left_to_chance_and_not_to_the_truth(category: str, direction: int) -> None:
    drawn = {"direction": direction, **({"locked": True} if category == "safe" else {})}
    firsts = []
    for seed in range(100):
        world = KinematicWorld(first_object(category), drawn, draw=seed)
        firsts.append(run(world, adaptive(world, seed), until=world.key).turns()[0][0])
    assert np.mean(np.array(firsts) == 1) == pytest.approx(0.5, abs=0.17)


@every_turned
@fast
@given(st.data(), directions, fractions, seeds)
def test_a_blocked_try_is_followed_by_a_turn_and_a_stop_by_a_try_in_one_grip(
    category: str, data: st.DataObject, direction: int, fraction: float, seed: int
) -> None:
    world = drawn_world(category, data, direction, fraction)
    episode = run(world, adaptive(world, seed))
    for move, following in pairwise(episode.moves):
        if move.joint == world.final and move.end == move.start:
            assert move.stalled
            assert following.joint == world.key
        if move.joint == world.key and move.sign == direction and move.stalled:
            assert (following.joint, following.stalled) == (world.final, False)
    assert episode.moves[-1].joint == world.final
    assert episode.failed_pulls() == sum(move.end == move.start for _, move in opens(episode))
    assert episode.phases.count(Phase.GRASP) == 1
    assert all(goal.gripper == 0.0 for goal in episode.goals[2:])


@every_turned
def test_a_lift_comes_first_in_some_episodes_and_a_window_or_door_is_always_turned_first(category: str) -> None:
    first = []
    for seed in range(60):
        world = KinematicWorld(first_object(category), draw=seed)
        first.append(run(world, adaptive(world, seed), until="any").moves[0].joint == world.final)
    assert np.mean(first) == 0.0 if category in SWUNG else 0.25 < np.mean(first) < 0.75


@every_turned
def test_after_a_turn_it_turns_on_or_tries_at_random(category: str) -> None:
    name, tried = first_object(category), []
    for seed in range(30):
        world = KinematicWorld(name, hidden(name, 1, 1.0))
        moves = run(world, adaptive(world, seed)).moves
        followed = [b.joint == world.final for a, b in pairwise(moves) if a.end != a.start and not a.stalled]
        turned = [a.joint == world.key for a, b in pairwise(moves) if a.end != a.start and not a.stalled]
        tried += [hint for hint, turn in zip(followed, turned, strict=True) if turn]
    assert np.mean(tried) == pytest.approx(STYLES[category].p_open, abs=0.2)


@every_turned
@fast
@given(st.data(), st.integers(1, 4), directions, seeds)
def test_a_failed_try_is_repeated_as_often_as_asked_for(
    category: str, data: st.DataObject, trials: int, direction: int, seed: int
) -> None:
    name = data.draw(object_names(category))
    world = KinematicWorld(name, hidden(name, direction, 0.7))
    episode = run(world, adaptive(world, seed, trials))
    runs, length = [], 0
    for move in episode.moves:
        blocked = move.joint == world.final and move.end == move.start
        if length and not blocked:
            runs.append(length)
        length = length + 1 if blocked else 0
    assert set(runs) <= {trials}
    assert max(episode.world.successes)


@every_turned
@fast
@given(st.data(), directions, fractions, seeds)
def test_sight_of_the_hidden_state_turns_just_far_enough_and_meets_no_stall(
    category: str, data: st.DataObject, direction: int, fraction: float, seed: int
) -> None:
    world = drawn_world(category, data, direction, fraction)
    episode = run(world, static(world, seed))
    assert not any(felt.failed for felt in episode.felt)
    assert {sign for sign, _ in episode.turns()} == {direction}
    assert 0.85 <= abs(world.joints[world.key]) / world.hidden["turn_range"] < 1.0
    assert episode.phases.count(Phase.GRASP) == episode.phases.count(Phase.TRY) == 1


@every_turned
@fast
@given(st.data(), directions, fractions, seeds)
def test_upstream_s_expert_neither_tries_first_nor_before_its_angle(
    category: str, data: st.DataObject, direction: int, fraction: float, seed: int
) -> None:
    world = drawn_world(category, data, direction, fraction)
    episode = run(world, adaptive(world, seed, preset="upstream"))
    assert episode.moves[0].joint == world.key
    turned = 0.0
    for move in episode.moves:
        if move.joint == world.key:
            turned = move.end
        else:
            assert abs(turned) > STYLES[category].not_before - 0.01
    assert episode.key_frames <= MAX_KEY_FRAMES


@every_turned
@fast
@given(st.data(), directions, fractions, seeds)
def test_who_turns_to_the_stop_tries_once(
    category: str, data: st.DataObject, direction: int, fraction: float, seed: int
) -> None:
    world = drawn_world(category, data, direction, fraction)
    episode = run(world, adaptive(world, seed, preset="to_stop"))
    assert max(world.successes)
    (first, _), *_ = opens(episode)
    assert {move.joint for move in episode.moves[first:]} == {world.final}
    assert abs(episode.moves[first - 1].end) >= 0.85 * world.hidden["turn_range"]
    assert episode.key_frames <= MAX_KEY_FRAMES
    # One turn the wrong way, and one into the stop, are all that can fail.
    blocked = [move for move in episode.moves[:first] if abs(move.end - move.start) < 0.05]
    assert len(blocked) <= 2


class SlippingGrip(KinematicWorld):
    """A blocked pull leaves the hand 2 cm beside its grasp, so that the expert lets go and the lever springs back."""

    def _move(self, part: PartAnnotation, goal: Goal, opening: float) -> Feedback:
        felt = super()._move(part, goal, opening)
        move = self.moves[-1]
        if move is not None and move.joint == self.final and move.end == move.start:
            axis = next(motion.axis for motion in part.motions if motion.joint == self.final)
            felt = replace(felt, tcp_in_base=transform(0.02 * axis) @ felt.tcp_in_base)
        return felt


@pytest.mark.parametrize("category", SWUNG)
def test_an_angle_at_which_a_pull_was_blocked_is_not_tried_again(category: str) -> None:
    name = first_object(category)
    for seed in range(60):
        world = SlippingGrip(name, hidden(name, 1, 1.0))
        episode = run(world, adaptive(world, seed))
        tried, angle = [], 0.0
        for move in episode.moves:
            if move.joint == world.key:
                angle = abs(move.end)
            elif move.end == move.start:
                tried.append(angle)
        assert all(later > earlier for earlier, later in pairwise(tried))
        assert max(world.successes)
