"""Safes: distinct and repeatable, held where they say, moving the way they say, and silent about what is hidden."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from solids import box_points, contains, face_planes, fingerprint, link_origin, solid

from lerobot_adamanip.catalog import (
    make_object,
    novel_objects,
    object_id,
    parse_object_id,
    seen_objects,
    unseen_objects,
)
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.objects import ArticulatedObject, PartAnnotation
from lerobot_adamanip.objects.safe import GRASP_REACH, build_safe, draw_design, make_safe

SEEN, UNSEEN = seen_objects("safe"), unseen_objects("safe", 12)
NOVEL = novel_objects("safe", 8)
SAFES = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
every_safe = pytest.mark.parametrize("safe", SAFES.values(), ids=SAFES)
FINGER_LENGTH, HALF_OPENING, FINGER_DEPTH, FINGER_HALF_WIDTH = 0.045, 0.04, 0.014, 0.0105
"""Free length of a finger behind the tool point, opening (8 cm in all), thickness and half width [m]."""


def fingers(grasp: np.ndarray, retreat: float = 0.0) -> np.ndarray:
    """Points filling both open fingers of a hand at a grasp, and all they sweep on the way from ``retreat`` [m]."""
    points = []
    for side in (-1, 1):
        near, far = sorted((side * HALF_OPENING, side * (HALF_OPENING + FINGER_DEPTH)))
        lower, upper = (-FINGER_HALF_WIDTH, near, -FINGER_LENGTH - retreat), (FINGER_HALF_WIDTH, far, 0.01)
        points.append(box_points(lower, upper, 0.005))
    return np.concatenate(points) @ grasp[:3, :3].T + grasp[:3, 3]


def test_all_safes_differ() -> None:
    shapes = {fingerprint(tuple(link.shapes for link in safe.links)) for safe in SAFES.values()}
    assert len(shapes) == len(SAFES)
    sizes = {tuple(np.round(safe.size, 4)) for safe in SAFES.values()}
    assert len(sizes) == len(SAFES), "not in colour alone"


def test_seen_safes_show_what_unseen_ones_can_have() -> None:
    descriptions = ", ".join(SAFES[name].description for name in SEEN)
    for word in ("round bar", "flat bar", "arch", "thumb turn", "octagon", "pointer", "hinge left", "hinge right"):
        assert descriptions.count(word) >= 3


def test_an_id_is_the_same_safe_in_every_process_and_in_any_order() -> None:
    names = ["safe_035", "safe_000", "safe_1234"]
    program = Path(__file__).with_name("solids.py")
    environment = os.environ | {"PYTHONHASHSEED": "4242"}
    output = subprocess.check_output([sys.executable, program, *names], text=True, env=environment, timeout=120)
    np.random.default_rng(5).random(3)
    here = [f"{name} {fingerprint(make_safe(parse_object_id(name)[1]))}" for name in reversed(names)]
    assert output.splitlines() == here[::-1]
    assert [f"{name} {fingerprint(make_object(name))}" for name in names] == here[::-1]


@every_safe
def test_it_is_a_tree_of_named_bodies_that_weigh_something(safe: ArticulatedObject) -> None:
    names = [link.name for link in safe.links]
    assert len(set(names)) == len(names)
    assert (safe.links[0].parent, safe.links[0].joint) == (None, None)
    for i, link in enumerate(safe.links[1:], 1):
        assert link.parent in names[:i]
        assert link.joint is not None
        assert np.linalg.norm(link.joint.axis) == pytest.approx(1.0)
        assert link.joint.limits[0] < link.joint.limits[1]
    assert all(link.mass > 0 and link.shapes for link in safe.links)
    assert {"door", "knob"} == {link.joint.name for link in safe.links if link.joint is not None}


@every_safe
def test_collision_shapes_are_convex_with_faces_outward(safe: ArticulatedObject) -> None:
    for shape in (shape for link in safe.links for shape in link.shapes):
        rotation = shape.pose_in_link[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert all(value > 0 for value in shape.size)
        if shape.kind == "mesh":
            assert shape.vertices is not None
            normals, offsets = face_planes(shape)
            assert np.all(shape.vertices @ normals.T <= offsets + 1e-6)
            assert contains(shape, shape.pose_in_link[None, :3, 3])[0]


@every_safe
def test_its_bounding_box_is_that_of_a_safe_on_the_floor(safe: ArticulatedObject) -> None:
    width, depth, height = safe.size
    around = box_points((-depth - 0.05, -width, 0.0), (-0.001, width, height + 0.05), 0.03)
    inside = around[solid(safe, around, links={"body"})]
    assert np.all(np.abs(inside[:, 1]) <= width / 2 + 1e-6)
    assert inside[:, 0].min() >= -depth - 1e-6
    assert inside[:, 2].max() <= height + 1e-6


@every_safe
@pytest.mark.parametrize("name", ["handle", "knob"])
def test_a_grasp_is_a_right_handed_frame_with_its_approach_into_the_door(safe: ArticulatedObject, name: str) -> None:
    grasp = safe.part(name).grasp
    np.testing.assert_allclose(grasp[:3, :3].T @ grasp[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(grasp[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(grasp[:3, 2], [-1, 0, 0], atol=1e-12)
    assert np.array_equal(grasp[3], [0, 0, 0, 1])


@every_safe
@pytest.mark.parametrize(("name", "link"), [("handle", "leaf"), ("knob", "knob")])
def test_a_grasp_lies_within_its_part_and_open_fingers_clear_everything(
    safe: ArticulatedObject, name: str, link: str
) -> None:
    grasp = safe.part(name).grasp
    assert solid(safe, grasp[None, :3, 3], links={link})[0]
    # Nothing but the part is between the pads: they close on it, with room on both sides.
    line = grasp[:3, 3] + np.linspace(-HALF_OPENING, HALF_OPENING, 161)[:, None] * grasp[:3, 1]
    held = solid(safe, line)
    assert np.array_equal(held, solid(safe, line, links={link}))
    assert 0.012 < 0.0005 * held.sum() < 0.06
    assert not solid(safe, fingers(grasp, retreat=0.1), 0.002).any()


@every_safe
@pytest.mark.parametrize("side", [-1, 1])
def test_a_hand_that_turns_the_knob_touches_nothing_else(safe: ArticulatedObject, side: int) -> None:
    knob = safe.part("knob")
    for fraction in (0.25, 0.5, 0.75, 1.0):
        turned = fingers(knob.moved({"knob": side * fraction * safe.joint("knob").limits[1]}))
        assert not solid(safe, turned, 0.002, links={"body", "leaf"}).any()


@every_safe
def test_handle_and_knob_are_a_hand_apart_and_nothing_sticks_out_into_its_palm(safe: ArticulatedObject) -> None:
    handle, knob = (safe.part(name).grasp[:3, 3] for name in ("handle", "knob"))
    # Open fingers reach 5.4 cm to each side of a grasp, and a part 3.7 cm.
    assert np.linalg.norm(handle - knob) > HALF_OPENING + FINGER_DEPTH + 0.037
    palm = GRASP_REACH + FINGER_LENGTH - 0.005
    front = box_points((palm, -safe.size[0] / 2, 0), (palm, safe.size[0] / 2, safe.size[2]), 0.007)
    assert not solid(safe, front).any()


@every_safe
def test_a_positive_door_angle_moves_the_handle_out_of_the_front(safe: ArticulatedObject) -> None:
    handle = safe.part("handle")
    x = [handle.moved({"door": angle})[0, 3] for angle in np.linspace(0, 1.2, 13)]
    assert np.all(np.diff(x) > 0)
    assert handle.moved({"door": 0.7})[2, 3] == pytest.approx(handle.grasp[2, 3])


@every_safe
@pytest.mark.parametrize(("part", "joint", "link"), [("handle", "door", "leaf"), ("knob", "knob", "knob")])
def test_a_part_is_annotated_with_the_axis_of_its_joint(
    safe: ArticulatedObject, part: str, joint: str, link: str
) -> None:
    motion = safe.part(part).motion(joint)
    assert motion.kind == safe.joint(joint).kind
    np.testing.assert_allclose(motion.axis, safe.joint(joint).axis, atol=1e-12)
    body = next(item for item in safe.links if item.name == link)
    away = motion.point - link_origin(safe, body)
    np.testing.assert_allclose(np.cross(away, motion.axis), 0, atol=1e-12)


def test_hinges_are_on_both_sides_and_handles_away_from_them() -> None:
    sides = set()
    for safe in SAFES.values():
        hinge, handle = safe.part("handle").motion("door").point[1], safe.part("handle").grasp[1, 3]
        assert abs(handle - hinge) > 0.5 * safe.size[0]
        assert safe.joint("door").axis[2] == np.sign(hinge)
        sides.add(np.sign(hinge))
    assert sides == {-1.0, 1.0}


@every_safe
def test_the_knob_and_its_joint_favour_no_direction(safe: ArticulatedObject) -> None:
    lower, upper = safe.joint("knob").limits
    assert lower == -upper
    knob = next(link for link in safe.links if link.name == "knob")
    for shape in knob.shapes:
        reach = 1.037 * (max(shape.size) if shape.size else float(np.abs(shape.vertices).max()))
        center = shape.pose_in_link[:3, 3] * (1, 0, 1)
        points = box_points(center - (reach, 0, reach), center + reach, reach / 8)
        mirrored = points * (1, -1, 1)
        assert contains(shape, points).any()
        assert np.array_equal(contains(shape, points), contains(shape, mirrored)), "decoration included"


def test_the_knob_s_range_is_not_to_be_seen() -> None:
    design = draw_design(np.random.default_rng(7))
    one, other = (build_safe("safe_007", replace(design, knob_range=value)) for value in (1.1, 1.6))
    assert [fingerprint(link.shapes) for link in one.links] == [fingerprint(link.shapes) for link in other.links]
    assert fingerprint(one.parts) == fingerprint(other.parts)


def test_a_missing_part_is_named_with_those_there_are() -> None:
    with pytest.raises(KeyError, match="handle"):
        make_object(object_id("safe", 1)).part("wheel")


def test_an_annotation_in_another_frame_turns_with_it() -> None:
    part = SAFES["safe_004"].part("handle")
    frame = transform((0.6, 0.1, 0.3), rotation_about((0.2, 0.1, 1.0), 2.8))
    moved: PartAnnotation = part.in_frame(frame)
    np.testing.assert_allclose(moved.moved({"door": 0.6}), frame @ part.moved({"door": 0.6}), atol=1e-12)
    np.testing.assert_allclose(part.in_frame(np.eye(4)).grasp, part.grasp)
