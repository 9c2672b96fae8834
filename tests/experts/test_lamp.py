"""Experts at a lamp whose switch is a button or a knob: never again what has failed, and only what yields goes on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import Episode, KinematicWorld, adaptive, object_names, run, static

from lerobot_adamanip.experts import Phase
from lerobot_adamanip.experts.lamp import MOTIONS

fast = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 2**31 - 1)
names, modes = object_names("lamp"), st.sampled_from([0, 1, 2])


def kinds(episode: Episode) -> list[tuple[str, int]]:
    """Each move: which joint, and which way."""
    return [(move.joint, move.sign) for move in episode.moves]


@fast
@given(names, modes, seeds)
def test_what_has_failed_is_not_tried_again(name: str, mode: int, seed: int) -> None:
    world = KinematicWorld(name, {"mode": mode})
    episode = run(world, adaptive(world, seed))
    failed = [kind for kind, move in zip(kinds(episode), episode.moves, strict=True) if move.end == move.start]
    assert len(set(failed)) == len(failed) <= 2
    assert MOTIONS[mode] not in failed
    # Once something has yielded it is gone on with, and nothing else.
    assert set(kinds(episode)[len(failed) :]) == {MOTIONS[mode]}
    assert episode.phases[:3] == [Phase.APPROACH, Phase.APPROACH, Phase.GRASP]
    assert all(goal.gripper == 0.0 for goal in episode.goals[2:]), "the hand holds on all the time"


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_what_comes_first_is_left_to_chance_and_not_to_the_truth(mode: int) -> None:
    firsts = []
    for seed in range(150):
        world = KinematicWorld("lamp_000", {"mode": mode})
        firsts.append(kinds(run(world, adaptive(world, seed), until="any"))[0])
    for motion in MOTIONS:
        assert firsts.count(motion) / 150 == pytest.approx(1 / 3, abs=0.13)


def test_all_orders_are_tried() -> None:
    orders = set()
    for seed in range(60):
        world = KinematicWorld("lamp_001", {"mode": seed % 3})
        orders.add(tuple(dict.fromkeys(kinds(run(world, adaptive(world, seed))))))
    assert {len(order) for order in orders} == {1, 2, 3}
    assert len([order for order in orders if len(order) == 3]) == 6


@fast
@given(names, modes, st.integers(1, 4), seeds)
def test_a_failed_motion_is_repeated_as_often_as_asked_for(name: str, mode: int, trials: int, seed: int) -> None:
    world = KinematicWorld(name, {"mode": mode})
    episode = run(world, adaptive(world, seed, trials))
    failed = [kind for kind, move in zip(kinds(episode), episode.moves, strict=True) if move.end == move.start]
    assert all(failed.count(kind) == trials for kind in failed)
    assert failed == sorted(failed, key=failed.index), "one after the other, not in turns"
    assert max(world.successes)


@fast
@given(names, modes, seeds)
def test_sight_of_the_mode_makes_that_motion_alone(name: str, mode: int, seed: int) -> None:
    world = KinematicWorld(name, {"mode": mode}, layout=seed)
    episode = run(world, static(world, seed))
    assert set(kinds(episode)) == {MOTIONS[mode]}
    assert not any(move.stalled for move in episode.moves[:-1]), "none before it is on"
    assert episode.key_frames < np.inf
