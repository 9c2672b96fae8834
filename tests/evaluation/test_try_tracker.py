"""Tries, followed tick by tick on joints that are a few numbers: no simulator."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.contract.keyframes import KeyFrameLabels
from lerobot_adamanip.episode.tries import (
    MIN_JOINT_MOTION,
    OPENING_TICKS,
    REST_TICKS,
    KeyFrameLabeler,
    Push,
    TryTracker,
)

STEP = 0.02
"""Motion of a joint or of the hand in one tick [rad]."""


class World:
    """A door and a knob, and an arm that does one thing for some ticks."""

    def __init__(self) -> None:
        self.positions = {"door": 0.0, "knob": 0.0}
        self.tracker = TryTracker({"door": "revolute", "knob": "revolute"}, dict(self.positions))

    def tick(self, count: int, joint: str = "", push: Push | None = None, motion: float = 0.0) -> None:
        for _ in range(count):
            if joint:
                self.positions[joint] += motion
            self.tracker.update({joint: push} if push is not None else {}, self.positions)

    def blocked(self, joint: str, way: int = 1, ticks: int = 6) -> None:
        self.tick(ticks, joint, Push(way * STEP, way, True))

    def moves(self, joint: str, way: int = 1, ticks: int = 6) -> None:
        self.tick(ticks, joint, Push(way * STEP, 0, False), way * STEP)

    def rests(self, joint: str, ticks: int = 3 * REST_TICKS) -> None:
        self.tick(ticks, joint, Push())

    @property
    def tries(self) -> list[tuple[int, int, bool]]:
        return [(each.joint, each.direction, each.failed) for each in self.tracker.tries]


@pytest.fixture
def world() -> World:
    return World()


def test_a_blocked_push_is_a_failed_try_and_a_second_one_is_another(world: World) -> None:
    world.blocked("door")
    world.rests("door")
    world.blocked("door")
    assert world.tries == [(0, 1, True)] * 2


def test_a_failed_try_that_has_ended_stays_counted_during_an_equal_one(world: World) -> None:
    world.blocked("door")
    world.rests("door")
    counts = []
    for _ in range(6):
        world.blocked("door", ticks=1)
        counts.append(len(world.tracker.sequence(ended=True)))
    assert counts == [1] * 6


def test_a_stretch_of_pushing_that_flickers_is_one_try(world: World) -> None:
    for _ in range(4):
        world.blocked("door", ticks=3)
        world.tick(REST_TICKS)
    assert world.tries == [(0, 1, True)]


def test_a_turn_in_several_steps_to_the_stop_is_one_try_that_succeeded(world: World) -> None:
    for _ in range(3):
        world.moves("knob")
        world.rests("knob")
    world.blocked("knob")
    assert world.tries == [(1, 1, False)]
    world.rests("knob")
    world.tick(3 * REST_TICKS)  # the hand lets go
    world.blocked("knob")
    assert world.tries == [(1, 1, False), (1, 1, True)], "at the stop nothing moves any more"


def test_turning_back_is_another_try(world: World) -> None:
    world.moves("knob")
    world.moves("knob", -1)
    assert world.tries == [(1, 1, False), (1, -1, False)]


def test_a_joint_that_another_try_interrupts_is_tried_anew(world: World) -> None:
    world.moves("knob")
    world.blocked("door", ticks=3 * REST_TICKS)
    world.moves("knob")
    assert world.tries == [(1, 1, False), (0, 1, True), (1, 1, False)]


def test_a_part_that_moves_by_itself_is_not_tried(world: World) -> None:
    """A lever springs back within open fingers, which stand still."""
    world.moves("knob")
    world.tick(3 * REST_TICKS)
    world.tick(6, "knob", Push(0.0, 0, False), -STEP)
    assert world.tries == [(1, 1, False)]


def test_a_graze_is_no_try(world: World) -> None:
    world.tick(50, "door", Push(STEP, 1, False))
    world.tick(50, "knob", Push(0.0), MIN_JOINT_MOTION["revolute"] / 100)
    assert world.tries == []


def test_joints_are_held_until_a_try_and_again_when_they_stand(world: World) -> None:
    assert world.tracker.at_rest() == {"door", "knob"}
    world.rests("door")
    assert world.tracker.at_rest() == {"door", "knob"}, "a touch releases nothing"
    world.blocked("door", ticks=1)
    assert world.tracker.at_rest() == {"knob"}
    world.rests("door")
    assert world.tracker.at_rest() == {"door", "knob"}, "after a failed try it is held: a graze would tell"
    world.moves("knob")
    assert world.tracker.at_rest() == {"door"}
    world.tick(3 * REST_TICKS)
    assert world.tracker.at_rest() == {"door", "knob"}


kinds, joints = st.sampled_from(["blocked", "moves", "rests", "free"]), st.sampled_from(["door", "knob"])
actions = st.lists(st.tuples(kinds, joints, st.sampled_from([1, -1]), st.integers(1, 12)), max_size=12)


@given(actions)
def test_no_joint_moves_or_is_released_without_a_try(what: list[tuple[str, str, int, int]]) -> None:
    """Whatever the arm does: motion in contact, and release, have a try of that joint; failed means not moved."""
    world = World()
    for kind, joint, way, ticks in what:
        before = dict(world.positions)
        if kind == "free":
            world.tick(ticks)
        elif kind == "rests":
            world.rests(joint, ticks)
        else:
            getattr(world, kind)(joint, way, ticks)
        tried = {number for number, _, _ in world.tries}
        for number, name in enumerate(world.positions):
            if abs(world.positions[name] - before[name]) > 2 * STEP or name not in world.tracker.at_rest():
                assert number in tried or abs(world.positions[name] - before[name]) < MIN_JOINT_MOTION["revolute"]
    for made in world.tracker.tries:
        assert made.failed == (made.moved < MIN_JOINT_MOTION["revolute"])
        assert made.ticks > 0


def test_key_frames_have_the_labels_of_their_longest_try(world: World) -> None:
    labeler = KeyFrameLabeler(world.tracker)
    assert labeler.labels == KeyFrameLabels()
    world.rests("door")
    assert labeler.after_key_frame(world.positions) == KeyFrameLabels()
    world.blocked("door", ticks=8)
    assert labeler.after_key_frame(world.positions) == KeyFrameLabels(0, failed=True, direction=1, number=0)
    world.rests("door")
    assert labeler.after_key_frame(world.positions) == KeyFrameLabels(trial=1)
    for _ in range(2):
        world.moves("knob", -1, ticks=10)
        labels = labeler.after_key_frame(world.positions)
        assert (labels.tried, labels.failed, labels.direction, labels.trial) == (1, False, -1, 1)
        assert labels.progress == pytest.approx(10 * STEP)
    assert len(world.tracker.tries) == 2


def test_a_push_that_ends_as_the_fingers_open_is_not_of_that_key_frame(world: World) -> None:
    labeler = KeyFrameLabeler(world.tracker)
    world.moves("knob", ticks=10)
    labeler.after_key_frame(world.positions)
    world.tick(OPENING_TICKS, "knob", Push(0.0, 1, True))
    assert labeler.after_key_frame(world.positions, opens=True).tried == -1
    world.moves("knob", ticks=OPENING_TICKS + 1)
    assert labeler.after_key_frame(world.positions, opens=True).tried == 1
