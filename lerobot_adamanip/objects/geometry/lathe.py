"""Bodies of revolution about a vertical axis: profiles of rings become convex frusta, with decoration on them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.shapes import convex_mesh

Array = NDArray[np.float64]
Curves = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
"""Outline of a picture on a surface [m]: (N,) increasing positions along the circumference, from the middle, and (N,)
heights of its lower and upper edge."""
SIDES, SOLID_SIDES, GRIP_SIDES = 48, 16, 32
"""Number of sides of visible bodies, of the solids inside, and of gripped solids. With fewer, wider faces, fingers
would turn from one face to the next while the part is blocked."""
LEAST_SOLID = 0.009
"""Minimum height of a solid, if the profile is high enough [m]."""
PROUD = 0.0004
"""Distance of decoration from its surface [m]: sufficient for a depth buffer, invisible to the eye."""


@dataclass(frozen=True)
class Ring:
    """A horizontal cross section.

    Attributes:
        height: position along z [m].
        radius: half width along y [m].
        depth: extent along x divided by the extent along y; 1 is round.
        squareness: 0 for an ellipse, 1 for almost a rectangle.
    """

    height: float
    radius: float
    depth: float = 1.0
    squareness: float = 0.0

    def point(self, angle: ArrayLike, proud: float = 0.0) -> Array:
        """Returns outline points (..., 3) at angles from +x [rad], moved outwards by ``proud`` [m]."""
        angle = np.asarray(angle, dtype=np.float64)
        return _outline(self.height, (self.radius, self.depth, self.squareness), angle, proud)


def _outline(height: ArrayLike, section: Sequence[ArrayLike], angle: Array, proud: float) -> Array:
    """Returns points (..., 3) at heights [m] and angles (...) [rad]; ``section``: radius, depth and squareness."""
    radius, depth, squareness = (np.asarray(values, np.float64) for values in section)
    power = 2.0 + 6.0 * squareness
    cosine, sine = np.cos(angle), np.sin(angle)
    reach = (np.abs(cosine) ** power + np.abs(sine) ** power) ** (-1.0 / power)
    x = (radius * depth + proud) * reach * cosine
    y = (radius + proud) * reach * sine
    return np.stack([x, y, np.broadcast_to(height, x.shape)], axis=-1)


def ring_at(rings: Sequence[Ring], height: float) -> Ring:
    """Returns the cross section of a profile at ``height`` [m], interpolated between its rings."""
    radius, depth, squareness = (float(value) for value in _section_at(rings, height))
    return Ring(height, radius, depth, squareness)


def _section_at(rings: Sequence[Ring], height: Array | float) -> list[Array]:
    """Returns radius, depth and squareness of a profile at heights [m], in the shape of the heights."""
    heights = [ring.height for ring in rings]
    values = [[ring.radius, ring.depth, ring.squareness] for ring in rings]
    return [np.asarray(np.interp(np.asarray(height), heights, column)) for column in zip(*values, strict=True)]


def turned(
    rings: Sequence[Ring],
    paint: Material | Callable[[float], Material],
    *,
    axis: tuple[float, float] = (0.0, 0.0),
    sides: int = SIDES,
    collides: bool = True,
) -> tuple[Shape, ...]:
    """Returns a frustum between each pair of neighbouring rings, and the solids inside them.

    Visible frusta do not collide. PhysX separates contacts along the shortest way, which for a thin slice is vertical,
    and reports false deep contacts for very thin slices. SAPIEN also keeps only 64 corners of a convex shape, of its
    own choice.

    Args:
        rings: profile, from bottom to top.
        paint: material, or a function of the height [m] that returns one.
        axis: (x, y) of the axis in the link's frame [m].
        sides: number of sides of a ring's polygon.
        collides: whether to add solids.
    """
    slices = [(*pair, sides, False) for pair in itertools.pairwise(rings) if pair[1].height - pair[0].height > 1e-6]
    slices += [(*pair, SOLID_SIDES, True) for pair in _inscribed(rings)] if collides else []
    shapes = []
    for lower, upper, count, solid in slices:
        material = paint((lower.height + upper.height) / 2) if callable(paint) else paint
        shapes.append(_frustum(lower, upper, count, material, axis, collides=solid))
    return tuple(shapes)


def _frustum(
    lower: Ring, upper: Ring, sides: int, material: Material, axis: tuple[float, float], *, collides: bool
) -> Shape:
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    middle = (lower.height + upper.height) / 2
    points = np.concatenate([lower.point(angles), upper.point(angles)]) - (0.0, 0.0, middle)
    return convex_mesh(points, transform((*axis, middle)), material, collides=collides)


def _inscribed(rings: Sequence[Ring]) -> Iterator[tuple[Ring, Ring]]:
    """Yields pairs of rings with a minimum distance, whose frusta are inside the profile."""
    kept, top = [rings[0]], rings[-1]
    for ring in rings[1:-1]:
        if min(ring.height - kept[-1].height, top.height - ring.height) >= LEAST_SOLID:
            kept.append(ring)
    for lower, upper in itertools.pairwise([*kept, top]):
        height = upper.height - lower.height
        if height < LEAST_SOLID / 2:
            continue
        between = [ring for ring in rings if lower.height <= ring.height <= upper.height]
        straight = [lower.radius + (upper.radius - lower.radius) * (r.height - lower.height) / height for r in between]
        excess = PROUD + max(0.0, *(line - ring.radius for line, ring in zip(straight, between, strict=True)))
        yield replace(lower, radius=lower.radius - excess), replace(upper, radius=upper.radius - excess)


def grip_solid(lower: Ring, upper: Ring, material: Material) -> Shape:
    """Returns a solid for fingers: it has a flat face for every grasp of `any_roll`."""
    bottom, top = replace(lower, radius=lower.radius - PROUD), replace(upper, radius=upper.radius - PROUD)
    return _frustum(bottom, top, GRIP_SIDES, material, (0.0, 0.0), collides=True)


def fluted(
    bottom: float,
    top: float,
    radius: float,
    count: int,
    material: Material,
    *,
    groove: float = 0.0007,
    taper: float = 1.0,
) -> Shape:
    """Returns the ribs around a screw cap, as decoration: ``radius`` [m] of the rib backs, ``groove`` depth [m]."""
    angles = np.arange(4 * count) * 2 * np.pi / (4 * count)
    reach = np.where(np.arange(4 * count) % 4 < 2, radius, radius - groove)
    ring = np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=-1)
    lower = np.column_stack([ring, np.full(len(ring), bottom)])
    upper = np.column_stack([ring * taper, np.full(len(ring), top)])
    first = np.arange(len(ring))
    after = np.roll(first, -1)
    return _mesh(np.concatenate([lower, upper]), _quads(first, after, after + len(ring), first + len(ring)), material)


def decal(
    rings: Sequence[Ring],
    curves: Curves,
    material: Material,
    *,
    layer: int = 1,
    axis: tuple[float, float] = (0.0, 0.0),
) -> Shape:
    """Returns a picture on a turned surface, as decoration: a strip between two curves, wrapped around the surface.

    Args:
        rings: profile of the surface.
        curves: see `Curves`; `patch` and `oval` create some.
        material: look of the picture.
        layer: 1 is directly on the surface, 2 on layer 1, and so on.
        axis: (x, y) of the surface's axis in the link's frame [m].
    """
    across, lower, upper = curves
    rows = 9
    heights = lower + (upper - lower) * np.linspace(0.0, 1.0, rows)[:, None]
    # One angle per column keeps the edges of a picture vertical on a tapered bottle.
    angles = across / ring_at(rings, float(heights.mean())).radius
    points = _outline(heights, _section_at(rings, heights), np.broadcast_to(angles, heights.shape), layer * PROUD)
    index = np.arange(heights.size).reshape(heights.shape)
    corners = (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    faces = _quads(*(corner.reshape(-1) for corner in corners))
    return _mesh(points.reshape(-1, 3) + np.array([*axis, 0.0]), faces, material)


def patch(width: float, bottom: float, top: float, columns: int = 25) -> Curves:
    """Returns the curves of a rectangle, for `decal` [m]."""
    across = np.linspace(-width / 2, width / 2, columns)
    return across, np.full(columns, bottom), np.full(columns, top)


def oval(width: float, height: float, middle: float, *, sharp: bool = False) -> Curves:
    """Returns the curves of an ellipse (or, ``sharp``, a rhombus) around ``middle`` [m], for `decal`."""
    along = np.linspace(-1.0, 1.0, 25)
    half: Array = 0.5 * height * (1 - np.abs(along) if sharp else np.sqrt(np.maximum(0.0, 1 - along**2)))
    return along * width / 2, middle - half, middle + half


def _quads(a: NDArray[np.int64], b: NDArray[np.int64], c: NDArray[np.int64], d: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])


def _mesh(points: Array, faces: NDArray[np.int64], material: Material) -> Shape:
    vertices = np.ascontiguousarray(points, np.float32)
    return Shape("mesh", (), np.eye(4), material, False, vertices, np.ascontiguousarray(faces, np.int32))
