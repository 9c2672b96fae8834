"""Microwaves: distinct and repeatable, held and pushed where they say, with a door and a button that move freely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import box_points, contains, face_planes, fingerprint, link_origin, solid

from lerobot_adamanip.catalog import make_object, novel_objects, parse_object_id, seen_objects, unseen_objects
from lerobot_adamanip.contract.rotations import rotation_about
from lerobot_adamanip.objects import ArticulatedObject, Link
from lerobot_adamanip.objects.microwave import (
    DOOR_UPPER,
    FINGER_TIP,
    GRASP_REACH,
    build_microwave,
    draw_design,
    make_microwave,
)

SEEN, UNSEEN = seen_objects("microwave"), unseen_objects("microwave", 11)
NOVEL = novel_objects("microwave", 8)
MICROWAVES = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
every_microwave = pytest.mark.parametrize("microwave", MICROWAVES.values(), ids=MICROWAVES)
some_microwaves = pytest.mark.parametrize("microwave", list(MICROWAVES.values())[::4], ids=list(MICROWAVES)[::4])
FINGER_LENGTH, HALF_OPENING, FINGER_DEPTH, FINGER_HALF_WIDTH = 0.045, 0.04, 0.014, 0.0105
"""Free length of a finger behind the tool point, opening (8 cm in all), thickness and half width [m]."""
HAND_HALF_WIDTH, HAND_HALF_THICKNESS, HAND_BEHIND = 0.105, 0.034, 0.055
"""The hand's body: half extents along and across the fingers' motion, and how far behind the tool point it starts."""


def fingers(grasp: np.ndarray, retreat: float = 0.0) -> np.ndarray:
    """Points filling both open fingers of a hand at a grasp, and all they sweep on the way from ``retreat`` [m]."""
    points = []
    for side in (-1, 1):
        near, far = sorted((side * HALF_OPENING, side * (HALF_OPENING + FINGER_DEPTH)))
        lower, upper = (-FINGER_HALF_WIDTH, near, -FINGER_LENGTH - retreat), (FINGER_HALF_WIDTH, far, 0.01)
        points.append(box_points(lower, upper, 0.005))
    return np.concatenate(points) @ grasp[:3, :3].T + grasp[:3, 3]


def closed_hand(pose: np.ndarray) -> np.ndarray:
    """Points filling the body of a hand, and its closed fingers down to a millimetre short of their tips."""
    body = box_points(
        (-HAND_HALF_THICKNESS, -HAND_HALF_WIDTH, -0.15), (HAND_HALF_THICKNESS, HAND_HALF_WIDTH, -HAND_BEHIND), 0.01
    )
    closed = box_points(
        (-FINGER_HALF_WIDTH, -FINGER_DEPTH, -HAND_BEHIND), (FINGER_HALF_WIDTH, FINGER_DEPTH, 0.009), 0.004
    )
    return np.concatenate([body, closed]) @ pose[:3, :3].T + pose[:3, 3]


def filling(link: Link, step: float) -> np.ndarray:
    """Points (N, 3) in the solid shapes of a link, link frame."""
    points = []
    for shape in link.shapes:
        if shape.collides:
            if shape.vertices is not None:
                half = np.abs(shape.vertices).max(axis=0)
            else:
                half = np.array(shape.size if shape.kind == "box" else (sum(shape.size), shape.size[0], shape.size[0]))
            grid = box_points(-half, half, step) @ shape.pose_in_link[:3, :3].T + shape.pose_in_link[:3, 3]
            points.append(grid[contains(shape, grid)])
    return np.concatenate(points)


def named(microwave: ArticulatedObject, name: str) -> Link:
    """Returns a link."""
    return next(link for link in microwave.links if link.name == name)


def test_all_microwaves_differ_in_size_and_between_them_show_everything() -> None:
    assert len({tuple(np.round(each.size, 4)) for each in MICROWAVES.values()}) == len(MICROWAVES)
    descriptions = ", ".join(MICROWAVES[name].description for name in SEEN)
    for word in (
        "round bar",
        "flat bar",
        "bow",
        "pull",
        "bar button",
        "round button",
        "square button",
        "hinge left",
        "hinge right",
        "keypad",
        "dials",
        "touch",
        "retro",
    ):
        assert descriptions.count(word) >= 2, word
    assert descriptions.count("hinge right") < 0.3 * len(SEEN)


def test_an_id_is_one_microwave() -> None:
    for name in ("microwave_036", "microwave_000", "microwave_1234"):
        assert fingerprint(make_object(name)) == fingerprint(make_microwave(parse_object_id(name)[1]))


@pytest.mark.parametrize("name", [*SEEN, *UNSEEN])
def test_it_has_the_size_of_an_oven_for_the_worktop(name: str) -> None:
    microwave = MICROWAVES[name]
    width, depth, height = microwave.size
    assert 0.37 < width < 0.50
    assert 0.26 < depth < 0.40
    assert 0.22 < height < 0.32
    inside = box_points((-depth - 0.03, -width, 0.0), (0.0, width, height + 0.03), 0.03)
    inside = inside[solid(microwave, inside)]
    assert np.all(np.abs(inside[:, 1]) <= width / 2 + 1e-6)
    assert inside[:, 0].min() >= -depth - 1e-6
    assert inside[:, 2].max() <= height + 1e-6


@every_microwave
def test_shapes_are_convex_with_faces_outward(microwave: ArticulatedObject) -> None:
    for shape in (shape for link in microwave.links for shape in link.shapes):
        assert all(value > 0 for value in shape.size)
        if shape.kind == "mesh":
            assert shape.vertices is not None
            normals, offsets = face_planes(shape)
            assert np.all(shape.vertices @ normals.T <= offsets + 1e-6)


@every_microwave
def test_handle_and_button_are_where_an_arm_gets_to(microwave: ArticulatedObject) -> None:
    handle, button = (microwave.part(name) for name in ("handle", "button"))
    hinge = handle.motion("door").point
    assert 0.2 < abs(handle.grasp[1, 3] - hinge[1]) < 0.36
    assert handle.grasp[0, 3] == GRASP_REACH
    assert np.linalg.norm(handle.grasp[:3, 3] - button.grasp[:3, 3]) > 0.10
    assert abs(button.grasp[1, 3]) < 0.20
    assert np.sign(button.grasp[1, 3]) == -np.sign(hinge[1]), "beside the door's free edge"
    assert microwave.joint("door").limits == (0.0, DOOR_UPPER)
    assert 0.012 <= microwave.joint("button").limits[1] <= 0.02


@every_microwave
def test_open_fingers_around_the_handle_hold_it_alone(microwave: ArticulatedObject) -> None:
    grasp = microwave.part("handle").grasp
    line = grasp[:3, 3] + np.linspace(-HALF_OPENING, HALF_OPENING, 161)[:, None] * grasp[:3, 1]
    held = solid(microwave, line)
    assert solid(microwave, grasp[None, :3, 3], links={"leaf"})[0]
    assert 0.012 < 0.0005 * held.sum() < 0.06
    assert not solid(microwave, fingers(grasp, retreat=0.1), 0.002).any()
    palm = closed_hand(grasp)
    assert not solid(microwave, palm[palm[:, 0] > GRASP_REACH + HAND_BEHIND - 1e-6], 0.002).any()


@every_microwave
def test_a_closed_hand_touches_the_button_and_pushes_it_home_without_touching_more(
    microwave: ArticulatedObject,
) -> None:
    button = microwave.part("button")
    tip = button.grasp[:3, 3] + FINGER_TIP * button.grasp[:3, 2]
    assert solid(microwave, tip[None] - (5e-4, 0, 0), links={"button"})[0]
    assert not solid(microwave, tip[None] + (5e-4, 0, 0)).any()
    for pushed in np.linspace(0.0, 0.7 * microwave.joint("button").limits[1], 4):
        hand = closed_hand(button.moved({"button": pushed}))
        assert not solid(microwave, hand, links={"body", "leaf"}).any()


@every_microwave
def test_the_button_has_a_well_to_sink_into_and_a_spring_that_presses_it_out(microwave: ArticulatedObject) -> None:
    joint, link = microwave.joint("button"), named(microwave, "button")
    points = filling(link, 0.003) + link_origin(microwave, link)
    for pushed in np.linspace(0.0, joint.limits[1], 4):
        assert not solid(microwave, points - (pushed, 0, 0), 0.0005, links={"body", "leaf"}).any()
    assert joint.stiffness > 0 > joint.rest
    assert link.mass * 9.81 < -joint.stiffness * joint.rest < 10


@some_microwaves
def test_the_door_swings_past_everything(microwave: ArticulatedObject) -> None:
    link = named(microwave, "leaf")
    points, axis = filling(link, 0.008), np.asarray(microwave.joint("door").axis)
    for angle in np.linspace(0, DOOR_UPPER, 12):
        swung = points @ rotation_about(axis, angle).T + link_origin(microwave, link)
        assert not solid(microwave, swung, 0.0005, links={"body", "button"}).any()


@every_microwave
def test_a_positive_door_angle_moves_the_handle_out_of_the_front(microwave: ArticulatedObject) -> None:
    handle = microwave.part("handle")
    x = [handle.moved({"door": angle})[0, 3] for angle in np.linspace(0, 1.2, 7)]
    assert np.all(np.diff(x) > 0)


def test_how_far_the_button_goes_is_not_to_be_seen() -> None:
    design = draw_design(np.random.default_rng(7))
    one, other = (build_microwave("microwave_007", replace(design, button_travel=value)) for value in (0.0125, 0.016))
    assert [fingerprint(link.shapes) for link in one.links] == [fingerprint(link.shapes) for link in other.links]
    assert fingerprint(one.parts) == fingerprint(other.parts)
