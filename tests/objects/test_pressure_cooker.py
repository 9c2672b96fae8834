"""Pressure cookers: distinct and repeatable, held by the lid's handle, free to turn and lift, silent about the rest."""

from __future__ import annotations

import numpy as np
import pytest
from solids import box_points, contains, face_planes, fingerprint, link_origin, solid

from lerobot_adamanip.catalog import make_object, novel_objects, parse_object_id, seen_objects, unseen_objects
from lerobot_adamanip.contract.rotations import rotation_about
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.objects.pressure_cooker import LID_RANGE, LIFT_UPPER, make_pressure_cooker

SEEN, UNSEEN = seen_objects("pressure_cooker"), unseen_objects("pressure_cooker", 4)
NOVEL = novel_objects("pressure_cooker", 8)
COOKERS = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
every_cooker = pytest.mark.parametrize("cooker", COOKERS.values(), ids=COOKERS)
TURNS = LID_RANGE * np.linspace(-1, 1, 5)
FINGER_LENGTH, HALF_OPENING, FINGER_DEPTH, FINGER_HALF_WIDTH = 0.045, 0.04, 0.014, 0.0105
"""Free length of a finger behind the tool point, opening (8 cm in all), thickness and half width [m]."""
PALM_DISTANCE, PALM_HALF_WIDTH, PALM_HALF_DEPTH = 0.055, 0.102, 0.033
"""Of the hand's body: behind the tool point, along the fingers' closing direction, and across it [m]."""


def fingers(grasp: np.ndarray, opening: float = HALF_OPENING, tip: float = 0.009) -> np.ndarray:
    """Points (N, 3) filling both fingers of a hand at a grasp, each ``opening`` [m] from the middle."""
    parts = []
    for side in (-1, 1):
        near, far = sorted((side * opening, side * (opening + FINGER_DEPTH)))
        lower, upper = (-FINGER_HALF_WIDTH, near, -FINGER_LENGTH), (FINGER_HALF_WIDTH, far, tip)
        parts.append(box_points(lower, upper, 0.006))
    return np.concatenate(parts) @ grasp[:3, :3].T + grasp[:3, 3]


def palm(grasp: np.ndarray, height: float = 0.12) -> np.ndarray:
    """Points (N, 3) filling the hand's body and the wrist over it."""
    body = box_points(
        (-PALM_HALF_DEPTH, -PALM_HALF_WIDTH, -PALM_DISTANCE - height),
        (PALM_HALF_DEPTH, PALM_HALF_WIDTH, -PALM_DISTANCE),
        0.016,
    )
    return body @ grasp[:3, :3].T + grasp[:3, 3]


def lid_points(cooker: ArticulatedObject) -> np.ndarray:
    """Points (N, 3) of what collides on the lid, in the object's frame."""
    width = cooker.size[0]
    around = box_points(
        (-width - 0.02, -width / 2 - 0.02, 0.06), (0.17, width / 2 + 0.02, cooker.size[2] + 0.03), 0.006
    )
    return around[solid(cooker, around, links={"lid"})]


def test_all_cookers_differ_and_the_seen_ones_show_what_there_is() -> None:
    assert len({fingerprint(tuple(link.shapes for link in cooker.links)) for cooker in COOKERS.values()}) == len(
        COOKERS
    )
    assert len({tuple(np.round(cooker.size, 4)) for cooker in COOKERS.values()}) == len(COOKERS)
    descriptions = ", ".join(COOKERS[name].description for name in SEEN)
    words = "straight pot, bellied pot, tapered pot, dome lid, stepped lid, flat lid, weight, indicator, dial"
    for word in (*words.split(", "), "straight handle", "tapered handle", "moulded handle"):
        assert word in descriptions


def test_an_id_is_the_same_cooker_whatever_was_drawn_before() -> None:
    np.random.default_rng(5).random(3)
    for name in ("pressure_cooker_005", "pressure_cooker_000", "pressure_cooker_1234"):
        assert fingerprint(make_object(name)) == fingerprint(make_pressure_cooker(parse_object_id(name)[1]))


@every_cooker
def test_it_is_a_pot_with_a_lid_that_lifts_and_turns_either_way(cooker: ArticulatedObject) -> None:
    assert [(link.name, link.parent) for link in cooker.links] == [("pot", None), ("seal", "pot"), ("lid", "seal")]
    lift, lid = cooker.joint("lift"), cooker.joint("lid")
    assert (lift.kind, lift.axis, lift.limits) == ("prismatic", (0.0, 0.0, 1.0), (0.0, LIFT_UPPER))
    assert (lid.kind, lid.axis, lid.limits) == ("revolute", (0.0, 0.0, 1.0), (-LID_RANGE, LID_RANGE))
    assert all(link.mass > 0 and link.shapes for link in cooker.links)
    assert [motion.joint for motion in cooker.part("handle").motions] == ["lift", "lid"]


@pytest.mark.parametrize("name", [*SEEN, *UNSEEN])
def test_sizes_are_those_of_pots_for_three_to_eight_litres(name: str) -> None:
    cooker = COOKERS[name]
    width, depth, height = cooker.size
    assert 0.18 <= width <= 0.26
    assert width <= depth <= width + 0.06
    assert 0.15 < height < 0.27
    assert 0.12 <= cooker.joint("lift").origin[2] <= 0.20
    assert 0.15 < cooker.part("handle").grasp[0, 3] + width / 2 < 0.22


@every_cooker
def test_shapes_are_convex_with_faces_outward(cooker: ArticulatedObject) -> None:
    for shape in (shape for link in cooker.links for shape in link.shapes):
        rotation = shape.pose_in_link[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert all(value > 0 for value in shape.size)
        if shape.kind == "mesh":
            assert shape.vertices is not None
            normals, offsets = face_planes(shape)
            assert np.all(shape.vertices @ normals.T <= offsets + 1e-5)


@every_cooker
def test_fingers_close_on_the_lid_s_handle_and_on_nothing_else(cooker: ArticulatedObject) -> None:
    grasp = cooker.part("handle").grasp
    np.testing.assert_allclose(grasp[:3, 2], [0, 0, -1], atol=1e-12)
    line = grasp[:3, 3] + np.linspace(-HALF_OPENING, HALF_OPENING, 161)[:, None] * grasp[:3, 1]
    held = solid(cooker, line)
    assert np.array_equal(held, solid(cooker, line, links={"lid"}))
    assert 0.018 < 0.0005 * held.sum() < 0.034
    assert not solid(cooker, fingers(grasp), 0.002).any()


@every_cooker
def test_the_hand_clears_pot_and_dome_all_the_way(cooker: ArticulatedObject) -> None:
    handle = cooker.part("handle")
    assert not solid(cooker, palm(handle.grasp), 0.004).any()
    for turn in TURNS:
        for lift in (0.0, LIFT_UPPER):
            grasp = handle.moved({"lid": float(turn), "lift": lift})
            hand = np.concatenate([fingers(grasp, 0.010), palm(grasp)])
            assert not solid(cooker, hand, 0.001, links={"pot"}).any()


@every_cooker
def test_the_lid_meets_the_pot_nowhere_in_its_range(cooker: ArticulatedObject) -> None:
    center = link_origin(cooker, cooker.links[2])
    points = lid_points(cooker) - center
    assert len(points) > 200
    for turn in TURNS:
        turned = points @ rotation_about((0.0, 0.0, 1.0), float(turn)).T + center
        for lift in (0.0, LIFT_UPPER):
            assert not solid(cooker, turned + np.array([0, 0, lift]), -0.0005, links={"pot"}).any()


@every_cooker
def test_the_handles_stand_over_each_other_with_a_gap_for_fingertips(cooker: ArticulatedObject) -> None:
    grasp = cooker.part("handle").grasp
    line = grasp[:3, 3] + np.arange(0, 0.08, 0.0005)[:, None] * grasp[:3, 2]
    upper, lower = solid(cooker, line, links={"lid"}), solid(cooker, line, links={"pot"})
    assert lower.any()
    assert not (upper & lower).any()
    gap = 0.0005 * (np.flatnonzero(lower)[0] - np.flatnonzero(upper)[-1])
    assert 0.007 < gap < 0.02


@every_cooker
def test_what_turns_favours_no_direction(cooker: ArticulatedObject) -> None:
    """The safety plug apart, which stands to one side on every cooker."""
    for shape in cooker.links[2].shapes:
        y = shape.pose_in_link[1, 3]
        if abs(y) < 1e-9:
            reach = 0.004 + (max(shape.size) if shape.size else float(np.abs(shape.vertices).max()))
            points = box_points(-reach * np.ones(3), reach * np.ones(3), reach / 9) + shape.pose_in_link[:3, 3]
            assert np.array_equal(contains(shape, points), contains(shape, points * (1, -1, 1)))
        else:
            assert shape.pose_in_link[0, 3] == pytest.approx(-0.05 / 0.42 * y)
