"""Novel objects differ in kind from seen ones, and seen and unseen ones stay exactly what they are."""

from __future__ import annotations

import hashlib
import re

import numpy as np
import pytest

from lerobot_adamanip.catalog import make_object, novel_objects, object_split, seen_objects, unseen_objects
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.mechanisms import infeasible
from lerobot_adamanip.objects import ArticulatedObject

every_category = pytest.mark.parametrize("category", CATEGORIES)
SAMPLE = {
    "bottle": "0887a6ae172210c1", "pen": "df2719d61e326103", "pressure_cooker": "62bc2f9691318e25",
    "coffee_maker": "2041ac7aefa58a66", "safe": "3b29419b1917209d", "microwave": "6e9281b107580112",
    "window": "9103cbc68c2e9b62", "door": "93cadf544dde6adc", "lamp": "85fc2c3b51a9fa24",
}  # fmt: skip
"""Digests of the first four seen, the last two seen and the first two unseen objects."""
WHOLE = {
    "bottle": "b4bacafa960866ae", "pen": "a88f23e7782256f6", "pressure_cooker": "fe2bda778073af17",
    "coffee_maker": "a1a649eace9a97e0", "safe": "51de70e86b32a07f", "microwave": "b4302b37a720ab42",
    "window": "89d3ad6d455dc777", "door": "59a23a897ae36f58", "lamp": "10c49382583b7872",
}  # fmt: skip
"""Digests of all seen objects and of the 20 first unseen ones."""
SHARED = {
    "safe": ("hinge left", "hinge right"), "window": ("hinge left", "hinge right", "plaster", "boarding", "brick"),
    "door": ("hinge left", "hinge right", "plaster", "boarding", "brick", "none"),
    "microwave": ("hinge left", "hinge right", "keypad", "dials", "touch", "retro"),
    "pen": ("bar clip", "arrow clip", "ball clip"),
    "bottle": ("fluted cap", "smooth cap", "dome cap", "beaker cap"),
    "coffee_maker": ("double spout", "single spout", "bottomless spout"), "window layouts": (),
}  # fmt: skip
"""Words that novel objects may share with seen ones: what they are made of is new, the rest need not be."""


def digest(obj: ArticulatedObject) -> str:
    """A digest of all that an object consists of, to 10 micrometres: equal wherever it is made."""
    made = hashlib.sha256()

    def add(*values: object) -> None:
        for value in values:
            if isinstance(value, str | bool | int) or value is None:
                made.update(f"{value};".encode())
            else:
                # Off the round numbers that people write: there a last bit would tip the scale.
                made.update(np.floor(1e5 * np.asarray(value, np.float64) + 0.2371).astype(np.int64).tobytes())

    add(obj.object_id, obj.category, obj.size, obj.description, True)
    for link in obj.links:
        add(link.name, link.mass, link.parent)
        if link.joint is not None:
            joint = link.joint
            add(joint.name, joint.kind, joint.axis, joint.origin, joint.limits, joint.damping, joint.stiffness)
            add(joint.rest)
        for shape in link.shapes:
            add(shape.kind, shape.size, shape.pose_in_link, shape.collides, shape.visible)
            add(shape.material.color, shape.material.roughness, shape.material.metallic)
            if shape.vertices is not None:
                add(len(shape.vertices), np.sort(shape.vertices, axis=0))
    for part in obj.parts:
        add(part.name, part.grasp, part.rolls)
        for motion in part.motions:
            add(motion.joint, motion.kind, motion.point, motion.axis)
    return made.hexdigest()


def joint_digest(names: list[str]) -> str:
    """One digest of several objects."""
    return hashlib.sha256("".join(digest(make_object(name)) for name in names).encode()).hexdigest()[:16]


def sample_of(category: str) -> list[str]:
    """The objects of `SAMPLE`."""
    seen, unseen = seen_objects(category), unseen_objects(category)
    return [*seen[:4], *seen[-2:], *unseen[:2]]


@every_category
def test_seen_and_unseen_objects_stay_what_they_are(category: str) -> None:
    assert joint_digest(sample_of(category)) == SAMPLE[category]


@pytest.mark.nightly
@every_category
def test_all_seen_and_unseen_objects_stay_what_they_are(category: str) -> None:
    assert joint_digest([*seen_objects(category), *unseen_objects(category)]) == WHOLE[category]


@every_category
def test_a_novel_object_is_made_the_same_by_its_id_and_can_be_opened(category: str) -> None:
    names = novel_objects(category)
    objects = [make_object(name) for name in names]
    assert [obj.object_id for obj in objects] == list(names)
    assert {object_split(obj.object_id) for obj in objects} == {"novel"}
    make_object.cache_clear()
    assert digest(make_object(names[3])) == digest(objects[3])
    assert len({digest(obj) for obj in objects}) == len(objects)
    assert all(infeasible(obj) is None for obj in objects)
    like = make_object(seen_objects(category)[0])
    joints = [link.joint.name for link in like.links if link.joint]
    for obj in objects:
        assert [part.name for part in obj.parts] == [part.name for part in like.parts]
        assert [link.joint.name for link in obj.links if link.joint] == joints


def words(obj: ArticulatedObject) -> set[str]:
    """What a description says, apart from what novel objects may share."""
    told = re.split(r", ", obj.description)
    return {word for word in told if word not in SHARED.get(obj.category, ()) and not word.startswith("bars")}


@every_category
def test_no_seen_object_is_of_a_novel_object_s_kind(category: str) -> None:
    layouts = {"single", "side light", "transom"}
    seen = set().union(*(words(make_object(name)) for name in seen_objects(category)))
    for name in novel_objects(category):
        new = words(make_object(name)) - layouts
        assert new, name
        assert not new & seen, f"{name}: {new & seen}"
