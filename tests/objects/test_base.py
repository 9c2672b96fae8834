"""Motions and parts: what carries a held part where, what a hand that held on can tell, and in whose frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.rotations import angle_between, rotation_about, rotation_with_x_along, transform
from lerobot_adamanip.objects.base import (
    ON_AXIS,
    Joint,
    JointKind,
    Link,
    Motion,
    PartAnnotation,
    annotate,
    facing,
    from_above,
)

many = settings(max_examples=60, deadline=None)
seeds = st.integers(0, 2**31)
angles = st.floats(-3.1, 3.1)


def random_frame(rng: np.random.Generator) -> NDArray[np.float64]:
    return transform(rng.uniform(-1, 1, 3), Rotation.random(random_state=rng).as_matrix())


def random_motion(rng: np.random.Generator, kind: JointKind = "revolute") -> Motion:
    axis = rng.normal(size=3)
    return Motion("joint", kind, rng.uniform(-1, 1, 3), axis / np.linalg.norm(axis))


def held_at(motion: Motion, distance: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """A grasp that far from the axis, turned anyhow."""
    away = rotation_with_x_along(motion.axis)[:, 1]
    position = motion.point + distance * away + rng.uniform(-0.3, 0.3) * motion.axis
    return transform(position, Rotation.random(random_state=rng).as_matrix())


@many
@given(seeds, angles, st.floats(1.01 * ON_AXIS, 0.8) | st.floats(0.0, 0.99 * ON_AXIS))
def test_a_hand_tells_how_far_it_was_turned_beside_the_axis_and_on_it(seed: int, angle: float, distance: float) -> None:
    rng = np.random.default_rng(seed)
    motion = random_motion(rng)
    before = held_at(motion, distance, rng)
    after = motion.applied(before, angle)
    assert motion.followed(before, after) == pytest.approx(angle, abs=1e-9)
    if distance < ON_AXIS:  # where it stands tells nothing: a slip by a millimetre is no turn
        slipped = transform((0.0, 0.001, 0.0)) @ after
        assert motion.followed(before, slipped) == pytest.approx(angle, abs=1e-9)


@many
@given(seeds, st.floats(-0.6, 0.6), st.floats(-0.4, 0.4))
def test_a_hand_on_the_axis_does_not_take_a_tilt_for_a_turn(seed: int, angle: float, tilt: float) -> None:
    rng = np.random.default_rng(seed)
    motion = random_motion(rng)
    x, y, z = rotation_with_x_along(motion.axis).T  # the approach is along the axis, as at a knob or a cap
    roll = rotation_about((0.0, 0.0, 1.0), rng.uniform(-3, 3))
    before = transform(motion.point, np.stack([y, z, x], axis=-1) @ roll)
    sideways = rotation_about(y, tilt)
    tilted = motion.applied(before, angle)
    tilted[:3, :3] = sideways @ tilted[:3, :3]
    assert motion.followed(before, tilted) == pytest.approx(angle, abs=0.5 * tilt**2 + 1e-9)


@many
@given(seeds, st.floats(-0.5, 0.5), seeds)
def test_a_slide_is_told_by_the_way_along_its_axis_alone(seed: int, distance: float, other: int) -> None:
    rng = np.random.default_rng(seed)
    motion = random_motion(rng, "prismatic")
    before = random_frame(rng)
    after = motion.applied(before, distance)
    np.testing.assert_allclose(after[:3, :3], before[:3, :3])
    np.testing.assert_allclose(after[:3, 3] - before[:3, 3], distance * motion.axis, atol=1e-12)
    assert motion.followed(before, after) == pytest.approx(distance, abs=1e-12)
    elsewhere = replace(motion, point=np.random.default_rng(other).normal(size=3))
    assert elsewhere.followed(before, after) == pytest.approx(distance, abs=1e-12), "a slide has no place"


@many
@given(seeds, angles, angles, st.sampled_from(["revolute", "prismatic"]))
def test_motions_add_up_and_go_back(seed: int, one: float, other: float, kind: JointKind) -> None:
    rng = np.random.default_rng(seed)
    motion, pose = random_motion(rng, kind), random_frame(rng)
    before = pose.copy()
    np.testing.assert_allclose(motion.applied(pose, 0.0), pose, atol=1e-12)
    np.testing.assert_allclose(
        motion.applied(motion.applied(pose, one), other), motion.applied(pose, one + other), atol=1e-9
    )
    assert np.array_equal(pose, before), "what is moved is a copy"


@many
@given(seeds, angles, st.sampled_from(["revolute", "prismatic"]))
def test_it_does_not_matter_in_whose_frame_a_motion_is_said(seed: int, position: float, kind: JointKind) -> None:
    rng = np.random.default_rng(seed)
    motion, pose, frame = random_motion(rng, kind), random_frame(rng), random_frame(rng)
    there = motion.in_frame(frame)
    np.testing.assert_allclose(there.applied(frame @ pose, position), frame @ motion.applied(pose, position), atol=1e-9)
    assert there.followed(frame @ pose, there.applied(frame @ pose, position)) == pytest.approx(
        motion.followed(pose, motion.applied(pose, position)), abs=1e-9
    )


def leaf_and_lever() -> tuple[Link, ...]:
    """A lever on a leaf: the lever's axis is carried along by the leaf."""
    leaf = Joint("leaf", "revolute", (0.0, 0.0, 1.0), (0.0, 0.4, 1.0), (0.0, 1.57))
    lever = Joint("lever", "revolute", (-1.0, 0.0, 0.0), (0.03, -0.7, 0.0), (-1.0, 1.0))
    plate = Joint("", "fixed", origin=(0.01, 0.0, 0.0))
    return (
        Link("frame", (), 1.0),
        Link("leaf", (), 1.0, "frame", leaf),
        Link("plate", (), 1.0, "leaf", plate),
        Link("lever", (), 1.0, "plate", lever),
    )


def lever_part() -> PartAnnotation:
    return annotate(leaf_and_lever(), "lever", "lever", facing((0.08, -0.2, 1.0)))


def test_a_part_is_carried_by_every_joint_that_moves_between_it_and_the_root() -> None:
    part = lever_part()
    assert [motion.joint for motion in part.motions] == ["leaf", "lever"]
    np.testing.assert_allclose(part.motion("leaf").point, (0.0, 0.4, 1.0))
    np.testing.assert_allclose(part.motion("lever").point, (0.04, -0.3, 1.0))
    with pytest.raises(KeyError, match=r"leaf.*lever"):
        part.motion("hinge")


@many
@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_a_part_is_moved_as_its_links_are_root_first(leaf: float, lever: float) -> None:
    """Against the links' own frames, chained from the root: each turns about its origin in its parent."""
    frame, offset = np.eye(4), np.eye(4)
    for link in leaf_and_lever()[1:]:
        joint = link.joint
        assert joint is not None
        turned = transform(joint.origin, rotation_about(joint.axis, {"leaf": leaf, "lever": lever}.get(joint.name, 0)))
        frame, offset = frame @ turned, offset @ transform(joint.origin)
    part = lever_part()
    moved = part.moved({"leaf": leaf, "lever": lever})
    np.testing.assert_allclose(moved, frame @ np.linalg.inv(offset) @ part.grasp, atol=1e-9)
    inner = part.motion("lever").applied(part.grasp, lever)
    np.testing.assert_allclose(moved, part.motion("leaf").applied(inner, leaf), atol=1e-9)


@many
@given(seeds, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_a_part_in_another_frame_is_moved_there(seed: int, leaf: float, lever: float) -> None:
    part, frame = lever_part(), random_frame(np.random.default_rng(seed))
    positions = {"leaf": leaf, "lever": lever}
    np.testing.assert_allclose(part.in_frame(frame).moved(positions), frame @ part.moved(positions), atol=1e-9)


@many
@given(angles)
def test_a_roll_turns_the_fingers_about_the_approach_and_nothing_else(angle: float) -> None:
    part = lever_part()
    rolled = part.rolled(angle)
    np.testing.assert_allclose(rolled.grasp[:3, 2:], part.grasp[:3, 2:], atol=1e-12)
    assert angle_between(part.grasp[:3, :3], rolled.grasp[:3, :3]) == pytest.approx(abs(angle), abs=1e-6)
    assert rolled.motions is part.motions


@many
@given(angles)
def test_grasps_approach_as_they_are_called_with_fingers_across(roll: float) -> None:
    for grasp, approach in (
        (facing((0.1, 0.2, 0.3), roll), (-1, 0, 0)),
        (from_above((0.1, 0.2, 0.3), roll), (0, 0, -1)),
    ):
        np.testing.assert_allclose(grasp[:3, 2], approach, atol=1e-12)
        np.testing.assert_allclose(grasp[:3, 3], (0.1, 0.2, 0.3))
        np.testing.assert_allclose(grasp[:3, :3].T @ grasp[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(grasp[:3, :3]) == pytest.approx(1.0)
        # Without a roll the fingers close along the object's y.
        assert abs(grasp[1, 1]) == pytest.approx(abs(np.cos(roll)), abs=1e-12)
