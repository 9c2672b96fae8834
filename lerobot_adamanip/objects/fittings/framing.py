"""Wall pieces with an opening, casing and hinges, for doors and windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.shapes import box, chamfered_box, mark, rod

GAP = 0.005
"""Gap between a leaf and its frame [m]; the back edge needs it when the leaf swings out."""
FINISHES = ("plaster", "boarding", "brick")
BRICK, COURSE, BOARD = 0.125, 0.042, 0.055
"""Length and height of a brick and height of a board, with their joints [m]."""


@dataclass(frozen=True)
class Surround:
    """A piece of wall [m]. Its front is the plane x = 0, its middle is y = 0, z is up from the floor.

    Attributes:
        width, height, depth: width, height and depth of the wall.
        left, right: y of the opening's edges.
        bottom, top: z of the opening's edges; a bottom of 0 means no wall below.
        casing: width of the casing around the opening.
        proud: thickness of the casing in front of the wall.
        finish: one of `FINISHES`.
        wall, trim: materials.
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
        """Returns wall, lining and casing in the object's frame; all collide."""
        return self._wall() + self._casing() + self._finish()

    def _blocks(self) -> list[tuple[float, float, float, float]]:
        """Returns (y from, y to, z from, z to) of the wall's blocks; the lining belongs to the casing."""
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
        """Returns the members that line the opening and protrude in front of the wall."""
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
        """Returns the joints between boards or bricks, as thin lines on the wall's front; decoration."""
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
    """Returns (y, z) of the vertical joints' middles in a brick wall block with running bond."""
    places = []
    for row in range(int(np.ceil(z0 / COURSE - 0.01)), int(z1 / COURSE)):
        offset = 0.5 * BRICK * (row % 2)
        first, last = np.ceil((y0 + 0.01 - offset) / BRICK), np.floor((y1 - 0.01 - offset) / BRICK)
        places += [(n * BRICK + offset, (row + 0.5) * COURSE) for n in range(int(first), int(last) + 1)]
    return places


def knuckles(y: float, heights: tuple[float, ...], half: float, metal: Material) -> list[Shape]:
    """Returns hinge pins on the casing at ``y``; each extends ``half`` [m] to both sides of its height."""
    return [rod((0.012, y, z - half), (0.012, y, z + half), 0.0065, metal) for z in heights]
