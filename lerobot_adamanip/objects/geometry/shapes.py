"""Shape builders shared by the generators: chamfered boxes, rods between points, prisms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from lerobot_adamanip.contract.rotations import rotation_about, rotation_with_x_along, transform
from lerobot_adamanip.objects.base import Material, Shape

_NO_AREA = 2e-14
"""Twice the area below which a facet counts as degenerate [m^2]."""


def box(center: ArrayLike, half: Sequence[float], material: Material, *, collides: bool = True) -> Shape:
    """Returns a sharp-edged box with the given centre and half extents [m]."""
    return Shape("box", tuple(float(h) for h in half), transform(center), material, collides)


def chamfered_box(
    center: ArrayLike, half: Sequence[float], chamfer: float, material: Material, *, collides: bool = True
) -> Shape:
    """Returns a box with edges cut by ``chamfer`` [m], which catch light as on a real product."""
    extent = np.asarray(half, dtype=np.float64)
    cut = min(chamfer, 0.45 * float(extent.min()))
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
    insets = np.concatenate([np.eye(3)]) * cut
    points = np.concatenate([signs * (extent - cut + inset) for inset in insets])
    return convex_mesh(points, transform(center), material, collides=collides)


def convex_mesh(
    points: NDArray[np.float64], pose_in_link: NDArray[np.float64], material: Material, *, collides: bool = True
) -> Shape:
    """Returns the convex hull of points (P, 3) [m] as a mesh shape with outward faces."""
    vertices, faces = convex_hull(np.asarray(points, np.float64))
    return Shape("mesh", (), pose_in_link, material, collides, vertices.astype(np.float32), faces.astype(np.int32))


def convex_hull(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Returns vertices (V, 3) and outward faces (F, 3) of the convex hull of points (P, 3), equal to trimesh's.

    An object has dozens of hulls. trimesh also measures each one and takes ten times as long.
    """
    hull = ConvexHull(points, qhull_options="QbB Pp Qt")
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    real = np.linalg.norm(normals, axis=1) > _NO_AREA
    inward = np.einsum("fi,fi->f", normals, hull.equations[:, :3]) < 0  # Qhull has no fixed winding
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)[real]
    kept = np.sort(hull.vertices)
    return points[kept], np.searchsorted(kept, faces)


def prism(
    center: ArrayLike, radius: float, half_length: float, sides: int, material: Material, *, top: float = 1.0
) -> Shape:
    """Returns a prism about x with two faces perpendicular to y. ``top`` scales its far end (a taper)."""
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    ring = radius / np.cos(np.pi / sides) * np.stack([np.zeros(sides), np.cos(angles), np.sin(angles)], axis=-1)
    points = np.concatenate([ring - (half_length, 0, 0), ring * top + (half_length, 0, 0)])
    return convex_mesh(points, transform(center), material)


def rod(start: ArrayLike, end: ArrayLike, radius: float, material: Material, *, round_ends: bool = True) -> Shape:
    """Returns a capsule (or cylinder) of ``radius`` [m] between two points."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(last - first))
    pose = transform((first + last) / 2, rotation_with_x_along(last - first))
    return Shape("capsule" if round_ends else "cylinder", (radius, length / 2), pose, material)


def ball_bar(
    grip: Sequence[float], half: float, radii: tuple[float, float, float], material: Material
) -> tuple[Shape, ...]:
    """Returns an upright handle in front of x = 0 with a ball at each end: ``radii`` of bar, balls and stems [m]."""
    x, y, z = grip
    bar, ball, stem = radii
    tips = [np.array([x, y, z + side * half]) for side in (-1, 1)]
    balls = [rod(tip, tip - (0, 0, 5e-4), ball, material) for tip in tips]
    stems = [rod((0.0, y, tip[2]), tip, stem, material) for tip in tips]
    return (rod(tips[0], tips[1], bar, material), *balls, *stems)


def disk(
    center: ArrayLike, radius: float, half_thickness: float, material: Material, *, collides: bool = True
) -> Shape:
    """Returns a cylinder about x (facing out of an object's front)."""
    return Shape("cylinder", (radius, half_thickness), transform(center), material, collides)


mark, dot = partial(box, collides=False), partial(disk, collides=False)
"""Box and disk without collision."""


def without_collision(shapes: Sequence[Shape]) -> tuple[Shape, ...]:
    """Returns the shapes without collision."""
    return tuple(replace(shape, collides=False) for shape in shapes)


def moved(shapes: Sequence[Shape], pose: NDArray[np.float64]) -> tuple[Shape, ...]:
    """Returns the shapes moved by ``pose`` (4, 4) in their link's frame."""
    return tuple(replace(shape, pose_in_link=pose @ shape.pose_in_link) for shape in shapes)


def rotated(shapes: Sequence[Shape], axis: tuple[float, float, float], angle: float) -> tuple[Shape, ...]:
    """Returns the shapes rotated by ``angle`` [rad] about an axis through their link's origin."""
    return moved(shapes, transform(rotation=rotation_about(axis, angle)))
