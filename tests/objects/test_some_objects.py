"""What holds for the objects of one or two categories: clips, springs, buttons, room for a hand."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest
from solids import HALF_OPENING, box_points, contains, digest, filling, hand, named, solid
from test_every_object import objects

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.objects.drawing import draw
from lerobot_adamanip.objects.fittings.handles import KNOBS
from lerobot_adamanip.objects.lamp.generator import LampDesign
from lerobot_adamanip.objects.lamp.heads import HEADS


def column(radius: float, low: float, high: float) -> np.ndarray:
    """Points (N, 3) in an upright cylinder about the z axis."""
    points = box_points((-radius, -radius, low), (radius, radius, high), 0.01)
    return points[np.hypot(points[:, 0], points[:, 1]) <= radius]


def test_pads_as_wide_as_they_are_meet_a_pen_s_cap_before_its_clip() -> None:
    line = np.linspace(-0.04, 0.04, 641)
    for pen in objects("pen"):
        for roll in pen.part("cap").rolls:
            pose = pen.part("cap").rolled(roll).grasp

            def reach(across: float, pose: np.ndarray = pose) -> float:
                """How far from the middle what is held extends, ``across`` [m] the pads."""
                points = pose[:3, 3] + line[:, None] * pose[:3, 1] + across * pose[:3, 0]
                return float(np.abs(line[solid(pen, points, links={"cap"})]).max(initial=0.0))  # noqa: B023

            assert max(map(reach, np.linspace(-0.0105, 0.0105, 15))) <= reach(0.0) + 0.0003


@pytest.mark.parametrize(("category", "part"), [("door", "lever"), ("window", "handle")])
def test_knobs_are_held_on_their_axis_and_levers_are_balanced_off_it(category: str, part: str) -> None:
    for obj in objects(category):
        held, joint, link = obj.part(part), obj.joint(part), named(obj, part)
        away = float(np.linalg.norm((held.grasp[:3, 3] - held.motion(part).point)[1:]))
        if any(style in obj.description for style in KNOBS):
            assert (len(held.rolls), away) == (8, pytest.approx(0.0, abs=1e-9))
        elif "lever" in obj.description:
            assert len(held.rolls) == 2
            assert 0.06 < away < 0.10
        # The spring is tensioned against the weight of a handle that hangs to one side, and slack under any other.
        carried = -joint.stiffness * joint.rest / (link.mass * 9.81)
        sideways = filling(obj, part, 0.004)[:, 1] - held.motion(part).point[1]
        middle = (sideways.min() + sideways.max()) / 2
        assert joint.stiffness > 0
        assert abs(carried) < 0.01 if abs(middle) < 0.01 else 0.3 < carried / middle < 1.2


def test_a_hand_above_a_lamp_s_switch_has_room_and_a_spring_carries_the_switch() -> None:
    for lamp in objects("lamp"):
        knob, joint = lamp.part("knob"), lamp.joint("button")
        np.testing.assert_allclose(knob.grasp[:2, 3], knob.motion("knob").point[:2], atol=1e-12)
        body = knob.grasp[:3, 3] + column(0.130, 0.055 - joint.limits[1], 0.45)
        fingers = knob.grasp[:3, 3] + column(0.056, -0.010 - joint.limits[1], 0.055)
        assert not solid(lamp, body).any()
        assert not solid(lamp, fingers, 0.002, links={"base"}).any()
        weight = 9.81 * (named(lamp, "knob").mass + named(lamp, "plunger").mass)
        assert weight < -joint.stiffness * joint.rest < 10


def test_every_kind_of_lamp_head_gets_drawn() -> None:
    assert {draw(LampDesign, np.random.default_rng(seed)).head.style for seed in range(200)} == set(HEADS)


def test_a_closed_hand_pushes_a_microwave_s_button_home_and_a_spring_presses_it_out() -> None:
    for microwave in objects("microwave"):
        button, joint, handle = microwave.part("button"), microwave.joint("button"), microwave.part("handle")
        tip = button.grasp[:3, 3] + 0.010 * button.grasp[:3, 2]
        assert solid(microwave, tip[None] - (5e-4, 0, 0), links={"button"})[0]
        assert not solid(microwave, tip[None] + (5e-4, 0, 0)).any()
        for pushed in np.linspace(0.0, 0.7 * joint.limits[1], 4):
            closed = hand(button.moved({"button": pushed}), 0.0)
            assert not solid(microwave, closed, links={"body", "leaf"}).any()
        assert named(microwave, "button").mass * 9.81 < -joint.stiffness * joint.rest < 10
        assert np.linalg.norm(handle.grasp[:3, 3] - button.grasp[:3, 3]) > 0.10
        assert np.sign(button.grasp[1, 3]) == -np.sign(handle.motion("door").point[1]), "beside the door's free edge"


def test_a_safe_s_handle_and_knob_are_a_hand_apart_and_nothing_sticks_out_into_its_palm() -> None:
    for safe in objects("safe"):
        handle, knob = (safe.part(name).grasp[:3, 3] for name in ("handle", "knob"))
        # Open fingers reach 5.4 cm to each side of a grasp, and a part 3.7 cm.
        assert np.linalg.norm(handle - knob) > HALF_OPENING + 0.014 + 0.037
        palm = handle[0] + 0.040
        front = box_points((palm, -safe.size[0] / 2, 0), (palm, safe.size[0] / 2, safe.size[2]), 0.007)
        assert not solid(safe, front).any()
    assert {np.sign(safe.joint("door").axis[2]) for safe in objects("safe")} == {-1.0, 1.0}


def test_a_cooker_s_handles_stand_over_each_other_with_a_gap_for_fingertips() -> None:
    for cooker in objects("pressure_cooker"):
        grasp = cooker.part("handle").grasp
        line = grasp[:3, 3] + np.arange(0, 0.08, 0.0005)[:, None] * grasp[:3, 2]
        upper, lower = (np.flatnonzero(solid(cooker, line, links={link})) for link in ("lid", "pot"))
        assert 0.007 < 0.0005 * (lower[0] - upper[-1]) < 0.02


def test_a_coffee_maker_s_decoration_too_stays_out_of_the_hand_s_way() -> None:
    for machine in objects("coffee_maker"):
        turns = machine.joint("portafilter").limits[1] * np.linspace(-1, 1, 5)
        points = np.concatenate(
            [hand(machine.part("handle").moved({"portafilter": float(turn)}), 0.010) for turn in turns]
        )
        assert not any(contains(shape, points, 0.002).any() for shape in named(machine, "machine").shapes)


@pytest.mark.parametrize(
    ("module", "hidden", "values"),
    [("safe", "knob_range", (1.1, 1.6)), ("microwave.generator", "button_travel", (0.0125, 0.016)),
     ("lamp.generator", "turn_range", (1.3, 1.5))],
)  # fmt: skip
def test_how_far_a_key_goes_is_not_to_be_seen(module: str, hidden: str, values: tuple[float, float]) -> None:
    category = module.partition(".")[0]
    generator = importlib.import_module(f"lerobot_adamanip.objects.{module}")
    design = draw(getattr(generator, f"{category.capitalize()}Design"), np.random.default_rng(7))
    build = getattr(generator, f"build_{category}")
    one, other = (build(f"{category}_007", replace(design, **{hidden: value})) for value in values)
    shown = [digest(replace(obj, links=tuple(replace(link, joint=None) for link in obj.links))) for obj in (one, other)]
    assert shown[0] == shown[1]


def test_a_missing_part_is_named_with_those_there_are() -> None:
    with pytest.raises(KeyError, match="handle"):
        make_object("safe_001").part("wheel")
