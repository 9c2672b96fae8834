"""Windows: distinct and repeatable, held where they say, with a sash and a handle that move freely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import swinging
from solids import fingerprint

from lerobot_adamanip.catalog import make_object, novel_objects, parse_object_id, seen_objects, unseen_objects
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.objects.fittings.handles import KNOBS
from lerobot_adamanip.objects.window import HANDLE_RANGE, SASH_UPPER, build_window, draw_design, make_window

SEEN, UNSEEN = seen_objects("window"), unseen_objects("window", 12)
NOVEL = novel_objects("window", 8)
WINDOWS = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
some_windows = pytest.mark.parametrize("window", list(WINDOWS.values())[::3], ids=list(WINDOWS)[::3])
every_window = pytest.mark.parametrize("window", WINDOWS.values(), ids=WINDOWS)


def test_all_windows_differ_in_size_and_between_them_show_everything() -> None:
    assert len({tuple(np.round(each.size, 4)) for each in WINDOWS.values()}) == len(WINDOWS)
    descriptions = ", ".join(WINDOWS[name].description for name in SEEN)
    for word in (
        "lever",
        "olive",
        "T bar",
        "drum knob",
        "side light",
        "transom",
        "single",
        "brick",
        "plaster",
        "boarding",
    ):
        assert word in descriptions, word
    assert 0.25 < descriptions.count("hinge left") / len(SEEN) < 0.75


def test_an_id_is_the_same_window_in_any_order() -> None:
    names = ["window_029", "window_000", "window_1234"]
    np.random.default_rng(5).random(3)
    here = [fingerprint(make_window(parse_object_id(name)[1])) for name in reversed(names)]
    assert [fingerprint(make_object(name)) for name in names] == here[::-1]
    assert len(set(here)) == 3


@every_window
def test_it_is_a_sash_hinged_to_a_frame_with_a_handle_on_it(window: ArticulatedObject) -> None:
    swinging.check_tree(window, "sash", "handle", HANDLE_RANGE)
    assert window.joint("sash").limits[1] == SASH_UPPER
    swinging.check_balance(window)


@some_windows
def test_its_shapes_are_convex_and_stand_on_the_floor(window: ArticulatedObject) -> None:
    swinging.check_shapes(window)
    swinging.check_inside_size(window)


@pytest.mark.parametrize("name", (*SEEN, *UNSEEN)[::3])
def test_its_sizes_are_those_of_a_window(name: str) -> None:
    window = WINDOWS[name]
    points = swinging.filling(swinging.named(window, "sash"), 0.01)
    width, height = np.ptp(points[:, 1]), np.ptp(points[:, 2])
    assert 0.29 < width < 0.39
    assert 0.35 < height < 0.53
    assert height > width


@every_window
def test_a_grasp_lies_within_the_handle_and_an_open_hand_clears_everything(window: ArticulatedObject) -> None:
    swinging.check_grasp(window, "handle", "handle")


@some_windows
def test_a_hand_that_turns_and_pulls_touches_nothing_else(window: ArticulatedObject) -> None:
    swinging.check_hand_is_free(window, "handle", "sash", "handle")


@some_windows
def test_nothing_that_moves_meets_what_it_moves_against(window: ArticulatedObject) -> None:
    swinging.check_nothing_overlaps(window, "handle", "sash", "handle")


@every_window
def test_it_opens_towards_the_robot_within_its_reach(window: ArticulatedObject) -> None:
    swinging.check_opening(window, "handle", "sash", reach=0.40)


def test_knobs_are_held_on_their_axis_and_levers_off_it() -> None:
    for each in WINDOWS.values():
        part = each.part("handle")
        away = float(np.linalg.norm((part.grasp[:3, 3] - part.motion("handle").point)[1:]))
        if any(style in each.description for style in KNOBS):
            assert len(part.rolls) == 8
            assert away < 1e-9
        elif "lever" in each.description:
            assert len(part.rolls) == 2
            assert 0.06 < away < 0.10


def test_the_same_design_in_another_wall_turns_the_same_handle() -> None:
    design = draw_design(np.random.default_rng(7))
    one, other = (build_window("window_007", replace(design, depth=depth)) for depth in (0.1, 0.12))
    assert fingerprint(one.links[2].shapes) == fingerprint(other.links[2].shapes)
