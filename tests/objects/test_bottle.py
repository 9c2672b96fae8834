"""Bottles: distinct and repeatable, with a cap two fingers can hold and turn, and silent about what is hidden."""

from __future__ import annotations

import numpy as np
import pytest
from caps import check_cap_and_joints, check_grip, check_shapes, check_size, check_turning_and_lifting
from solids import fingerprint

from lerobot_adamanip.catalog import make_object, novel_objects, seen_objects, unseen_objects
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.objects.bottle import CAP_RANGE, make_bottle
from lerobot_adamanip.objects.bottle.recipes import RECIPES

SEEN, UNSEEN = seen_objects("bottle"), unseen_objects("bottle", 8)
NOVEL = novel_objects("bottle", 8)
BOTTLES = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
every_bottle = pytest.mark.parametrize("bottle", BOTTLES.values(), ids=BOTTLES)


def test_all_bottles_differ_and_are_the_same_again() -> None:
    shapes = {fingerprint(tuple(link.shapes for link in bottle.links)) for bottle in BOTTLES.values()}
    assert len(shapes) == len(BOTTLES)
    assert len({tuple(np.round(bottle.size, 4)) for bottle in BOTTLES.values()}) == len(BOTTLES), "not in colour alone"
    assert fingerprint(make_bottle(11)) == fingerprint(BOTTLES["bottle_011"])


def test_every_kind_is_among_the_seen_ones() -> None:
    descriptions = [BOTTLES[name].description for name in SEEN]
    for kind in RECIPES:
        assert sum(text.startswith(f"{kind} bottle") for text in descriptions) == len(SEEN) // len(RECIPES)


@pytest.mark.parametrize("name", [*SEEN, *UNSEEN])
def test_it_has_the_size_of_a_bottle(name: str) -> None:
    bottle = BOTTLES[name]
    width, depth, height = bottle.size
    assert 0.12 <= height <= 0.32
    assert 0.035 <= depth <= 0.095
    assert 0.05 <= width <= 0.17


@every_bottle
def test_it_stands_behind_its_origin_and_fills_its_box(bottle: ArticulatedObject) -> None:
    check_size(bottle)


@every_bottle
def test_its_shapes_and_joints_are_sound(bottle: ArticulatedObject) -> None:
    check_shapes(bottle)
    check_cap_and_joints(bottle)
    assert bottle.joint("cap").limits[1] == CAP_RANGE


@every_bottle
def test_fingers_hold_the_cap_and_nothing_else(bottle: ArticulatedObject) -> None:
    part = bottle.part("cap")
    assert len(part.rolls) == 8
    check_grip(bottle, 0.024, 0.050)


@every_bottle
def test_a_cap_turns_and_lifts_without_touching_its_bottle(bottle: ArticulatedObject) -> None:
    check_turning_and_lifting(bottle)
