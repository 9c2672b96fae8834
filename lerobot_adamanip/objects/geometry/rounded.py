"""Rounded plates and boxes, bodies of revolution about z, and bars for fingers. All pieces are convex."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.contract.rotations import rotation_about, rotation_with_x_along, transform
from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.shapes import convex_mesh

SIDES, SMOOTH = 32, 48
"""Sides of a small and of a large body. Two rings of a small one have the 64 corners that SAPIEN keeps per solid."""
Extents = Sequence[float]
"""Half extents along x, y and z [m]."""
_QUARTER = np.linspace(0, np.pi / 2, 9)
_FRONT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation from a plate's (across, up, out) to (y, z, x): upright, facing out of an object's front."""


def slab(
    center: ArrayLike, half: Extents, radius: float, material: Material, *, bevel: float = 0.0, collides: bool = True
) -> Shape:
    """Returns a flat plate with half extents x, y, z [m]. ``radius`` rounds corners, ``bevel`` cuts the upper rim."""
    points = _rounded(half, radius, upper_bevel=bevel)
    return convex_mesh(points, transform(center), material, collides=collides)


def plate(
    center: ArrayLike, half: Extents, radius: float, material: Material, *, bevel: float = 0.0, collides: bool = True
) -> Shape:
    """Returns a vertical plate, like `slab`, with half extents x, y, z [m]; ``bevel`` cuts its front rim."""
    points = _rounded((half[1], half[2], half[0]), radius, upper_bevel=bevel) @ _FRONT.T
    return convex_mesh(points, transform(center), material, collides=collides)


def round_cornered(
    center: ArrayLike, half: Extents, radius: float, material: Material, *, bevel: float = 0.003, collides: bool = True
) -> Shape:
    """Returns a box with half extents x, y, z [m]. ``radius`` rounds its vertical edges, ``bevel`` cuts both rims."""
    radius = min(radius, 0.98 * min(half[0], half[1]))
    cut = min(bevel, 0.45 * half[2], 0.9 * radius)
    points = _rounded(half, radius, upper_bevel=cut, lower_bevel=cut)
    return convex_mesh(points, transform(center), material, collides=collides)


def _rounded(half: Extents, radius: float, *, upper_bevel: float, lower_bevel: float = 0.0) -> NDArray[np.float64]:
    """Returns the corner points (P, 3) of a plate in the xy plane with cut rims."""
    insets = [(lower_bevel, -half[2]), (0.0, half[2] - upper_bevel), (upper_bevel, half[2])]
    if lower_bevel:
        insets.insert(1, (0.0, lower_bevel - half[2]))
    layers = [(_outline(half[0] - cut, half[1] - cut, max(radius - cut, 1e-4)), z) for cut, z in insets]
    return np.concatenate([np.column_stack([points, np.full(len(points), z)]) for points, z in layers])


def _outline(half_x: float, half_y: float, radius: float) -> NDArray[np.float64]:
    """Returns a rectangle (36, 2) with quarter circles of 9 points at its corners."""
    cut = min(radius, 0.999 * min(half_x, half_y))
    arc = cut * np.stack([np.cos(_QUARTER), np.sin(_QUARTER)], axis=-1)
    corner = arc + np.array([half_x - cut, half_y - cut])
    return np.concatenate([corner * sign for sign in ((1, 1), (-1, 1), (-1, -1), (1, -1))])


def upright(
    center: ArrayLike, radius: float, half_height: float, material: Material, *, collides: bool = True
) -> Shape:
    """Returns a cylinder about z with the given centre [m]."""
    pose = transform(center, rotation_with_x_along((0.0, 0.0, 1.0)))
    return Shape("cylinder", (radius, half_height), pose, material, collides)


def bar(
    stations: Sequence[tuple[float, float, float, float]],
    material: Material,
    *,
    sides: int = 16,
    squareness: float = 1.0,
    collides: bool = True,
) -> Shape:
    """Returns a convex bar along x, with two faces perpendicular to y for the fingers.

    Args:
        stations: (x, z, half width along y, half height along z) [m] of each cross section.
        material: look of the bar.
        sides: number of sides of a cross section.
        squareness: 1 for an ellipse; 0.5 for a rectangle with round corners.
        collides: see `Shape`.
    """
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    unit = np.sign(unit) * np.abs(unit) ** squareness
    unit /= unit.max(axis=0)
    rings = []
    for x, z, half_width, half_height in stations:
        section = unit * (half_width, half_height) + (0.0, z)
        rings.append(np.column_stack([np.full(sides, x), section]))
    points = np.concatenate(rings)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return convex_mesh(points - middle, transform(middle), material, collides=collides)


def revolved(
    center: ArrayLike,
    profile: Sequence[tuple[float, float]],
    material: Material,
    *,
    sides: int = SIDES,
    collides: bool = True,
) -> Shape:
    """Returns the convex body of revolution about the z axis through ``center``, with outline (radius, height) [m]."""
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=-1)
    rings = [radius * circle + (0.0, 0.0, height) for radius, height in profile if radius > 0]
    tips = [np.array([[0.0, 0.0, height]]) for radius, height in profile if radius == 0]
    return convex_mesh(np.concatenate(rings + tips), transform(center), material, collides=collides)


def shell(
    center: ArrayLike, profile: Sequence[tuple[float, float]], thickness: float, material: Material, *, sides: int = 40
) -> tuple[Shape, ...]:
    """Returns a hollow wall: a profile of (radius, height) pairs [m] revolved about z, as convex staves."""
    half_angle = np.pi / sides
    pieces = []
    for (r0, z0), (r1, z1) in pairwise(profile):
        corners = [
            (r * np.cos(angle), r * np.sin(angle), z)
            for r, z in ((r0, z0), (r1, z1), (r0 - thickness, z0), (r1 - thickness, z1))
            for angle in (-half_angle, half_angle)
        ]
        stave = convex_mesh(np.asarray(corners), np.eye(4), material)
        # One mesh in many poses is written and loaded only once.
        pieces += [
            replace(stave, pose_in_link=transform(center, rotation_about((0, 0, 1), 2 * half_angle * k)))
            for k in range(sides)
        ]
    return tuple(pieces)
