"""Laws of what hangs on hinges and is opened by a handle that turns: doors and windows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from solids import box_points, contains, face_planes, link_origin, solid

from lerobot_adamanip.contract.rotations import rotated_about_line
from lerobot_adamanip.objects import ArticulatedObject, Link, PartAnnotation

FINGER_LENGTH, HALF_OPENING, FINGER_DEPTH, FINGER_HALF_WIDTH = 0.045, 0.04, 0.014, 0.0105
"""Free length of a finger behind the tool point, opening (8 cm in all), thickness and half width [m]."""
HAND_HALF_WIDTH, HAND_HALF_THICKNESS, HAND_BEHIND = 0.105, 0.034, 0.055
"""The hand's body: half extents along and across the fingers' motion, and how far behind the tool point it starts."""
PULLED = np.deg2rad(42.0)
"""How far the experts pull [rad]."""


def named(obj: ArticulatedObject, name: str) -> Link:
    """Returns a link."""
    return next(link for link in obj.links if link.name == name)


def hand(pose: np.ndarray, half_opening: float, retreat: float = 0.0) -> np.ndarray:
    """Points filling a hand with its fingers apart by twice ``half_opening``, and what it sweeps from ``retreat``."""
    points = [
        box_points(
            (-HAND_HALF_THICKNESS, -HAND_HALF_WIDTH, -0.15), (HAND_HALF_THICKNESS, HAND_HALF_WIDTH, -HAND_BEHIND), 0.012
        )
    ]
    for side in (-1, 1):
        near, far = sorted((side * half_opening, side * (half_opening + FINGER_DEPTH)))
        lower, upper = (-FINGER_HALF_WIDTH, near, -FINGER_LENGTH - retreat), (FINGER_HALF_WIDTH, far, 0.01)
        points.append(box_points(lower, upper, 0.006))
    return np.concatenate(points) @ pose[:3, :3].T + pose[:3, 3]


def filling(link: Link, step: float) -> np.ndarray:
    """Points (N, 3) in the solid shapes of a link, link frame."""
    points = []
    for shape in link.shapes:
        if shape.collides:
            if shape.vertices is not None:
                lower, upper = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
            else:
                upper = np.array(shape.size if shape.kind == "box" else (sum(shape.size), shape.size[0], shape.size[0]))
                lower = -upper
            grid = box_points(lower, upper, step) @ shape.pose_in_link[:3, :3].T + shape.pose_in_link[:3, 3]
            points.append(grid[contains(shape, grid)])
    return np.concatenate(points)


def moved(obj: ArticulatedObject, points: np.ndarray, part: PartAnnotation, positions: dict[str, float]) -> np.ndarray:
    """Points (N, 3) of the object's frame, carried along by the joints of a part."""
    pose = np.eye(4)
    for motion in reversed(part.motions):
        pose = rotated_about_line(pose, motion.point, motion.axis, positions.get(motion.joint, 0.0))
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def check_tree(obj: ArticulatedObject, final: str, key: str, key_range: float) -> None:
    """A frame, a leaf hinged to it at a vertical axis, a handle on the leaf; bodies weigh something."""
    frame, leaf, handle = obj.links
    assert (frame.parent, frame.joint) == (None, None)
    assert (leaf.parent, handle.parent) == (frame.name, leaf.name)
    assert leaf.joint is not None
    assert handle.joint is not None
    assert (leaf.joint.name, handle.joint.name) == (final, key)
    side = np.sign(leaf.joint.origin[1])
    assert leaf.joint.axis == (0.0, 0.0, side)
    assert leaf.joint.limits[0] == 0.0
    assert handle.joint.axis == (-1.0, 0.0, 0.0)
    assert handle.joint.limits == (-key_range, key_range)
    assert all(link.mass > 0 and link.shapes for link in obj.links)


def check_shapes(obj: ArticulatedObject) -> None:
    """Convex, with faces outward."""
    for shape in (shape for link in obj.links for shape in link.shapes):
        rotation = shape.pose_in_link[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert all(value > 0 for value in shape.size)
        if shape.kind == "mesh":
            assert shape.vertices is not None
            normals, offsets = face_planes(shape)
            assert np.all(shape.vertices @ normals.T <= offsets + 1e-6)


def check_inside_size(obj: ArticulatedObject) -> None:
    """The frame stands on the floor within the object's size; its front is at x = 0 but for casing and sill."""
    width, depth, height = obj.size
    points = filling(obj.links[0], 0.02)
    assert np.abs(points[:, 1]).max() <= width / 2 + 1e-6
    assert -1e-6 <= points[:, 2].min() < 0.02
    assert points[:, 2].max() <= height + 1e-6
    assert points[:, 0].min() >= -depth - 1e-6
    assert points[:, 0].max() < 0.045


def check_grasp(obj: ArticulatedObject, name: str, link: str) -> None:
    """The grasp lies in the part, the fingers close on it alone, and the open hand clears all else on its way."""
    grasp = obj.part(name).grasp
    np.testing.assert_allclose(grasp[:3, :3].T @ grasp[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(grasp[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(grasp[:3, 2], [-1, 0, 0], atol=1e-12)
    for roll in obj.part(name).rolls:
        pose = obj.part(name).rolled(roll).grasp
        line = pose[:3, 3] + np.linspace(-HALF_OPENING, HALF_OPENING, 161)[:, None] * pose[:3, 1]
        held = solid(obj, line)
        assert held[80]
        assert np.array_equal(held, solid(obj, line, links={link}))
        assert 0.012 < 0.0005 * held.sum() < 0.06
        assert not solid(obj, hand(pose, HALF_OPENING, retreat=0.1), 0.002).any()


def check_hand_is_free(obj: ArticulatedObject, name: str, final: str, key: str) -> None:
    """A hand that turns the part either way, and then swings the leaf, touches neither leaf nor frame."""
    part = obj.part(name)
    pivot = part.motion(key).point
    apart = 0.010 if np.linalg.norm(part.grasp[1:3, 3] - pivot[1:3]) > 0.03 else 0.028
    still = {link.name for link in obj.links[:2]}
    for turn in np.linspace(*obj.joint(key).limits, 7):
        assert not solid(obj, hand(part.moved({key: float(turn)}), apart), 0.002, links=still).any()
        for swing in (0.2, 0.45, PULLED):
            points = hand(part.moved({key: float(turn), final: swing}), apart)
            assert not solid(obj, points, 0.002, links={obj.links[0].name}).any()


def check_nothing_overlaps(obj: ArticulatedObject, name: str, final: str, key: str) -> None:
    """Leaf and handle stay out of the frame over the whole swing, the handle out of the leaf over its whole turn."""
    frame, leaf, handle = obj.links
    part = obj.part(name)
    upper = obj.joint(final).limits[1]
    leaf_points = filling(leaf, 0.012) + link_origin(obj, leaf)
    handle_points = filling(handle, 0.005) + link_origin(obj, handle)
    swung = PartAnnotation("leaf", np.eye(4), part.motions[:1])
    for angle in np.concatenate([[0.0, 0.01, 0.03, 0.06, 0.1], np.linspace(0.2, upper, 8)]):
        assert not solid(obj, moved(obj, leaf_points, swung, {final: float(angle)}), -1e-4, links={frame.name}).any()
    for turn in np.linspace(*obj.joint(key).limits, 9):
        turned = moved(obj, handle_points, part, {key: float(turn)})
        assert not solid(obj, turned, links={frame.name, leaf.name}).any()
        assert not solid(obj, moved(obj, turned, swung, {final: upper}), links={frame.name}).any()


def check_opening(obj: ArticulatedObject, name: str, final: str, reach: float) -> None:
    """A positive angle brings the handle out of the front, on a radius the arm can swing."""
    part = obj.part(name)
    path = [part.moved({final: float(angle)})[:3, 3] for angle in np.linspace(0, 1.2, 13)]
    assert all(after[0] > before[0] for before, after in pairwise(path))
    radius = np.linalg.norm((part.grasp[:3, 3] - part.motion(final).point)[:2])
    assert 0.2 < radius < reach
    assert abs(part.grasp[1, 3]) < 0.18


def check_balance(obj: ArticulatedObject) -> None:
    """The spring is tensioned against the weight of a handle that hangs to one side, and slack under any other."""
    handle = obj.links[2]
    assert handle.joint is not None
    assert handle.joint.stiffness > 0
    carried = -handle.joint.stiffness * handle.joint.rest / (handle.mass * 9.81)
    sideways = filling(handle, 0.004)[:, 1]
    middle = (sideways.min() + sideways.max()) / 2
    if abs(middle) < 0.01:
        assert abs(carried) < 0.01
    else:
        assert 0.3 < carried / middle < 1.2
