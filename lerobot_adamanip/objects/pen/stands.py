"""Desk stands of pens. Frame: the object's; the pen's axis is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.lathe import Ring, turned
from lerobot_adamanip.objects.geometry.shapes import chamfered_box, mark

SOCKET_ROOM = 0.0012
"""Gap between a barrel and its socket [m]."""


@dataclass(frozen=True)
class Stand:
    """Parameters of a stand [m].

    Attributes:
        kind: a name of `STANDS`.
        width, depth, height: width, depth and height of its body.
        shift: offset of the pen from the middle along y.
        socket_height: height of the metal socket on top; 0 for a hole.
        body, socket, extra: materials.
    """

    kind: str
    width: float
    depth: float
    height: float
    shift: float
    socket_height: float
    body: Material
    socket: Material
    extra: Material

    @property
    def axis(self) -> tuple[float, float]:
        """Position of the pen's axis (x, y) [m]."""
        return (-self.depth / 2, self.shift)

    @property
    def top(self) -> float:
        """Height at which the pen leaves the stand [m]."""
        return self.height + self.socket_height


def draw_stand(rng: np.random.Generator, kind: str, materials: tuple[Material, Material, Material]) -> Stand:
    """Samples the sizes of a stand of a kind. ``materials``: body, socket, extra."""
    width, depth, height = (rng.uniform(*values) for values in _SIZES[kind])
    if kind in ("disc", "column", "cone"):
        depth = width
    side = int(rng.choice([-1, 1]))
    shift = side * rng.uniform(0.20, 0.27) * width if kind in ("ink stand", "note tray", "slab") else 0.0
    if kind == "slab" and rng.random() < 0.5:
        shift = 0.0
    socket = rng.uniform(0.022, 0.036) if kind in ("slab", "disc", "ink stand", "note tray") else 0.0
    return Stand(kind, width, depth, height, shift, socket, *materials)


_SIZES = {
    "block": ((0.060, 0.10), (0.055, 0.07), (0.026, 0.038)),
    "slab": ((0.13, 0.18), (0.075, 0.095), (0.014, 0.022)),
    "disc": ((0.080, 0.105), (0.08, 0.08), (0.012, 0.020)),
    "cube": ((0.042, 0.054), (0.042, 0.054), (0.032, 0.045)),
    "ink stand": ((0.17, 0.20), (0.085, 0.10), (0.014, 0.020)),
    "column": ((0.042, 0.056), (0.05, 0.05), (0.036, 0.055)),
    "note tray": ((0.18, 0.21), (0.10, 0.12), (0.012, 0.016)),
    "steps": ((0.095, 0.125), (0.095, 0.125), (0.030, 0.042)),
    "cone": ((0.085, 0.11), (0.05, 0.05), (0.040, 0.058)),
}


def stand_shapes(stand: Stand, hole: float) -> tuple[Shape, ...]:
    """Returns the shapes of a stand for a barrel with half width ``hole`` [m] at its entry."""
    shapes = _body(stand)
    shapes += _socket(stand, hole + SOCKET_ROOM)
    side = -np.sign(stand.shift)
    if stand.kind == "ink stand":
        shapes += _ink_well(stand, (stand.axis[0], float(side) * 0.25 * stand.width))
    if stand.kind == "note tray":
        shapes += _notes(stand, float(side))
    if stand.kind == "slab":
        plate = (-0.012, -stand.shift * 0.6, stand.height + 0.0004)
        shapes += (mark(plate, (0.006, 0.024, 0.0006), stand.socket),)
    return shapes


def _body(stand: Stand) -> tuple[Shape, ...]:
    x, h = -stand.depth / 2, stand.height
    half = (stand.depth / 2, stand.width / 2, h / 2)
    if stand.kind == "disc":
        r = stand.width / 2
        felt = turned((Ring(0, 0.94 * r), Ring(0.0015, 0.94 * r)), Material((0.02, 0.05, 0.03), 0.9), axis=(x, 0.0))
        profile = [(0.0015, r), (0.5 * h, r), (0.62 * h, 0.96 * r), (0.62 * h + 1e-5, 0.82 * r), (0.92 * h, 0.80 * r)]
        return felt + turned([Ring(z, w) for z, w in (*profile, (h, 0.76 * r))], stand.body, axis=(x, 0.0))
    if stand.kind == "column":
        r = stand.width / 2
        profile = [(0, r - 0.001), (0.001, r), (h - 0.003, r), (h - 0.001, r - 0.0012), (h, r - 0.003)]
        return turned([Ring(z, w) for z, w in profile], stand.body, axis=(x, 0.0))
    if stand.kind == "cone":
        r = stand.width / 2
        return turned(
            [Ring(0, r), Ring(0.004, r), Ring(h - 0.001, 0.34 * r), Ring(h, 0.31 * r)], stand.body, axis=(x, 0.0)
        )
    if stand.kind == "steps":
        levels = [(k * h / 3, 1 - 0.28 * k) for k in range(3)]
        return tuple(
            chamfered_box((x, 0, low + h / 6), (size * half[0], size * half[1], h / 6), 0.002, stand.body)
            for low, size in levels
        )
    return (chamfered_box((x, 0, h / 2), half, 0.004 if stand.kind == "block" else 0.0025, stand.body),)


def _socket(stand: Stand, radius: float) -> tuple[Shape, ...]:
    """Returns a trumpet on a foot, or the rim of a hole."""
    h, top, axis = stand.height, stand.top, stand.axis
    if not stand.socket_height:
        return turned((Ring(h, radius + 0.002), Ring(h + 0.0012, radius + 0.0014)), stand.socket, axis=axis)
    foot = (Ring(h, radius + 0.008), Ring(h + 0.003, radius + 0.007), Ring(h + 0.0045, radius + 0.0025))
    stem = (Ring(h + 0.4 * (top - h), radius + 0.0008), Ring(top - 0.003, radius + 0.0016), Ring(top, radius + 0.0022))
    return turned((*foot, *stem), stand.socket, axis=axis)


def _ink_well(stand: Stand, axis: tuple[float, float]) -> tuple[Shape, ...]:
    h, r = stand.height, 0.024
    glass = turned(
        (Ring(h, r), Ring(h + 0.024, r), Ring(h + 0.029, 0.7 * r)), Material((0.02, 0.04, 0.16), 0.1), axis=axis
    )
    lid = (Ring(h + 0.029, 0.74 * r), Ring(h + 0.037, 0.74 * r), Ring(h + 0.039, 0.66 * r))
    return glass + turned(lid, stand.socket, axis=axis)


def _notes(stand: Stand, side: float) -> tuple[Shape, ...]:
    """Returns a pad of notes and two clips, low enough for the hand."""
    x, h = stand.axis[0], stand.height
    y = side * 0.22 * stand.width
    half = 0.036
    paper = chamfered_box((x, y, h + 0.007), (half, half, 0.007), 0.0005, Material((0.86, 0.76, 0.30), 0.9))
    lines = [
        mark((x + dx, y, h + 0.0142), (0.0006, 0.8 * half, 0.0003), stand.extra)
        for dx in (-0.018, -0.008, 0.002, 0.012)
    ]
    return (paper, *lines)
