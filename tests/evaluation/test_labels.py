"""Labels of key frames on every category, without a simulator: what was tried, and whether it failed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import KinematicWorld, Move, adaptive, object_names, static

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import FOLLOWED, Goal, KeyFrameLabels, KeyFrames, Outcome, Phase
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.episode.contact_labels import (
    MIN_JOINT_MOTION,
    JointRange,
    Try,
    TryLabeler,
    meant,
    part_at,
    present_motions,
)

seeds = st.integers(0, 2**31 - 1)
every_category = pytest.mark.parametrize("category", CATEGORIES)
some = settings(max_examples=6, deadline=None)


@dataclass
class Row:
    """One key frame with its label, and what the world knows that happened."""

    goal: Goal
    outcome: Outcome | None
    labels: KeyFrameLabels
    move: Move | None


def labelled(world: KinematicWorld, frames: KeyFrames, at_most: int = 60) -> tuple[list[Row], TryLabeler]:
    """Plays an expert, labelling each key frame as an environment does."""
    labeler = TryLabeler(world.obj, world.mechanism.joints, world.parts, world.feedback, world.joints)
    rows: list[Row] = []
    goal = next(frames, None)
    while goal is not None and len(rows) < at_most:
        feedback = world.step(goal)
        labels = labeler.after_key_frame(goal.tcp_in_base, goal.gripper, feedback, world.joints)
        rows.append(Row(goal, feedback.outcome, labels, world.moves[-1]))
        try:
            goal = frames.send(feedback)
        except StopIteration:
            goal = None
    return rows, labeler


@every_category
@some
@given(st.data(), seeds, seeds, seeds)
def test_what_an_expert_means_to_move_is_a_try_of_that_joint(
    category: str, data: st.DataObject, draw: int, layout: int, seed: int
) -> None:
    world = KinematicWorld(data.draw(object_names(category)), draw=draw, layout=layout)
    rows, _ = labelled(world, adaptive(world, seed))
    assert any(row.labels.tried >= 0 for row in rows)
    for row in rows:
        if row.goal.phase in (Phase.APPROACH, Phase.GRASP, Phase.RELEASE):
            assert row.labels.tried == -1, row
            assert not row.labels.failed
            assert row.labels.progress == 0
        elif row.goal.phase in (Phase.TRY, Phase.UNLOCK):
            assert row.move is not None
            assert world.mechanism.joints[row.labels.tried] == row.move.joint, row
            assert row.labels.progress == pytest.approx(row.move.sign * (row.move.end - row.move.start))


@every_category
@some
@given(st.data(), seeds, seeds, seeds)
def test_a_stall_without_motion_failed_and_trial_counts_up_right_after_it(
    category: str, data: st.DataObject, draw: int, layout: int, seed: int
) -> None:
    world = KinematicWorld(data.draw(object_names(category)), draw=draw, layout=layout)
    rows, _ = labelled(world, adaptive(world, seed))
    failures = 0
    for row in rows:
        assert row.labels.trial == failures
        failures += row.labels.failed
        if row.labels.tried >= 0 and row.outcome is Outcome.STALLED and abs(row.labels.progress) < 1e-3:
            assert row.labels.failed, row
        if row.outcome is Outcome.REACHED and row.move is not None:
            assert not row.labels.failed, row


@every_category
@some
@given(st.data(), seeds, seeds, seeds)
def test_sight_of_the_hidden_state_fails_at_an_end_stop_alone(
    category: str, data: st.DataObject, draw: int, layout: int, seed: int
) -> None:
    world = KinematicWorld(data.draw(object_names(category)), draw=draw, layout=layout)
    rows, labeler = labelled(world, static(world, seed))
    for row in rows:
        if row.labels.failed:  # turned on where it had turned as far as it goes
            assert row.move is not None
            assert row.move.stalled
            assert row.move.sign * row.move.start > 0
    assert labeler.first_part is not None


@pytest.mark.parametrize("category", ["safe", "bottle", "window", "door", "pen"])
def test_a_stall_at_the_end_stop_with_most_of_the_way_covered_is_no_failure(category: str) -> None:
    stops, ran_into = 0, 0
    for seed in range(12):
        world = KinematicWorld(f"{category}_000", {"locked": True} if category == "safe" else None, draw=seed)
        rows, _ = labelled(world, adaptive(world, seed))
        for row in rows:
            if row.goal.phase is Phase.UNLOCK and row.outcome is Outcome.STALLED and row.labels.progress > 1e-3:
                stops += 1
                ran_into += row.labels.failed
    assert stops
    assert ran_into < stops


@pytest.mark.parametrize("category", ["safe", "microwave", "bottle", "door"])
def test_a_grip_torn_off_during_a_pull_failed(category: str) -> None:
    free = {"safe": {"locked": False}, "microwave": {"locked": False}}.get(category)
    world = KinematicWorld(f"{category}_000", free, torn=1)
    rows, _ = labelled(world, static(world))
    torn = [row for row in rows if row.outcome is Outcome.REACHED and row.labels.failed]
    assert len(torn) == 1
    assert torn[0].labels.tried == 0
    assert torn[0].labels.progress == 0


def test_a_button_pushed_with_the_closed_hand_is_a_try_and_backing_off_is_none() -> None:
    world = KinematicWorld("microwave_000", {"locked": True})
    rows, labeler = labelled(world, adaptive(world))
    pushes = [k for k, row in enumerate(rows) if row.labels.tried == 1]
    assert [rows[k].goal.phase for k in pushes] == [Phase.UNLOCK]
    assert not rows[pushes[0]].labels.failed
    assert rows[pushes[0]].labels.progress == pytest.approx(world.obj.joint("button").limits[1])
    assert rows[pushes[0] + 1].goal.gripper < 0.5
    assert rows[pushes[0] + 1].labels.tried == -1
    assert labeler.first_part == "handle"


def test_turning_on_at_the_end_stop_failed_and_closing_what_is_shut_is_no_try() -> None:
    world = KinematicWorld("safe_000", {"locked": True, "direction": 1, "knob_range": 1.0})
    knob, handle = world.parts["knob"], world.parts["handle"]

    def frames(part: str, *positions: float) -> KeyFrames:
        annotation, joint = world.parts[part], {"knob": "knob", "handle": "door"}[part]
        yield Goal(annotation.grasp, 1.0, Phase.APPROACH)
        yield Goal(annotation.grasp, 0.0, Phase.GRASP)
        for position in positions:
            yield Goal(annotation.moved({joint: position}), 0.0, Phase.UNLOCK)
        yield Goal(annotation.grasp, 1.0, Phase.RELEASE)

    rows, _ = labelled(world, frames(knob.name, 0.6, 1.1, 1.5))
    assert [row.labels.failed for row in rows[2:5]] == [False, False, True]
    rows, _ = labelled(world, frames(handle.name, -0.3, 0.2))
    assert [row.labels.tried for row in rows[2:4]] == [-1, 0]


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-2, 2))
def test_the_way_is_cut_to_the_nominal_range_and_failing_means_less_than_half_of_it(
    position: float, sent: float, moved: float
) -> None:
    joint = JointRange("revolute", -1.0, 1.5)
    way = joint.room(position, sent)
    assert abs(way) <= abs(sent) + 1e-12
    assert way * sent >= -1e-12
    tried = Try("knob", "knob", "revolute", sent, way)
    progress = tried.progress(position, position + moved)
    assert tried.failed(progress) == (progress < max(FOLLOWED * abs(way), MIN_JOINT_MOTION["revolute"]))
    assert tried.progress(position, position) == 0


@pytest.mark.parametrize("swung", [0.0, 0.6])
def test_a_joint_is_told_apart_also_where_the_one_before_it_has_turned_its_axis(swung: float) -> None:
    world = KinematicWorld("door_000")
    (part,) = world.parts.values()
    joints = {"leaf": swung, "lever": 0.2}
    start = part.moved(joints)
    assert part_at(start, world.parts, joints) is part
    for joint, change in (("leaf", 0.2), ("lever", -0.3)):
        goal = part.moved({**joints, joint: joints[joint] + change})
        motion = meant(present_motions(part, joints), start, goal)
        assert motion.joint == joint
        assert motion.followed(start, goal) == pytest.approx(change, abs=0.03)
    assert part_at(transform((0, 0, 5)), world.parts, joints) is None


def test_a_label_says_nothing_before_anything_is_tried() -> None:
    world = KinematicWorld("lamp_000")
    labeler = TryLabeler(world.obj, world.mechanism.joints, world.parts, world.feedback, world.joints)
    assert labeler.labels == KeyFrameLabels()
    far = np.eye(4)
    assert labeler.after_key_frame(far, 0.0, world.feedback, world.joints).tried == -1
