"""What holds for every generated object: it is what it was, stands on the floor, and can be held, turned and opened."""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from solids import (
    HALF_OPENING,
    box_points,
    contains,
    digest,
    face_planes,
    filling,
    hand,
    link_origin,
    named,
    solid,
)

from lerobot_adamanip.catalog import make_object, novel_objects, object_split, seen_objects, unseen_objects
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.mechanisms import infeasible, make_mechanism
from lerobot_adamanip.objects import ArticulatedObject, PartAnnotation

Range = tuple[float, float]


@dataclass(frozen=True)
class Kind:
    """What a category's objects have in common.

    Attributes:
        digest: of all seen, 20 unseen and 20 novel objects.
        joints: name -> (kind, nominal limits; None where they are drawn).
        grips: part -> (link that is held, its thickness between the fingers [m]).
        size: (width, depth, height) of seen and unseen objects [m].
        words: that descriptions of the seen ones have between them.
        shared: of these, the ones that novel objects may have too.
        front: how far (x) what stands still reaches before the origin [m].
        apart: half opening of a hand that has closed on the key part [m].
    """

    digest: str
    joints: dict[str, tuple[str, Any]]
    grips: dict[str, tuple[str, Range]]
    size: tuple[Range, Range, Range]
    words: str
    shared: str = ""
    front: float = 0.002
    apart: float = 0.010


LEVER_WORDS = "hinge left, hinge right, plaster, brick, lever, T bar"
KINDS = {
    "bottle": Kind(
        "63b5147d3a134013",
        {"lift": ("prismatic", (0, 0.05)), "cap": ("revolute", (-2.35, 2.35))}, {"cap": ("cap", (0.022, 0.052))},
        ((0.05, 0.17), (0.035, 0.095), (0.12, 0.32)),
        "wine, hock, soda, water, milk, ketchup, oil, long cap, fluted cap, flip cap",
        "fluted cap, smooth cap, dome cap, beaker cap", apart=HALF_OPENING,
    ),
    "pen": Kind(
        "b5b8d4eea0162abd",
        {"lift": ("prismatic", (0, 0.05)), "cap": ("revolute", (-2.35, 2.35))}, {"cap": ("cap", (0.0095, 0.0245))},
        ((0.04, 0.22), (0.04, 0.13), (0.12, 0.20)),
        "fountain pen, rollerball, fineliner, ballpoint, highlighter, brush pen, block, slab, disc, cube, note tray",
        "bar clip, arrow clip, ball clip", apart=HALF_OPENING,
    ),
    "pressure_cooker": Kind(
        "0914f495aec8d22c",
        {"lift": ("prismatic", (0, 0.05)), "lid": ("revolute", (-0.824, 0.824))}, {"handle": ("lid", (0.018, 0.034))},
        ((0.18, 0.26), (0.18, 0.32), (0.15, 0.27)),
        "straight pot, bellied pot, tapered pot, dome lid, stepped lid, flat lid, weight, indicator, dial",
        front=0.25,
    ),
    "coffee_maker": Kind(
        "20c871ecb6dec28b",
        {"drop": ("prismatic", (0, 0.05)), "portafilter": ("revolute", (-0.80, 0.80))},
        {"handle": ("portafilter", (0.018, 0.034))}, ((0.20, 0.32), (0.24, 0.34), (0.28, 0.46)),
        "box body, column body, rounded body, gauge, buttons, dial, display, cups, rail, hopper, plain, bottomless",
        "double spout, single spout, bottomless spout",
    ),
    "safe": Kind(
        "d83ca0e5e6d00655",
        {"door": ("revolute", (0, 1.578)), "knob": ("revolute", None)},
        {"handle": ("leaf", (0.012, 0.06)), "knob": ("knob", (0.012, 0.06))},
        ((0.33, 0.47), (0.27, 0.41), (0.31, 0.50)),
        "round bar, flat bar, arch, thumb turn, octagon, pointer, hinge left, hinge right", "hinge left, hinge right",
        front=0.02, apart=HALF_OPENING,
    ),
    "microwave": Kind(
        "4984b1da889f17bb",
        {"door": ("revolute", (0, 1.578)), "button": ("prismatic", None)}, {"handle": ("leaf", (0.012, 0.06))},
        ((0.37, 0.50), (0.26, 0.40), (0.22, 0.32)),
        "round bar, flat bar, bow, pull, bar button, round button, hinge right, keypad, dials, touch, retro",
        "hinge left, hinge right, keypad, dials, touch, retro",
    ),
    "window": Kind(
        "358a4e7d9c73786a",
        {"sash": ("revolute", (0, 1.57)), "handle": ("revolute", (-1.57, 1.57))}, {"handle": ("handle", (0.012, 0.06))},
        ((0.5, 0.85), (0.09, 0.15), (0.6, 1.0)),
        f"{LEVER_WORDS}, olive, drum knob, side light, transom, single, boarding",
        "hinge left, hinge right, plaster, boarding, brick, side light, transom, single", front=0.045,
    ),
    "door": Kind(
        "3ebcf82b969086ef",
        {"leaf": ("revolute", (0, 1.57)), "lever": ("revolute", (-1.05, 1.05))}, {"lever": ("lever", (0.012, 0.06))},
        ((0.5, 0.9), (0.08, 0.14), (0.9, 1.3)),
        f"{LEVER_WORDS}, ball knob, six panels, planks, louvres, half glazed, flush",
        "hinge left, hinge right, plaster, boarding, brick, none", front=0.045,
    ),
    "lamp": Kind(
        "369cfd581082c219",
        {"button": ("prismatic", None), "knob": ("revolute", None)}, {"knob": ("knob", (0.018, 0.045))},
        ((0.08, 0.60), (0.12, 0.42), (0.20, 0.48)),
        "plate base, block base, stadium base, discs base, smooth, knurled, faceted", front=0.06, apart=HALF_OPENING,
    ),
}  # fmt: skip
every_category = pytest.mark.parametrize("category", CATEGORIES)


object_of = functools.cache(make_object)


def objects(category: str, *, novel: bool = True, step: int = 1) -> list[ArticulatedObject]:
    names = [*seen_objects(category), *unseen_objects(category, 8)][::step]
    return [object_of(name) for name in (*names, *(novel_objects(category, 8)[::step] if novel else ()))]


@every_category
def test_objects_stay_what_they_are(category: str) -> None:
    names = (*seen_objects(category), *unseen_objects(category), *novel_objects(category))
    together = hashlib.sha256("".join(digest(object_of(name)) for name in names).encode())
    assert together.hexdigest()[:16] == KINDS[category].digest


@every_category
def test_objects_differ_in_size_and_the_seen_ones_show_what_there_is(category: str) -> None:
    everything, seen = objects(category), [object_of(name).description for name in seen_objects(category)]
    assert len({digest(obj) for obj in everything}) == len(everything)
    assert len({tuple(np.round(obj.size, 4)) for obj in everything}) == len(everything), "not in colour alone"
    for word in KINDS[category].words.split(", "):
        assert sum(word in text for text in seen) >= 1, word


@every_category
def test_a_novel_object_is_of_a_kind_that_no_seen_one_is_and_has_the_same_joints(category: str) -> None:
    shared = set(KINDS[category].shared.split(", "))

    def words(obj: ArticulatedObject) -> set[str]:
        told = {word for word in obj.description.split(", ") if not word.startswith("bars")}
        return told - shared

    like = object_of(seen_objects(category)[0])
    seen = set().union(*(words(object_of(name)) for name in seen_objects(category)))
    for name in novel_objects(category):
        obj = object_of(name)
        assert (obj.object_id, object_split(name)) == (name, "novel")
        assert words(obj)
        assert not words(obj) & seen, name
        assert [part.name for part in obj.parts] == [part.name for part in like.parts]
        assert [link.joint.name for link in obj.links if link.joint] == [
            link.joint.name for link in like.links if link.joint
        ]


@every_category
def test_it_is_a_tree_of_bodies_on_the_joints_of_its_category(category: str) -> None:
    expected = KINDS[category].joints
    for obj in objects(category):
        names = [link.name for link in obj.links]
        assert len(set(names)) == len(names)
        assert (obj.links[0].parent, obj.links[0].joint) == (None, None)
        assert all(link.mass > 0 and link.shapes for link in obj.links)
        for number, link in enumerate(obj.links[1:], 1):
            assert link.parent in names[:number]
            assert link.joint is not None
            kind, limits = expected[link.joint.name]
            assert (link.joint.kind, np.linalg.norm(link.joint.axis)) == (kind, pytest.approx(1.0))
            assert link.joint.limits == pytest.approx(limits or link.joint.limits)
        final, key = make_mechanism(obj).joints
        assert {final, key} == set(expected) == {link.joint.name for link in obj.links if link.joint}
        assert 0.0 == obj.joint(final).limits[0] < obj.joint(final).limits[1]
        lower, upper = obj.joint(key).limits
        assert lower == (-upper if obj.joint(key).kind == "revolute" else 0.0) < upper
        assert infeasible(obj) is None


@every_category
def test_what_collides_is_convex_with_faces_outward(category: str) -> None:
    for obj in objects(category):
        for shape in (shape for link in obj.links for shape in link.shapes):
            rotation = shape.pose_in_link[:3, :3]
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
            assert np.linalg.det(rotation) == pytest.approx(1.0)
            assert all(value > 0 for value in shape.size)
            if shape.vertices is not None:
                assert np.isfinite(shape.vertices).all()
            if shape.vertices is not None and shape.collides:
                most = {"bottle": 64, "pen": 64, "lamp": 255}.get(category, 288)
                assert len(shape.vertices) <= most, "a solid takes no more"
                assert np.ptp(shape.vertices, axis=0).min() > 0.0009, "PhysX invents contacts with what is hair-thin"
                normals, offsets = face_planes(shape)
                assert np.all(shape.vertices @ normals.T <= offsets + 1e-5)


@every_category
def test_it_stands_on_the_floor_within_its_size_which_is_that_of_such_a_thing(category: str) -> None:
    kind = KINDS[category]
    for obj in objects(category):
        width, depth, height = obj.size
        if object_split(obj.object_id) != "novel":
            assert all(low <= side <= high for side, (low, high) in zip(obj.size, kind.size, strict=True)), obj.size
        points = filling(obj, obj.links[0].name, 0.02)
        assert np.abs(points[:, 1]).max() <= width / 2 + 1e-3
        assert -1e-6 <= points[:, 2].min() < 0.021
        assert points[:, 2].max() <= height + 0.005
        assert -depth - 1e-3 <= points[:, 0].min()
        assert points[:, 0].max() <= kind.front


def lines(part: PartAnnotation, category: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Each good grasp of a part, and points between its open fingers."""
    heights = (-0.008, 0.0, 0.005) if category in ("bottle", "pen") else (0.0,)
    across = np.linspace(-HALF_OPENING, HALF_OPENING, 321)[:, None]
    poses = [part.rolled(roll).grasp for roll in part.rolls]
    return [(pose, pose[:3, 3] + across * pose[:3, 1] + (0, 0, height)) for pose in poses for height in heights]


@every_category
def test_fingers_hold_a_part_alone_and_an_open_hand_clears_everything(category: str) -> None:
    for obj in objects(category):
        for name, (link, (thinnest, thickest)) in KINDS[category].grips.items():
            part = obj.part(name)
            for pose, line in lines(part, category):
                np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
                assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
                held = solid(obj, line)
                assert held[160]
                assert np.array_equal(held, solid(obj, line, links={link}))
                assert thinnest <= 0.00025 * held.sum() <= thickest
            from_above = pose[2, 2] < -0.99
            assert from_above or pose[0, 2] < -0.99
            if category != "lamp":
                for roll in part.rolls:
                    points = hand(part.rolled(roll).grasp, retreat=0.0 if from_above else 0.1)
                    assert not solid(obj, points, 0.0015).any()


@every_category
def test_a_hand_that_moves_the_key_and_opens_it_meets_nothing(category: str) -> None:
    kind = KINDS[category]
    for obj in objects(category, step=3):
        final, key = make_mechanism(obj).joints
        for name in kind.grips:
            part = obj.part(name)
            carried = [motion.joint for motion in part.motions]
            knob = len(part.rolls) > 2 and category in ("door", "window")
            apart = 0.028 if knob else kind.apart
            limits = obj.joint(key).limits if key in carried and category != "lamp" else (0.0, 0.0)
            still = {obj.links[0].name, obj.links[1].name} - {kind.grips[name][0]}
            for turn in np.linspace(*limits, 5):
                for share in (0.0, 0.15, 0.45) if final in carried and category != "lamp" else (0.0,):
                    positions = {key: float(turn), final: share * obj.joint(final).limits[1]}
                    pose = part.moved(positions)
                    assert not solid(
                        obj, hand(pose, apart), 0.001, links=still if share == 0.0 else {obj.links[0].name}
                    ).any()


@every_category
def test_nothing_that_moves_meets_what_stands_still(category: str) -> None:
    for obj in objects(category, step=3):
        by_name = {link.name: link for link in obj.links}
        for link in obj.links[1:]:
            assert link.joint is not None
            part = next(part for part in obj.parts if link.joint.name in [motion.joint for motion in part.motions])
            own = PartAnnotation(link.name, np.eye(4), (part.motion(link.joint.name),))
            carried = {each.name for each in obj.links if link in chain(by_name, each.name)}
            points = [filling(obj, name, 0.012 if name in ("leaf", "sash") else 0.005) for name in sorted(carried)]
            assert sum(map(len, points)) > 20
            for position in np.linspace(*link.joint.limits, 9):
                pose = own.moved({link.joint.name: float(position)})
                there = np.concatenate(points) @ pose[:3, :3].T + pose[:3, 3]
                assert not solid(obj, there, -5e-4, links=set(by_name) - carried).any(), (obj.object_id, link.name)


def chain(links: dict[str, Any], name: str) -> list[Any]:
    """A link and all that carry it."""
    link = links[name]
    return [link, *(chain(links, link.parent) if link.parent else ())]


@pytest.mark.parametrize("category", ["safe", "microwave", "door", "window"])
def test_a_positive_angle_brings_the_handle_out_on_a_radius_that_an_arm_swings(category: str) -> None:
    for obj in objects(category):
        final = make_mechanism(obj).joints[0]
        part = next(part for part in obj.parts if final in [motion.joint for motion in part.motions])
        hinge = part.motion(final).point
        assert obj.joint(final).axis[2] == np.sign(hinge[1])
        path = [part.moved({final: float(angle)})[:3, 3] for angle in np.linspace(0, 1.2, 13)]
        assert np.all(np.diff([at[0] for at in path]) > 0)
        assert 0.17 < np.linalg.norm((part.grasp[:3, 3] - hinge)[:2]) < 0.42


MIRRORED = {"safe": "knob", "lamp": "knob", "coffee_maker": "portafilter", "pressure_cooker": "lid"}


@pytest.mark.parametrize("category", MIRRORED)
def test_what_turns_favours_no_direction(category: str) -> None:
    for obj in objects(category):
        link = named(obj, MIRRORED[category])
        reach = 1.037 * np.abs(filling(obj, link.name, 0.01) - link_origin(obj, link)).max()
        points = box_points((-reach, -reach, -reach), (reach, reach, reach), reach / 12)
        # The safety plug stands to one side on every cooker; spouts come in pairs.
        shapes = [
            shape for shape in link.shapes if category != "pressure_cooker" or abs(shape.pose_in_link[1, 3]) < 1e-9
        ]
        one, other = (np.any([contains(shape, at) for shape in shapes], axis=0) for at in (points, points * (1, -1, 1)))
        assert one.any()
        assert np.array_equal(one, other)
