"""Coffee makers: distinct and repeatable, held by the portafilter, with room to swing and lower it, and silent."""

from __future__ import annotations

import numpy as np
import pytest
from solids import box_points, contains, face_planes, fingerprint, link_origin, solid
from test_pressure_cooker import HALF_OPENING, fingers, palm

from lerobot_adamanip.catalog import make_object, novel_objects, parse_object_id, seen_objects, unseen_objects
from lerobot_adamanip.contract.rotations import rotation_about
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.objects.coffee_maker import DROP_UPPER, PORTAFILTER_RANGE, make_coffee_maker

SEEN, UNSEEN = seen_objects("coffee_maker"), unseen_objects("coffee_maker", 4)
NOVEL = novel_objects("coffee_maker", 8)
MACHINES = {name: make_object(name) for name in (*SEEN, *UNSEEN, *NOVEL)}
every_machine = pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES)
TURNS = PORTAFILTER_RANGE * np.linspace(-1, 1, 5)


def portafilter_points(machine: ArticulatedObject) -> np.ndarray:
    """Points (N, 3) of what collides on the portafilter, in the object's frame."""
    x, _, z = link_origin(machine, machine.links[2])
    around = box_points((x - 0.05, -0.05, z - 0.08), (x + 0.24, 0.05, z + 0.01), 0.005)
    return around[solid(machine, around, links={"portafilter"})]


def test_all_machines_differ_and_the_seen_ones_show_what_there_is() -> None:
    assert len({fingerprint(tuple(link.shapes for link in each.links)) for each in MACHINES.values()}) == len(MACHINES)
    assert len({tuple(np.round(each.size, 4)) for each in MACHINES.values()}) == len(MACHINES)
    descriptions = ", ".join(MACHINES[name].description for name in SEEN)
    for word in (
        "box body",
        "column body",
        "rounded body",
        "gauge",
        "buttons",
        "dial",
        "display",
        "cups",
        "rail",
        "hopper",
        "plain",
        "double",
        "single",
        "bottomless",
    ):
        assert descriptions.count(word) >= 2


def test_an_id_is_the_same_machine_whatever_was_drawn_before() -> None:
    np.random.default_rng(5).random(3)
    for name in ("coffee_maker_017", "coffee_maker_000", "coffee_maker_1234"):
        assert fingerprint(make_object(name)) == fingerprint(make_coffee_maker(parse_object_id(name)[1]))


@every_machine
def test_it_is_a_machine_whose_portafilter_turns_either_way_and_comes_down(machine: ArticulatedObject) -> None:
    tree = [("machine", None), ("puck", "machine"), ("portafilter", "puck")]
    assert [(link.name, link.parent) for link in machine.links] == tree
    drop, turn = machine.joint("drop"), machine.joint("portafilter")
    assert (drop.kind, drop.axis, drop.limits) == ("prismatic", (0.0, 0.0, -1.0), (0.0, DROP_UPPER))
    assert (turn.axis, turn.limits) == ((0.0, 0.0, 1.0), (-PORTAFILTER_RANGE, PORTAFILTER_RANGE))
    assert [motion.joint for motion in machine.part("handle").motions] == ["drop", "portafilter"]


@pytest.mark.parametrize("name", [*SEEN, *UNSEEN])
def test_sizes_are_those_of_home_machines(name: str) -> None:
    machine = MACHINES[name]
    width, depth, height = machine.size
    assert 0.20 <= width <= 0.32
    assert 0.24 <= depth <= 0.34
    assert 0.28 <= height <= 0.46  # cups or hopper included
    assert 0.14 < machine.part("handle").grasp[0, 3] - machine.joint("drop").origin[0] < 0.19
    shapes = [shape for shape in machine.links[0].shapes if shape.vertices is not None]
    corners = np.concatenate([s.vertices @ s.pose_in_link[:3, :3].T + s.pose_in_link[:3, 3] for s in shapes])
    assert corners[:, 0].max() <= 1e-6
    assert corners[:, 0].min() >= -depth - 0.002
    assert corners[:, 2].max() <= height + 0.005


@every_machine
def test_shapes_are_convex_with_faces_outward(machine: ArticulatedObject) -> None:
    for shape in (shape for link in machine.links for shape in link.shapes):
        rotation = shape.pose_in_link[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert all(value > 0 for value in shape.size)
        if shape.kind == "mesh":
            assert shape.vertices is not None
            normals, offsets = face_planes(shape)
            assert np.all(shape.vertices @ normals.T <= offsets + 1e-5)


@every_machine
def test_fingers_close_on_the_handle_and_on_nothing_else(machine: ArticulatedObject) -> None:
    grasp = machine.part("handle").grasp
    np.testing.assert_allclose(grasp[:3, 2], [0, 0, -1], atol=1e-12)
    line = grasp[:3, 3] + np.linspace(-HALF_OPENING, HALF_OPENING, 161)[:, None] * grasp[:3, 1]
    held = solid(machine, line)
    assert np.array_equal(held, solid(machine, line, links={"portafilter"}))
    assert 0.018 < 0.0005 * held.sum() < 0.034
    assert not solid(machine, fingers(grasp), 0.002).any()


@every_machine
def test_the_hand_clears_the_machine_all_the_way(machine: ArticulatedObject) -> None:
    handle = machine.part("handle")
    for turn in TURNS:
        for drop in (0.0, DROP_UPPER):
            grasp = handle.moved({"portafilter": float(turn), "drop": drop})
            hand = np.concatenate([fingers(grasp, 0.010), palm(grasp, 0.2)])
            assert not solid(machine, hand, 0.008, links={"machine"}).any()


@every_machine
def test_decoration_too_stays_out_of_the_hand_s_way(machine: ArticulatedObject) -> None:
    handle = machine.part("handle")
    grasps = [handle.moved({"portafilter": float(turn)}) for turn in TURNS]
    hand = np.concatenate([palm(grasp, 0.2) for grasp in grasps])
    for shape in machine.links[0].shapes:
        assert not contains(shape, hand, 0.002).any()


@every_machine
def test_the_portafilter_meets_the_machine_nowhere_in_its_range(machine: ArticulatedObject) -> None:
    center = link_origin(machine, machine.links[2])
    points = portafilter_points(machine) - center
    assert len(points) > 200
    for turn in TURNS:
        turned = points @ rotation_about((0.0, 0.0, 1.0), float(turn)).T + center
        for drop in (0.0, DROP_UPPER):
            assert not solid(machine, turned - (0, 0, drop), 0.0005, links={"machine"}).any()


@every_machine
def test_what_turns_favours_no_direction(machine: ArticulatedObject) -> None:
    x, _, z = link_origin(machine, machine.links[2])
    points = portafilter_points(machine) - (x, 0, z)
    shapes = machine.links[2].shapes
    inside, mirrored = (
        np.any([contains(shape, each) for shape in shapes], axis=0) for each in (points, points * (1, -1, 1))
    )
    assert np.array_equal(inside, mirrored)
