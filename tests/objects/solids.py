"""Points in solids and in a hand: what meets what, independent of any simulator."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from lerobot_adamanip.objects import ArticulatedObject, Link, Shape

HALF_OPENING = 0.04
"""Of open fingers [m]."""


def face_planes(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals (F, 3) and offsets (F,) of a mesh's faces."""
    assert shape.vertices is not None
    assert shape.faces is not None
    corners = shape.vertices[shape.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals, np.sum(normals * corners[:, 0], axis=1)


def contains(shape: Shape, points: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Which points (N, 3), in the link's frame, lie in the shape blown up by ``margin`` [m]."""
    local = (points - shape.pose_in_link[:3, 3]) @ shape.pose_in_link[:3, :3]
    if shape.kind == "box":
        return np.all(np.abs(local) <= np.asarray(shape.size) + margin, axis=1)
    if shape.kind == "mesh":
        normals, offsets = face_planes(shape)
        return np.all(local @ normals.T <= offsets + margin, axis=1)
    radius, half = shape.size
    beyond = np.abs(local[:, 0]) - half
    across = np.hypot(local[:, 1], local[:, 2])
    if shape.kind == "cylinder":
        return (beyond <= margin) & (across <= radius + margin)
    return np.hypot(np.maximum(beyond, 0), across) <= radius + margin


def box_points(lower: Any, upper: Any, step: float) -> np.ndarray:
    """A grid of points (N, 3) filling a box, its faces included."""
    axes = [np.linspace(a, b, max(2, int(np.ceil((b - a) / step)) + 1)) for a, b in zip(lower, upper, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def bounds(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,), (3,) of a box around a shape, in its own frame."""
    if shape.vertices is not None:
        return shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    upper = np.array(shape.size if shape.kind == "box" else (sum(shape.size), shape.size[0], shape.size[0]))
    return -upper, upper


def filling(obj: ArticulatedObject, name: str, step: float) -> np.ndarray:
    """Points (N, 3) in the solid shapes of a link, object frame, joints at zero."""
    link, points = named(obj, name), []
    for shape in link.shapes:
        if shape.collides:
            grid = box_points(*bounds(shape), step) @ shape.pose_in_link[:3, :3].T + shape.pose_in_link[:3, 3]
            points.append(grid[contains(shape, grid)])
    return np.concatenate([np.zeros((0, 3)), *points]) + link_origin(obj, link)


def named(obj: ArticulatedObject, name: str) -> Link:
    """Returns a link."""
    return next(link for link in obj.links if link.name == name)


def link_origin(obj: ArticulatedObject, link: Link) -> np.ndarray:
    """Where a link's frame is in the object's, joints at zero (all axes are parallel)."""
    origin = np.zeros(3)
    while link.joint is not None:
        origin = origin + link.joint.origin
        link = named(obj, str(link.parent))
    return origin


def solid(obj: ArticulatedObject, points: np.ndarray, margin: float = 0.0, *, links: Any = None) -> np.ndarray:
    """Which points (N, 3), in the object's frame with joints at zero, lie in a shape that collides."""
    inside = np.zeros(len(points), bool)
    for link in obj.links:
        if links is None or link.name in links:
            local = points - link_origin(obj, link)
            for shape in link.shapes:
                if shape.collides:
                    reach = float(np.linalg.norm(np.maximum(*map(np.abs, bounds(shape))))) + abs(margin)
                    near = np.linalg.norm(local - shape.pose_in_link[:3, 3], axis=1) <= reach
                    inside[near] |= contains(shape, local[near], margin)
    return inside


def hand(pose: np.ndarray, half_opening: float = HALF_OPENING, retreat: float = 0.0) -> np.ndarray:
    """Points filling a hand with its fingers apart by twice ``half_opening``, and what it sweeps from ``retreat``."""
    points = [box_points((-0.033, -0.102, -0.15), (0.033, 0.102, -0.055), 0.012)]
    for side in (-1, 1):
        near, far = sorted((side * half_opening, side * (half_opening + 0.014)))
        points.append(box_points((-0.0105, near, -0.045 - retreat), (0.0105, far, 0.009), 0.006))
    return np.concatenate(points) @ pose[:3, :3].T + pose[:3, 3]


def digest(obj: ArticulatedObject) -> str:
    """A digest of all that an object consists of, to 10 micrometres: equal wherever it is made."""
    made = hashlib.sha256()

    def add(value: Any) -> None:
        if isinstance(value, Shape):
            corners = None if value.vertices is None else np.sort(value.vertices, axis=0)
            value = replace(value, faces=None, vertices=corners)
        if is_dataclass(value):
            value = tuple(getattr(value, each.name) for each in fields(value))
        if isinstance(value, tuple):
            for each in value:
                add(each)
        elif isinstance(value, str | bool | int) or value is None:
            made.update(f"{value};".encode())
        else:
            # Off the round numbers that people write: there a last bit would tip the scale.
            made.update(np.floor(1e5 * np.asarray(value, np.float64) + 0.2371).astype(np.int64).tobytes())

    add(obj)
    return made.hexdigest()
