"""Doors: distinct and repeatable, held where they say, with a leaf and a lever that move freely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import swinging
from solids import fingerprint

from lerobot_adamanip.catalog import make_object, novel_objects, parse_object_id, seen_objects, unseen_objects
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.objects.door import DOOR_UPPER, LEVER_RANGE, build_door, draw_design, make_door
from lerobot_adamanip.objects.fittings.handles import KNOBS

SEEN, UNSEEN = seen_objects("door"), unseen_objects("door", 12)
NOVEL = novel_objects("door", 8)
DOORS = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
some_doors = pytest.mark.parametrize("door", list(DOORS.values())[::3], ids=list(DOORS)[::3])
every_door = pytest.mark.parametrize("door", DOORS.values(), ids=DOORS)


def test_all_doors_differ_in_size_and_between_them_show_everything() -> None:
    assert len({tuple(np.round(each.size, 4)) for each in DOORS.values()}) == len(DOORS)
    descriptions = ", ".join(DOORS[name].description for name in SEEN)
    for word in (
        "lever",
        "ball knob",
        "T bar",
        "six panels",
        "planks",
        "louvres",
        "half glazed",
        "flush",
        "brick",
        "plaster",
    ):
        assert word in descriptions, word
    assert 0.25 < descriptions.count("hinge left") / len(SEEN) < 0.75


def test_an_id_is_the_same_door_in_any_order() -> None:
    names = ["door_029", "door_000", "door_1234"]
    np.random.default_rng(5).random(3)
    here = [fingerprint(make_door(parse_object_id(name)[1])) for name in reversed(names)]
    assert [fingerprint(make_object(name)) for name in names] == here[::-1]
    assert len(set(here)) == 3


@every_door
def test_it_is_a_leaf_hinged_to_a_frame_with_a_lever_on_it(door: ArticulatedObject) -> None:
    swinging.check_tree(door, "leaf", "lever", LEVER_RANGE)
    assert door.joint("leaf").limits[1] == DOOR_UPPER
    swinging.check_balance(door)


@some_doors
def test_its_shapes_are_convex_and_stand_on_the_floor(door: ArticulatedObject) -> None:
    swinging.check_shapes(door)
    swinging.check_inside_size(door)


@pytest.mark.parametrize("name", (*SEEN, *UNSEEN)[::3])
def test_its_sizes_are_those_of_a_door(name: str) -> None:
    door = DOORS[name]
    points = swinging.filling(swinging.named(door, "leaf"), 0.01)
    width, height = np.ptp(points[:, 1]), np.ptp(points[:, 2])
    assert 0.35 < width < 0.44
    assert 0.83 < height < 1.09
    assert height > 1.9 * width


@every_door
def test_a_grasp_lies_within_the_lever_and_an_open_hand_clears_everything(door: ArticulatedObject) -> None:
    swinging.check_grasp(door, "lever", "lever")


@some_doors
def test_a_hand_that_turns_and_pulls_touches_nothing_else(door: ArticulatedObject) -> None:
    swinging.check_hand_is_free(door, "lever", "leaf", "lever")


@some_doors
def test_nothing_that_moves_meets_what_it_moves_against(door: ArticulatedObject) -> None:
    swinging.check_nothing_overlaps(door, "lever", "leaf", "lever")


@every_door
def test_it_opens_towards_the_robot_within_its_reach(door: ArticulatedObject) -> None:
    swinging.check_opening(door, "lever", "leaf", reach=0.40)


def test_knobs_are_held_on_their_axis_and_levers_off_it() -> None:
    for each in DOORS.values():
        part = each.part("lever")
        away = float(np.linalg.norm((part.grasp[:3, 3] - part.motion("lever").point)[1:]))
        if any(style in each.description for style in KNOBS):
            assert len(part.rolls) == 8
            assert away < 1e-9
        elif "lever" in each.description:
            assert len(part.rolls) == 2
            assert 0.06 < away < 0.10


def test_the_same_design_in_another_wall_turns_the_same_lever() -> None:
    design = draw_design(np.random.default_rng(7))
    one, other = (build_door("door_007", replace(design, depth=depth)) for depth in (0.1, 0.12))
    assert fingerprint(one.links[2].shapes) == fingerprint(other.links[2].shapes)
