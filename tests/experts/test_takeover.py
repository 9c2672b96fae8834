"""An expert takes over from any state: it believes what has been felt, goes on with what is held, and opens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import KinematicWorld, Watched, adaptive, object_names, run

from lerobot_adamanip.catalog import seen_objects
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import KeyFrameLabels
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.experts import Belief, Feedback, Goal, Phase
from lerobot_adamanip.experts.belief import FeltTry

seeds = st.integers(0, 2**31 - 1)
fast = settings(max_examples=10, deadline=None)
every = pytest.mark.parametrize("category", CATEGORIES)
TURNED = tuple(name for name in CATEGORIES if name not in ("microwave", "lamp"))


def driven(category: str, name: str, seed: int, steps: int) -> Watched:
    """Some key frames of an expert with a draw of its own, and now and then of nobody's."""
    watched, rng = Watched(KinematicWorld(name, draw=seed)), np.random.default_rng(seed)
    frames = adaptive(watched.world, seed + 1)
    goal = next(frames, None)
    for _ in range(steps):
        if goal is None:
            break
        if rng.random() < 0.15:
            watched.step(Goal(watched.world.feedback.tcp_in_base, float(rng.integers(2)), Phase.RELEASE))
            break
        feedback = watched.step(goal)
        try:
            goal = frames.send(feedback)
        except StopIteration:
            break
    return watched


@every
@fast
@given(st.data(), seeds, st.integers(0, 12))
def test_whatever_was_done_before_it_opens(category: str, data: st.DataObject, seed: int, steps: int) -> None:
    watched = driven(category, data.draw(object_names(category)), seed, steps)
    if any(watched.world.successes):
        return
    run(watched.world, watched.taken_over(seed), at_most=120)
    assert any(watched.world.successes)


@every
@fast
@given(st.data(), seeds, st.integers(0, 12))
def test_asked_anew_at_each_key_frame_it_opens(category: str, data: st.DataObject, seed: int, steps: int) -> None:
    """As corrections ask: each label leads on, none is given for ever to a state that it does not change."""
    watched = driven(category, data.draw(object_names(category)), seed, steps)
    watched.asked_anew(seed, at_most=80)


@every
@fast
@given(seeds, st.integers(3, 14))
def test_what_the_hand_holds_is_gone_on_with(category: str, seed: int, steps: int) -> None:
    """Labels of every state a policy gets into: the expert's own way from there, not a way round."""
    name = seen_objects(category)[0]
    watched = Watched(KinematicWorld(name, draw=seed))
    frames = adaptive(watched.world, seed)
    goal = next(frames)
    for _ in range(steps):
        feedback = watched.step(goal)
        try:
            goal = frames.send(feedback)
        except StopIteration:
            return
    other = next(watched.taken_over(seed + 1), None)
    if goal.phase in (Phase.GRASP, Phase.TRY, Phase.UNLOCK, Phase.OPEN):
        assert other is not None
        assert other.phase is not Phase.RELEASE, (goal.phase, other.phase)
        if goal.phase is Phase.GRASP:
            assert (other.phase, other.gripper) == (goal.phase, goal.gripper)
            np.testing.assert_allclose(other.tcp_in_base, goal.tcp_in_base, atol=1e-6)


@every
@fast
@given(st.data(), seeds)
def test_it_takes_over_its_own_episode_as_it_would_have_gone_on(category: str, data: st.DataObject, seed: int) -> None:
    """Corrections and demonstrations are one training set: in one state they must not teach two things."""
    watched = Watched(KinematicWorld(data.draw(object_names(category)), draw=seed))
    frames = adaptive(watched.world, seed, strategy="to_stop")
    goal = next(frames)
    while not any(watched.world.successes):
        feedback = watched.step(goal)
        try:
            goal = frames.send(feedback)
        except StopIteration:
            return
        other = next(watched.taken_over(seed + 1, strategy="to_stop"), None)
        assert other is not None or any(watched.world.successes)
        if other is not None:
            assert other.gripper == goal.gripper
            assert other.phase is goal.phase or {other.phase, goal.phase} == {Phase.TRY, Phase.OPEN}


@pytest.mark.parametrize(
    ("mode", "order"),
    [(2, (0, 1)), (0, (1, 2)), (1, (2, 0)), (0, (1,)), (2, (1,)), (1, (0,)), (2, (0,)), (0, (2,)), (1, (2,))],
)
def test_a_motion_of_a_lamp_that_failed_for_another_is_not_tried_again(mode: int, order: tuple[int, ...]) -> None:
    joints = ("button", "knob")
    at_rest = dict.fromkeys(joints, 0.0)
    motions = (("button", 1), ("knob", 1), ("knob", -1))
    tries = tuple(FeltTry(*motions[each], at_rest, at_rest, True) for each in order)
    for seed in range(6):
        world = KinematicWorld("lamp_000", {"mode": mode})
        episode = run(world, adaptive(world, seed, belief=Belief(tries)))
        tried = [(move.joint, move.sign) for move in episode.moves]
        assert not {motions[each] for each in order} & set(tried)
        assert max(world.successes)


def blocked(world: KinematicWorld, joint: str, sign: int) -> FeltTry:
    return FeltTry(joint, sign, dict(world.joints), dict(world.joints), True)


@pytest.mark.parametrize("category", TURNED)
@pytest.mark.parametrize("way", [-1, 1])
def test_a_direction_that_is_blocked_is_not_tried_again(category: str, way: int) -> None:
    for seed in range(6):
        world = KinematicWorld(
            seen_objects(category)[0], {"direction": way, **({"locked": True} if category == "safe" else {})}
        )
        belief = Belief((blocked(world, world.key, -way),))
        episode = run(world, adaptive(world, seed, belief=belief))
        assert {sign for sign, _ in episode.turns()} == {way}
        assert max(world.successes)


@pytest.mark.parametrize("category", ["safe", "microwave"])
def test_a_door_that_was_pulled_in_vain_is_unlocked_first(category: str) -> None:
    for seed in range(6):
        name = seen_objects(category)[0]
        world = KinematicWorld(name, {"locked": True})
        episode = run(world, adaptive(world, seed, belief=Belief((blocked(world, world.final, 1),))))
        assert episode.failed_pulls() == 0
        assert max(world.successes)
        # With nothing believed it pulls first: the law above would hold of an expert that never pulls.
        assert run(KinematicWorld(name, {"locked": True}), adaptive(world, seed)).failed_pulls() == 1


@pytest.mark.parametrize("category", ["bottle", "pen", "pressure_cooker", "coffee_maker"])
def test_a_lid_is_not_lifted_again_where_it_was_lifted_in_vain(category: str) -> None:
    lifted = []
    for seed in range(12):
        world = KinematicWorld(seen_objects(category)[0], draw=seed)
        episode = run(world, adaptive(world, seed, belief=Belief((blocked(world, world.final, 1),))))
        lifted.append(episode.moves[0].joint)
        assert max(world.successes)
    assert set(lifted) == {world.key}


def test_beliefs_of_tries() -> None:
    rest, turned = {"door": 0.0, "knob": 0.0}, {"door": 0.0, "knob": 0.6}
    one = FeltTry("door", 1, rest, rest, True)
    wrong, right = FeltTry("knob", -1, rest, rest, True), FeltTry("knob", 1, rest, turned, False)
    stop = FeltTry("knob", 1, turned, turned, True)
    assert not Belief().blocked("door")
    assert Belief((one,)).blocked("door", until="knob")
    assert Belief((one, wrong)).blocked("door", until="knob")
    assert not Belief((one, wrong, right)).blocked("door", until="knob")
    assert [Belief(tries).way("knob", 0.1) for tries in ((), (wrong,), (right,))] == [0, 1, 1]
    assert Belief((wrong,)).blocked_ways("knob", 0.1) == {-1}
    assert Belief((right, stop)).blocked_ways("knob", 0.1) == set()
    # A way that the joint has gone is not blocked by an earlier failure there.
    both = Belief((FeltTry("knob", 1, rest, rest, True), right))
    assert (both.blocked_ways("knob", 0.1), both.way("knob", 0.1)) == (set(), 1)
    assert Belief((right, stop)).stopped("knob", 0.1)
    assert not Belief((right,)).stopped("knob", 0.1)
    assert Belief((replace(right, stalled=True),)).stopped("knob", 0.1), "it followed, but not all the way"
    assert not Belief((replace(wrong, stalled=True),)).stopped("knob", 0.1)
    assert Belief((one,)).blocked_at("door", "knob") == 0.0
    assert Belief((right,)).blocked_at("door", "knob") == -1.0
    # Both ways blocked: a grip that slipped, so no way is known; or a lamp that is pushed.
    other = FeltTry("knob", 1, rest, rest, True)
    assert Belief((wrong, other)).blocked_ways("knob", 0.1) == {-1, 1}
    assert Belief((wrong, other)).way("knob", 0.1) == 0
    labels = KeyFrameLabels(tried=1, failed=True, progress=0.0, trial=0, direction=-1)
    assert Belief().after(labels, ("door", "knob"), rest, rest, stalled=False) == Belief((wrong,))
    assert Belief().after(KeyFrameLabels(), ("door", "knob"), rest, rest, stalled=False) == Belief()


def test_a_hand_beside_a_grasp_goes_straight_there() -> None:
    world = KinematicWorld("door_000")
    part = world.parts["lever"]
    at = part.grasp @ transform((0.01, -0.02, -0.08))
    goals = run(world, adaptive(world, feedback=Feedback(at, 1.0))).goals
    np.testing.assert_allclose(goals[0].tcp_in_base, part.grasp)
    there = adaptive(world, feedback=Feedback(part.grasp.copy(), 1.0))
    assert next(there).phase is Phase.GRASP
    beside = part.grasp @ transform((0.02, 0.0, 0.0))
    assert next(adaptive(world, feedback=Feedback(beside, 1.0))).phase is Phase.APPROACH
