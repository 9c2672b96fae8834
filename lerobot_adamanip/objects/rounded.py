"""Builders of rounded things: plates with round corners, bodies turned on a lathe, hollow shells. All pieces convex."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.shapes import convex_mesh
from lerobot_adamanip.rotations import rotation_about, transform

_QUARTER = np.linspace(0, np.pi / 2, 9)
_FRONT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Takes a plate's (across, up, out) to (y, z, x): it stands, and faces out of an object's front."""


def slab(
    center: ArrayLike, half: Sequence[float], radius: float, material: Material, *, bevel: float = 0.0,
    collides: bool = True,
) -> Shape:  # fmt: skip
    """A lying plate: corners rounded about z by ``radius``, upper rim cut by ``bevel``, half extents x, y, z [m]."""
    points = _rounded(half, radius, bevel)
    return convex_mesh(points, transform(center), material, collides=collides)


def plate(
    center: ArrayLike, half: Sequence[float], radius: float, material: Material, *, bevel: float = 0.0,
    collides: bool = True,
) -> Shape:  # fmt: skip
    """A standing plate, the twin of `slab`: corners rounded about x, the front rim cut, half extents x, y, z [m]."""
    points = _rounded((half[1], half[2], half[0]), radius, bevel) @ _FRONT.T
    return convex_mesh(points, transform(center), material, collides=collides)


def _rounded(half: Sequence[float], radius: float, bevel: float) -> NDArray[np.float64]:
    """Corner points (P, 3) of a plate in the xy plane whose upper rim is cut."""
    outline = _outline(half[0], half[1], radius)
    rim = _outline(half[0] - bevel, half[1] - bevel, max(radius - bevel, 1e-4))
    layers = [(outline, -half[2]), (outline, half[2] - bevel), (rim, half[2])]
    return np.concatenate([np.column_stack([points, np.full(len(points), z)]) for points, z in layers])


def _outline(half_x: float, half_y: float, radius: float) -> NDArray[np.float64]:
    cut = min(radius, 0.999 * min(half_x, half_y))
    arc = cut * np.stack([np.cos(_QUARTER), np.sin(_QUARTER)], axis=-1)
    corner = arc + np.array([half_x - cut, half_y - cut])
    return np.concatenate([corner * sign for sign in ((1, 1), (-1, 1), (-1, -1), (1, -1))])


def lathe(
    center: ArrayLike, profile: Sequence[tuple[float, float]], material: Material, *, sides: int = 32,
    collides: bool = True,
) -> Shape:  # fmt: skip
    """The convex hull of a profile of (radius, height) pairs [m] turned about z."""
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=-1)
    points = np.concatenate([ring * radius + (0, 0, z) for radius, z in profile])
    return convex_mesh(points, transform(center), material, collides=collides)


def shell(
    center: ArrayLike, profile: Sequence[tuple[float, float]], thickness: float, material: Material, *, sides: int = 40
) -> tuple[Shape, ...]:
    """A wall along a profile of (radius, height) pairs [m] turned about z: hollow, made of convex staves."""
    half_angle = np.pi / sides
    pieces = []
    for (r0, z0), (r1, z1) in pairwise(profile):
        corners = [
            (r * np.cos(angle), r * np.sin(angle), z)
            for r, z in ((r0, z0), (r1, z1), (r0 - thickness, z0), (r1 - thickness, z1))
            for angle in (-half_angle, half_angle)
        ]
        stave = convex_mesh(np.asarray(corners), np.eye(4), material)
        # One mesh in many poses: it is written, and loaded, once.
        pieces += [
            replace(stave, pose_in_link=transform(center, rotation_about((0, 0, 1), 2 * half_angle * k)))
            for k in range(sides)
        ]
    return tuple(pieces)
