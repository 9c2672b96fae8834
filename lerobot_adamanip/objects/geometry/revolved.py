"""Bodies of revolution about z, from profiles of (radius, height): one convex piece, or a hollow wall of staves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.shapes import convex_mesh

SIDES, SMOOTH = 32, 48
"""Of a small body: two rings of them are the 64 corners that SAPIEN leaves a convex solid. Of a large one."""


def revolved(
    center: ArrayLike,
    profile: Sequence[tuple[float, float]],
    material: Material,
    *,
    sides: int = SIDES,
    collides: bool = True,
) -> Shape:
    """The convex body of revolution about the z through ``center`` whose outline goes through (radius, height) [m]."""
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=-1)
    rings = [radius * circle + (0.0, 0.0, height) for radius, height in profile if radius > 0]
    tips = [np.array([[0.0, 0.0, height]]) for radius, height in profile if radius == 0]
    return convex_mesh(np.concatenate(rings + tips), transform(center), material, collides=collides)


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
