"""Experts at a microwave: pull, push the button with the closed hand if that is blocked, pull again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import KinematicWorld, adaptive, object_names, run, static

from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.experts import Outcome, Phase
from lerobot_adamanip.experts.doors import PULL_ANGLES

fast = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 2**31 - 1)
names = object_names("microwave")


@fast
@given(names, st.booleans(), seeds, seeds)
def test_it_opens_locked_and_unlocked_ones(name: str, locked: bool, seed: int, layout: int) -> None:
    world = KinematicWorld(name, {"locked": locked}, layout=layout)
    episode = run(world, adaptive(world, seed))
    assert episode.opened > 0.95 * PULL_ANGLES[-1]
    assert episode.key_frames <= MAX_KEY_FRAMES
    assert episode.failed_pulls() == locked


@fast
@given(names, st.booleans(), seeds)
def test_it_pulls_first_and_leaves_the_button_of_an_open_one_alone(name: str, locked: bool, seed: int) -> None:
    world = KinematicWorld(name, {"locked": locked})
    episode = run(world, adaptive(world, seed))
    assert episode.phases[:4] == [Phase.APPROACH, Phase.APPROACH, Phase.GRASP, Phase.TRY]
    assert [move.joint for move in episode.moves].count("button") == locked == (Phase.UNLOCK in episode.phases)


@fast
@given(names, seeds)
def test_the_button_is_pushed_with_a_closed_hand_until_it_stops(name: str, seed: int) -> None:
    world = KinematicWorld(name, {"locked": True})
    episode = run(world, adaptive(world, seed))
    push = episode.phases.index(Phase.UNLOCK)
    move = world.moves[push]
    assert move is not None
    assert (move.joint, move.stalled) == ("button", True)
    assert move.end == world.obj.joint("button").limits[1]
    assert [goal.gripper for goal in episode.goals[push - 2 : push + 2]] == [0.0] * 4
    assert episode.phases[push - 4 : push + 2] == [
        Phase.RELEASE,
        Phase.RELEASE,
        Phase.APPROACH,
        Phase.APPROACH,
        Phase.UNLOCK,
        Phase.RELEASE,
    ]
    assert world.joints["button"] == 0.0, "it comes back"
    # Its fingers are shut while they push, and it backs off before it goes anywhere else.
    away = np.linalg.norm(episode.felt[push + 1].tcp_in_base[:3, 3] - episode.felt[push].tcp_in_base[:3, 3])
    assert away == pytest.approx(0.1)


@fast
@given(names, st.integers(1, 5), seeds)
def test_as_many_failed_pulls_come_before_the_button_as_asked_for(name: str, trials: int, seed: int) -> None:
    world = KinematicWorld(name, {"locked": True})
    episode = run(world, adaptive(world, seed, trials))
    before_button = episode.phases[: episode.phases.index(Phase.RELEASE)]
    assert before_button.count(Phase.TRY) == trials == episode.failed_pulls()
    assert episode.phases.count(Phase.TRY) == trials + 1
    assert episode.opened > 0.95 * PULL_ANGLES[-1]


@fast
@given(names, st.booleans(), st.integers(1, 2), seeds)
def test_a_grip_that_is_torn_off_is_noticed_and_taken_again(name: str, locked: bool, torn: int, seed: int) -> None:
    world = KinematicWorld(name, {"locked": locked}, torn=torn)
    episode = run(world, adaptive(world, seed))
    first_pull = episode.phases.index(Phase.TRY)
    assert episode.felt[first_pull].outcome is Outcome.REACHED
    assert episode.phases[first_pull + 1] is Phase.RELEASE, "an empty hand that got there has opened nothing"
    assert episode.opened > 0.95 * PULL_ANGLES[-1]


def test_one_that_nothing_opens_is_given_up() -> None:
    world = KinematicWorld("microwave_003", {"locked": True}, torn=1000)
    assert run(world, adaptive(world), at_most=1000).opened == 0.0


@fast
@given(names, st.booleans(), seeds)
def test_sight_of_the_lock_goes_straight_there(name: str, locked: bool, seed: int) -> None:
    world = KinematicWorld(name, {"locked": locked}, layout=seed)
    episode = run(world, static(world, seed))
    assert episode.opened > 0.95 * PULL_ANGLES[-1]
    assert episode.failed_pulls() == 0
    assert [move.joint for move in episode.moves].count("button") == locked
    assert len(episode.goals) == 7 + 4 * locked
