"""Shape builders for round things: bodies of revolution about z, boxes with round corners, round bars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.shapes import convex_mesh
from lerobot_adamanip.rotations import rotation_with_x_along, transform

SMOOTH = 48
"""Sides of what only has to look round."""


def turned(
    center: ArrayLike,
    profile: Sequence[tuple[float, float]],
    material: Material,
    *,
    sides: int = SMOOTH,
    collides: bool = True,
) -> Shape:
    """The convex body of revolution about the z through ``center`` whose outline goes through (radius, height) [m]."""
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=-1)
    rings = [radius * circle + (0.0, 0.0, height) for radius, height in profile if radius > 0]
    tips = [np.array([[0.0, 0.0, height]]) for radius, height in profile if radius == 0]
    return convex_mesh(np.concatenate(rings + tips), transform(center), material, collides=collides)


def upright(
    center: ArrayLike, radius: float, half_height: float, material: Material, *, collides: bool = True
) -> Shape:
    """A cylinder about z by its centre [m]."""
    pose = transform(center, rotation_with_x_along((0.0, 0.0, 1.0)))
    return Shape("cylinder", (radius, half_height), pose, material, collides)


def round_cornered(
    center: ArrayLike, half: Sequence[float], corner: float, material: Material, *, bevel: float = 0.003,
    collides: bool = True,
) -> Shape:  # fmt: skip
    """A box with vertical edges rounded by ``corner`` and top and bottom edges cut by ``bevel`` [m]."""
    a, b, c = half
    corner = min(corner, 0.98 * min(a, b))
    bevel = min(bevel, 0.45 * c, 0.9 * corner)
    rings = []
    for z, inset in ((-c, bevel), (-c + bevel, 0.0), (c - bevel, 0.0), (c, bevel)):
        rings.append(np.column_stack([_outline(a, b, corner, inset), np.full(28, z)]))
    return convex_mesh(np.concatenate(rings), transform(center), material, collides=collides)


def _outline(a: float, b: float, corner: float, inset: float) -> NDArray[np.float64]:
    """A rectangle (28, 2) with quarter circles of 7 points at its corners."""
    points = []
    for quarter, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angles = np.pi / 2 * (quarter + np.linspace(0, 1, 7))
        arc = (corner - inset) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        points.append(arc + np.array([sx * (a - corner), sy * (b - corner)]))
    return np.concatenate(points)


def bar(
    stations: Sequence[tuple[float, float, float, float]],
    material: Material,
    *,
    sides: int = 16,
    squareness: float = 1.0,
    collides: bool = True,
) -> Shape:
    """A convex bar along x, with two faces square to y for the fingers.

    Args:
        stations: (x, z, half width along y, half height along z) [m] of each cross section.
        material: look.
        sides: of a cross section.
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
