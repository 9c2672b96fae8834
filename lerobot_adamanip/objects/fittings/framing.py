"""Pieces of wall with an opening, its casing and its hinges: what doors and windows hang in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.shapes import box, chamfered_box, mark, rod

GAP = 0.005
"""Between a leaf and its frame [m]: the back edge of a leaf that swings out needs a little."""
FINISHES = ("plaster", "boarding", "brick")
BRICK, COURSE, BOARD = 0.125, 0.042, 0.055
"""Length and height of a brick and height of a board, with their joints [m]."""


@dataclass(frozen=True)
class Surround:
    """A piece of wall [m]. Its front is the plane x = 0, y is 0 in its middle, z is up from the floor.

    Attributes:
        width, height, depth: of the wall.
        left, right: y of the opening's edges.
        bottom, top: z of the opening's edges; a bottom of 0 leaves no wall below.
        casing: width of the casing around the opening.
        proud: thickness of the casing on the wall.
        finish: one of `FINISHES`.
        wall, trim: looks.
    """

    width: float
    height: float
    depth: float
    left: float
    right: float
    bottom: float
    top: float
    casing: float
    proud: float
    finish: str
    wall: Material
    trim: Material

    def shapes(self) -> list[Shape]:
        """Returns wall, lining and casing: solid, in the object's frame."""
        return self._wall() + self._casing() + self._finish()

    def _blocks(self) -> list[tuple[float, float, float, float]]:
        """(y from, y to, z from, z to) of the wall's blocks, the lining being part of the casing."""
        left, right, edge = self.left - self.casing / 2, self.right + self.casing / 2, self.width / 2
        blocks = [
            (-edge, left, 0.0, self.height),
            (right, edge, 0.0, self.height),
            (left, right, self.top + self.casing / 2, self.height),
        ]
        if self.bottom > self.casing / 2:
            blocks.append((left, right, 0.0, self.bottom - self.casing / 2))
        return blocks

    def _wall(self) -> list[Shape]:
        shapes = []
        for y0, y1, z0, z1 in self._blocks():
            half = (self.depth / 2, (y1 - y0) / 2, (z1 - z0) / 2)
            shapes.append(box((-self.depth / 2, (y0 + y1) / 2, (z0 + z1) / 2), half, self.wall))
        return shapes

    def _casing(self) -> list[Shape]:
        """Members that line the opening through the wall and stand proud of it around the opening."""
        w, x = self.casing / 2, (self.proud - self.depth - 0.004) / 2
        depth = (self.depth + 0.004 + self.proud) / 2
        low = self.bottom - self.casing if self.bottom > 0 else 0.0
        high = self.top + self.casing
        members = [(y, (low + high) / 2, w, (high - low) / 2) for y in (self.left - w, self.right + w)]
        span = (self.right - self.left) / 2
        middle = (self.left + self.right) / 2
        members.append((middle, self.top + w, span, w))
        if self.bottom > 0:
            members.append((middle, self.bottom - w, span, w))
        return [chamfered_box((x, y, z), (depth, a, b), 0.003, self.trim) for y, z, a, b in members]

    def _finish(self) -> list[Shape]:
        """Joints between boards or courses, as thin lines on the wall's front; decoration."""
        if self.finish == "plaster":
            return []
        boarding = self.finish == "boarding"
        color = 0.55 * np.asarray(self.wall.color) if boarding else np.array((0.62, 0.60, 0.56))
        joint, course = Material(tuple(color), 0.95), BOARD if boarding else COURSE
        shapes = []
        for y0, y1, z0, z1 in self._blocks():
            for row in range(int(np.ceil(z0 / course + 0.01)), int(z1 / course - 0.01) + 1):
                half = (0.0012, (y1 - y0) / 2, 0.0022)
                shapes.append(mark((0.0, (y0 + y1) / 2, row * course), half, joint))
            if not boarding:
                for y, z in _butts(y0, y1, z0, z1):
                    shapes.append(mark((0.0, y, z), (0.0012, 0.0022, COURSE / 2), joint))
        return shapes


def _butts(y0: float, y1: float, z0: float, z1: float) -> list[tuple[float, float]]:
    """Where bricks of a course meet in running bond: (y, z) of the middles of upright joints in a block of wall."""
    places = []
    for row in range(int(np.ceil(z0 / COURSE - 0.01)), int(z1 / COURSE)):
        offset = 0.5 * BRICK * (row % 2)
        first, last = np.ceil((y0 + 0.01 - offset) / BRICK), np.floor((y1 - 0.01 - offset) / BRICK)
        places += [(n * BRICK + offset, (row + 0.5) * COURSE) for n in range(int(first), int(last) + 1)]
    return places


def knuckles(y: float, heights: tuple[float, ...], half: float, metal: Material) -> list[Shape]:
    """Returns hinge pins on the casing at ``y``, ``half`` [m] long to each side of each height."""
    return [rod((0.012, y, z - half), (0.012, y, z + half), 0.0065, metal) for z in heights]
