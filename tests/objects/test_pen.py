"""Pens: distinct and repeatable, upright in a stand, with a cap two fingers can hold beside its clip."""

from __future__ import annotations

import numpy as np
import pytest
from caps import check_cap_and_joints, check_grip, check_shapes, check_size, check_turning_and_lifting
from solids import fingerprint, solid

from lerobot_adamanip.catalog import make_object, novel_objects, seen_objects, unseen_objects
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.objects.pen import CAP_RANGE, make_pen
from lerobot_adamanip.objects.pen.recipes import RECIPES, STANDS

SEEN, UNSEEN = seen_objects("pen"), unseen_objects("pen", 8)
NOVEL = novel_objects("pen", 8)
PENS = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
every_pen = pytest.mark.parametrize("pen", PENS.values(), ids=PENS)


def test_all_pens_differ_and_are_the_same_again() -> None:
    shapes = {fingerprint(tuple(link.shapes for link in pen.links)) for pen in PENS.values()}
    assert len(shapes) == len(PENS)
    assert len({tuple(np.round(pen.size, 4)) for pen in PENS.values()}) == len(PENS), "not in colour alone"
    assert fingerprint(make_pen(11)) == fingerprint(PENS["pen_011"])


def test_every_kind_of_pen_and_stand_is_among_the_seen_ones() -> None:
    descriptions = [PENS[name].description for name in SEEN]
    for kind in RECIPES:
        assert sum(text.startswith(kind) for text in descriptions) >= len(SEEN) // len(RECIPES)
    for stand in STANDS:
        assert any(text.endswith(stand) for text in descriptions)


@every_pen
def test_it_has_the_size_of_a_pen_in_a_stand_behind_its_origin(pen: ArticulatedObject) -> None:
    width, depth, height = pen.size
    assert 0.12 <= height <= 0.20
    assert 0.04 <= depth <= 0.13
    assert 0.04 <= width <= 0.22
    check_size(pen)


@every_pen
def test_its_shapes_and_joints_are_sound(pen: ArticulatedObject) -> None:
    check_shapes(pen)
    check_cap_and_joints(pen)
    assert pen.joint("cap").limits[1] == CAP_RANGE


@every_pen
def test_fingers_hold_the_cap_beside_its_clip_and_nothing_else(pen: ArticulatedObject) -> None:
    assert {0.0, np.pi} <= set(pen.part("cap").rolls)
    check_grip(pen, 0.0115, 0.0225)


@every_pen
def test_pads_as_wide_as_they_are_meet_the_cap_before_the_clip(pen: ArticulatedObject) -> None:
    part = pen.part("cap")
    line = np.linspace(-0.04, 0.04, 641)
    for roll in part.rolls:
        rolled = part.rolled(roll).grasp

        def reach(across: float, pose: np.ndarray = rolled) -> float:
            """How far from the middle what is held extends, ``across`` [m] the pads."""
            points = pose[:3, 3] + line[:, None] * pose[:3, 1] + across * pose[:3, 0]
            held = solid(pen, points, links={"cap"})
            return float(np.abs(line[held]).max()) if held.any() else 0.0

        widest = reach(0.0)
        assert max(reach(float(across)) for across in np.linspace(-0.0105, 0.0105, 15)) <= widest + 0.0003


@every_pen
def test_a_cap_turns_and_comes_off_without_touching_its_pen(pen: ArticulatedObject) -> None:
    check_turning_and_lifting(pen)
