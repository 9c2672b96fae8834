"""Lamps: distinct and repeatable, their switch held from every side and clear of all else, silent about what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import box_points, contains, face_planes, fingerprint, link_origin, solid

from lerobot_adamanip.catalog import make_object, novel_objects, parse_object_id, seen_objects, unseen_objects
from lerobot_adamanip.objects import ArticulatedObject, Link
from lerobot_adamanip.objects.lamp import GRIP_DEPTH, build_lamp, draw_design, make_lamp
from lerobot_adamanip.objects.lamp.heads import HEADS

SEEN, UNSEEN = seen_objects("lamp"), unseen_objects("lamp", 25)
NOVEL = novel_objects("lamp", 8)
LAMPS = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
every_lamp = pytest.mark.parametrize("lamp", LAMPS.values(), ids=LAMPS)
HAND_SWEEP, HAND_BEHIND, OFF = 0.106, 0.055, 0.024
"""Radius that the hand's body sweeps when it turns, how far behind the tool point it starts, what its approach may be
off."""
FINGER_TIP, FINGER_SWEEP = 0.010, 0.056
"""How far fingers reach beyond the tool point, and the radius they sweep, open."""


def column(radius: float, low: float, high: float) -> np.ndarray:
    """Points (N, 3) in an upright cylinder about the z axis."""
    points = box_points((-radius, -radius, low), (radius, radius, high), 0.01)
    return points[np.hypot(points[:, 0], points[:, 1]) <= radius]


def filling(link: Link, step: float) -> np.ndarray:
    """Points (N, 3) in the solid shapes of a link, link frame."""
    points = []
    for shape in link.shapes:
        if shape.collides:
            assert shape.vertices is not None
            grid = box_points(shape.vertices.min(axis=0), shape.vertices.max(axis=0), step) + shape.pose_in_link[:3, 3]
            points.append(grid[contains(shape, grid)])
    return np.concatenate(points)


def named(lamp: ArticulatedObject, name: str) -> Link:
    """Returns a link."""
    return next(link for link in lamp.links if link.name == name)


def test_all_lamps_differ_and_the_seen_ones_show_most_kinds() -> None:
    assert len({tuple(np.round(lamp.size, 4)) for lamp in LAMPS.values()}) == len(LAMPS)
    seen = ", ".join(LAMPS[name].description for name in SEEN)
    assert sum(style in seen for style in HEADS) >= len(HEADS) - 2
    for word in ("plate base", "block base", "stadium base", "discs base", "smooth", "knurled", "faceted"):
        assert seen.count(word) >= 2, word


def test_every_kind_of_head_gets_drawn() -> None:
    drawn = {draw_design(np.random.default_rng(seed)).head.style for seed in range(200)}
    assert drawn == set(HEADS)


def test_an_id_is_one_lamp() -> None:
    for name in ("lamp_024", "lamp_000", "lamp_1234"):
        assert fingerprint(make_object(name)) == fingerprint(make_lamp(parse_object_id(name)[1]))


@every_lamp
def test_it_has_the_size_of_a_lamp_for_desk_or_bedside(lamp: ArticulatedObject) -> None:
    width, depth, height = lamp.size
    assert 0.08 < width < 0.60
    assert 0.12 < depth < 0.42
    assert 0.20 < height < 0.48
    around = box_points((-depth - 0.05, -width, 0.0), (0.05, width, height + 0.05), 0.02)
    inside = around[solid(lamp, around, links={"base"})]
    assert np.all(np.abs(inside[:, 1]) <= width / 2 + 1e-6)
    assert inside[:, 0].min() >= -depth - 1e-6
    assert inside[:, 0].max() <= 0.06
    assert inside[:, 2].max() <= height + 1e-6


@every_lamp
def test_shapes_are_convex_with_faces_outward(lamp: ArticulatedObject) -> None:
    for shape in (shape for link in lamp.links for shape in link.shapes):
        rotation = shape.pose_in_link[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert all(value > 0 for value in shape.size)
        if shape.kind == "mesh":
            assert shape.vertices is not None
            assert len(shape.vertices) <= 255 or not shape.collides, "more than a physics engine's convex shape takes"
            normals, offsets = face_planes(shape)
            assert np.all(shape.vertices @ normals.T <= offsets + 1e-6)


@every_lamp
def test_the_switch_is_one_part_on_a_button_under_a_knob(lamp: ArticulatedObject) -> None:
    (knob,) = lamp.parts
    assert [motion.joint for motion in knob.motions] == ["button", "knob"]
    np.testing.assert_allclose(knob.grasp[:3, 2], (0, 0, -1), atol=1e-12)
    lower, upper = lamp.joint("knob").limits
    assert lower == -upper
    assert 1.2 < upper < 1.58
    travel = lamp.joint("button").limits[1]
    assert 0.015 < travel <= 0.03
    assert knob.moved({"button": travel})[2, 3] == pytest.approx(knob.grasp[2, 3] - travel)
    axis = knob.motion("knob").point
    np.testing.assert_allclose(knob.grasp[:2, 3], axis[:2], atol=1e-12)


@every_lamp
def test_fingers_hold_the_switch_alone_from_every_side(lamp: ArticulatedObject) -> None:
    knob = lamp.part("knob")
    for roll in knob.rolls:
        grasp = knob.rolled(roll).grasp
        line = grasp[:3, 3] + np.linspace(-0.04, 0.04, 161)[:, None] * grasp[:3, 1]
        held = solid(lamp, line)
        assert 0.018 < 0.0005 * held.sum() < 0.045
        assert np.array_equal(held, solid(lamp, line, links={"knob"}))


@every_lamp
def test_a_hand_above_the_switch_has_room_to_come_down_and_to_turn(lamp: ArticulatedObject) -> None:
    knob, travel = lamp.part("knob"), lamp.joint("button").limits[1]
    at = knob.grasp[:3, 3]
    body = at + column(HAND_SWEEP + OFF, HAND_BEHIND - travel, 0.45)
    assert not solid(lamp, body).any()
    swept = at + column(FINGER_SWEEP, -FINGER_TIP - travel, HAND_BEHIND)
    assert not solid(lamp, swept, 0.002, links={"base"}).any()


@every_lamp
def test_the_switch_goes_down_without_meeting_the_base_and_is_carried_by_its_spring(lamp: ArticulatedObject) -> None:
    joint, link = lamp.joint("button"), named(lamp, "knob")
    points = filling(link, 0.004) + link_origin(lamp, link)
    for pushed in np.linspace(0, joint.limits[1], 4):
        assert not solid(lamp, points - (0, 0, pushed), 0.001, links={"base"}).any()
    weight = 9.81 * (link.mass + named(lamp, "plunger").mass)
    assert weight < -joint.stiffness * joint.rest < 10


@every_lamp
def test_neither_direction_of_turning_is_favoured(lamp: ArticulatedObject) -> None:
    for shape in named(lamp, "knob").shapes:
        if shape.collides:
            points = box_points((-0.03, -0.03, 0.0), (0.03, 0.03, 0.08), 0.004)
            assert np.array_equal(contains(shape, points), contains(shape, points * (1, -1, 1)))


def test_how_far_the_knob_turns_is_not_to_be_seen() -> None:
    design = draw_design(np.random.default_rng(7))
    one, other = (build_lamp("lamp_007", replace(design, turn_range=value)) for value in (1.3, 1.5))
    assert [fingerprint(link.shapes) for link in one.links] == [fingerprint(link.shapes) for link in other.links]
    assert fingerprint(one.parts) == fingerprint(other.parts)
    assert GRIP_DEPTH > FINGER_TIP
