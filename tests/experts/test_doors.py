"""Experts at safes and microwaves: pull, unlock if that is blocked, pull again; straight there if they see the lock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import KinematicWorld, adaptive, as_bytes, object_names, run, static

from lerobot_adamanip.experts import Feedback, Outcome, Phase
from lerobot_adamanip.experts.turn_to_open import SWING

fast = settings(max_examples=12, deadline=None)
seeds = st.integers(0, 2**31 - 1)
directions = st.sampled_from([-1, 1])
every_door = pytest.mark.parametrize("category", ["safe", "microwave"])
OPEN = 0.95 * SWING[-1]


def hidden(category: str, locked: bool, direction: int = 1) -> dict[str, Any]:
    return {"locked": locked, **({"direction": direction} if category == "safe" else {})}


@every_door
@fast
@given(st.data(), st.booleans(), directions, seeds)
def test_it_pulls_first_and_unlocks_only_what_is_locked(
    category: str, data: st.DataObject, locked: bool, direction: int, seed: int
) -> None:
    world = KinematicWorld(data.draw(object_names(category)), hidden(category, locked, direction), layout=seed)
    episode = run(world, adaptive(world, seed))
    assert episode.opened > OPEN
    assert episode.failed_pulls() == locked == (Phase.UNLOCK in episode.phases)
    assert episode.phases[:4] == [Phase.APPROACH, Phase.APPROACH, Phase.GRASP, Phase.TRY]
    assert episode.phases[-1] is Phase.OPEN


@every_door
@fast
@given(st.data(), st.booleans(), directions, st.tuples(seeds, seeds))
def test_sight_of_the_lock_goes_straight_there_and_leaves_the_approach_alone_to_chance(
    category: str, data: st.DataObject, locked: bool, direction: int, both: tuple[int, int]
) -> None:
    name, draw = data.draw(object_names(category)), hidden(category, locked, direction)
    kept = []
    for each in both:
        world = KinematicWorld(name, draw)
        episode = run(world, static(world, each))
        assert episode.opened > OPEN
        assert episode.failed_pulls() == 0
        assert {move.joint for move in episode.moves} == ({world.final, world.key} if locked else {world.final})
        if category == "safe":
            assert {sign for sign, _ in episode.turns()} == ({direction} if locked else set())
        kept.append(as_bytes([goal for goal in episode.goals if goal.phase is not Phase.APPROACH]))
    assert kept[0] == kept[1]


@every_door
@fast
@given(st.integers(1, 6), seeds)
def test_as_many_failed_pulls_come_before_the_key_as_asked_for(category: str, trials: int, seed: int) -> None:
    world = KinematicWorld(f"{category}_011", hidden(category, True))
    episode = run(world, adaptive(world, seed, trials))
    before_key = episode.phases[: episode.phases.index(Phase.RELEASE)]
    assert before_key.count(Phase.TRY) == trials == episode.failed_pulls()
    assert episode.phases.count(Phase.TRY) == trials + 1
    assert episode.opened > OPEN
    unlocked = KinematicWorld(f"{category}_011", hidden(category, False))
    assert run(unlocked, adaptive(unlocked, seed, trials)).phases.count(Phase.TRY) == 1, "what gives is pulled once"


@fast
@given(object_names("microwave"), seeds)
def test_a_button_is_pushed_with_a_closed_hand_until_it_stops(name: str, seed: int) -> None:
    world = KinematicWorld(name, {"locked": True})
    episode = run(world, adaptive(world, seed))
    push = episode.phases.index(Phase.UNLOCK)
    move = world.moves[push]
    assert move is not None
    assert (move.joint, move.stalled, move.end) == ("button", True, world.obj.joint("button").limits[1])
    assert [goal.gripper for goal in episode.goals[push - 2 : push + 2]] == [0.0] * 4
    away = np.linalg.norm(episode.felt[push + 1].tcp_in_base[:3, 3] - episode.felt[push].tcp_in_base[:3, 3])
    assert away == pytest.approx(0.1), "it backs off before it goes anywhere else"


@pytest.mark.parametrize("outcome", [None, *Outcome])
def test_only_arriving_and_not_having_gone_are_no_failure(outcome: Outcome | None) -> None:
    assert Feedback(np.eye(4), 1.0, outcome).failed == (outcome not in (None, Outcome.REACHED))
