"""What holds for every object whose cap is turned loose and lifted off from above."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import box_points, contains, face_planes, link_origin, solid

from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.objects import ArticulatedObject

HALF_OPENING, FINGER_DEPTH, FINGER_HALF_WIDTH = 0.04, 0.014, 0.0105
"""Of open fingers: opening (8 cm in all), thickness and half width [m]."""
PAST_GRASP, PALM = 0.0095, 0.055
"""How far fingers reach past the point between their pads, and how far behind it the hand's body begins [m]."""
HAND_HALF_WIDTH, HAND_HALF_THICKNESS = 0.102, 0.033


def hand_points(grasp: np.ndarray) -> np.ndarray:
    """Points filling the open fingers of a hand at a grasp, and the lower face of its body."""
    fingers = [
        box_points((-FINGER_HALF_WIDTH, near, -PALM), (FINGER_HALF_WIDTH, near + FINGER_DEPTH, PAST_GRASP), 0.01)
        for near in (-HALF_OPENING - FINGER_DEPTH, HALF_OPENING)
    ]
    palm = box_points(
        (-HAND_HALF_THICKNESS, -HAND_HALF_WIDTH, -PALM), (HAND_HALF_THICKNESS, HAND_HALF_WIDTH, -PALM), 0.012
    )
    return np.concatenate([*fingers, palm]) @ grasp[:3, :3].T + grasp[:3, 3]


def check_size(obj: ArticulatedObject) -> None:
    """What is solid lies in the bounding box, which stands behind the origin, and fills it."""
    points = []
    for link in obj.links:
        for shape in (shape for shape in link.shapes if shape.collides):
            if shape.vertices is not None:
                corners = shape.vertices.astype(np.float64)
            elif shape.kind == "box":
                corners = np.asarray(shape.size) * [[-1, -1, -1], [1, 1, 1]]
            else:
                radius, half = shape.size
                corners = np.array([[s * (half + radius), t * radius, 0] for s in (-1, 1) for t in (-1, 1)])
            points.append(corners @ shape.pose_in_link[:3, :3].T + shape.pose_in_link[:3, 3] + link_origin(obj, link))
    everything = np.concatenate(points)
    width, depth, height = obj.size
    lower, upper = everything.min(axis=0), everything.max(axis=0)
    assert np.all(lower >= (-depth - 1e-3, -width / 2 - 1e-3, -1e-6))
    assert np.all(upper <= (1e-3, width / 2 + 1e-3, height + 1e-6))
    np.testing.assert_allclose(upper[2], height, atol=0.0085)  # but for decoration on top
    np.testing.assert_allclose(upper[0] - lower[0], depth, rtol=0.09)  # solids are inside what is seen


def above(obj: ArticulatedObject, height: float) -> ArticulatedObject:
    """The object without the solids that end below ``height`` [m]: nothing at the cap comes near them."""
    links = []
    for link in obj.links:
        low = height - link_origin(obj, link)[2]
        kept = [
            shape
            for shape in link.shapes
            if shape.vertices is None or shape.vertices[:, 2].max() + shape.pose_in_link[2, 3] > low
        ]
        links.append(replace(link, shapes=tuple(kept)))
    return replace(obj, links=tuple(links))


def check_shapes(obj: ArticulatedObject) -> None:
    """What collides is convex with its faces outward; decoration has finite corners."""
    for shape in (shape for link in obj.links for shape in link.shapes):
        rotation = shape.pose_in_link[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert all(value > 0 for value in shape.size)
        if shape.kind == "mesh":
            assert shape.vertices is not None
            assert np.isfinite(shape.vertices).all()
        if shape.kind == "mesh" and shape.collides:
            assert len(shape.vertices) <= 64, "SAPIEN would leave out corners of its own choice"
            assert np.ptp(shape.vertices, axis=0).min() > 0.0009, "PhysX invents contacts with what is hair-thin"
            normals, offsets = face_planes(shape)
            assert np.all(shape.vertices @ normals.T <= offsets + 1e-6)
            assert contains(shape, shape.pose_in_link[None, :3, 3])[0]


def check_cap_and_joints(obj: ArticulatedObject) -> None:
    """A body, a lift on it, a cap on that; both joints along one vertical axis; the cap turns as far either way."""
    assert [(link.name, link.parent) for link in obj.links] == [("body", None), ("plug", "body"), ("cap", "plug")]
    assert all(link.mass > 0 and link.shapes for link in obj.links)
    lift, cap = obj.joint("lift"), obj.joint("cap")
    assert (lift.kind, cap.kind) == ("prismatic", "revolute")
    assert lift.limits == (0.0, pytest.approx(0.05))
    assert cap.limits[0] == -cap.limits[1]
    assert lift.axis == cap.axis == (0, 0, 1)
    part = obj.part("cap")
    assert [motion.joint for motion in part.motions] == ["lift", "cap"]
    for motion in part.motions:
        np.testing.assert_allclose(np.cross(part.grasp[:3, 3] - motion.point, motion.axis), 0, atol=1e-12)
    np.testing.assert_allclose(part.grasp[:3, 2], [0, 0, -1], atol=1e-12)


def check_grip(obj: ArticulatedObject, thinnest: float, thickest: float) -> None:
    """At every roll the pads close on the cap alone, over most of their height, and the open hand is clear."""
    part = obj.part("cap")
    obj = above(obj, part.grasp[2, 3] - 0.03)
    for roll in part.rolls:
        grasp = part.grasp @ transform(rotation=rotation_about((0, 0, 1), roll))
        for height in (-0.008, 0.0, 0.005):
            line = grasp[:3, 3] + np.linspace(-HALF_OPENING, HALF_OPENING, 321)[:, None] * grasp[:3, 1] + (0, 0, height)
            held = solid(obj, line)
            assert np.array_equal(held, solid(obj, line, links={"cap"}))
            assert thinnest - 0.002 <= 0.00025 * held.sum() <= thickest + 0.002
        assert not solid(obj, hand_points(grasp), 0.0015).any()
    # Whichever way the hand turns, nothing of the body comes up to its fingers.
    for turn in np.linspace(-2.35, 2.35, 9):
        turned = part.moved({"cap": float(turn)})
        assert not solid(obj, hand_points(turned), 0.0015, links={"body"}).any()


def check_turning_and_lifting(obj: ArticulatedObject) -> None:
    """No solid point of the cap is ever in the body."""
    obj = above(obj, obj.part("cap").grasp[2, 3] - 0.06)
    cap = obj.links[2]
    origin = link_origin(obj, cap)
    corners = [
        shape.vertices @ shape.pose_in_link[:3, :3].T + shape.pose_in_link[:3, 3]
        for shape in cap.shapes
        if shape.collides and shape.vertices is not None
    ]
    points = np.concatenate(corners)
    for turn in np.linspace(-2.35, 2.35, 9):
        turned = points @ rotation_about((0, 0, 1), turn).T + origin
        for lift in (0.0, 0.01, 0.05):
            assert not solid(obj, turned + np.array([0.0, 0.0, lift]), links={"body"}).any()
    assert points[:, 2].min() >= -1e-6
    grip = cap.shapes[0]
    assert grip.vertices is not None
    assert np.ptp(grip.vertices[:, 2]) > 0.016, "PhysX would part a thin slice from the fingers up or down"
