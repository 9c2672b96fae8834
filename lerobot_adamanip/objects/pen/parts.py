"""Parts of pens, on their axis: cap, clip, tip and barrel. Clips and prints face +x."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.lathe import SIDES, Ring, decal, fluted, grip_solid, patch, turned
from lerobot_adamanip.objects.geometry.shapes import box, chamfered_box, convex_mesh

END = {"dome": 0.0055, "flat": 0.0015, "cone": 0.0035, "finial": 0.0065}
"""Length of a cap's upper end, above the graspable part [m]."""


@dataclass(frozen=True)
class Pen:
    """Parameters of a pen [m].

    Attributes:
        kind: a name of `RECIPES`.
        radius: half width of the cap.
        length: length of the cap, from its lip to the start of its narrowing end.
        end: a name of `END`.
        clip: ``bar``, ``arrow``, ``ball``, ``moulded``, ``flat`` or ``none``.
        tip: ``nib``, ``ball``, ``felt``, ``chisel`` or ``brush``.
        barrel_radius: half width of the barrel.
        exposed: visible length of the barrel, between stand and cap.
        sides: number of sides of the barrel; 0 is round.
        depth, squareness: depth and squareness of the cross section, see `Ring`.
        ribbed: whether the cap has grooves.
        print: ``rings``, ``maker``, ``stripe``, ``column`` or nothing.
        cap, barrel, trim: materials.
    """

    kind: str
    radius: float
    length: float
    end: str
    clip: str
    tip: str
    barrel_radius: float
    exposed: float
    sides: int
    depth: float
    squareness: float
    ribbed: bool
    print: str
    cap: Material
    barrel: Material
    trim: Material

    @property
    def cap_height(self) -> float:
        """Total height of the cap [m]."""
        return self.length + END[self.end]

    def ring(self, height: float, radius: float) -> Ring:
        """Returns a cross section of the cap or the barrel."""
        return Ring(height, radius, self.depth, self.squareness)


def cap_shapes(pen: Pen) -> tuple[Shape, ...]:
    """Returns the shapes of a cap and its clip. Frame: on the axis at the lip."""
    r, length = pen.radius, pen.length
    rings = [pen.ring(0, r - 0.0004), pen.ring(0.0006, r), pen.ring(0.35 * length, r), pen.ring(length, 0.97 * r)]
    grip = grip_solid(pen.ring(0.0002, r), pen.ring(length, 0.97 * r), pen.cap)
    shapes = (grip, *turned([*rings, *_end(pen)], pen.cap, collides=False))
    if pen.ribbed:
        shapes += (fluted(0.006, 0.8 * length, r + 0.0003, 18, pen.cap, groove=0.0007, taper=0.98),)
    if pen.trim is not pen.cap and pen.squareness == 0.0:
        for height, half in ((0.0035, 0.0014), (0.0075, 0.0004)):
            band = (pen.ring(height - half, r + 0.0002), pen.ring(height + half, r + 0.0002))
            shapes += turned(band, pen.trim, collides=False)
    if pen.end == "finial":
        jewel = (Ring(length + 0.004, 0.46 * r), Ring(length + 0.0055, 0.40 * r), Ring(length + 0.0065, 0.18 * r))
        shapes += turned((Ring(length + 0.003, 0.5 * r), *jewel), pen.trim)
    return shapes + _clip(pen)


def _end(pen: Pen) -> list[Ring]:
    """Returns the rings above the graspable part."""
    r, length = 0.97 * pen.radius, pen.length
    if pen.end == "dome":
        steps = np.linspace(0, np.pi / 2, 6)[1:-1]
        return [pen.ring(length + END["dome"] * np.sin(a), r * np.cos(a)) for a in steps]
    if pen.end == "cone":
        return [pen.ring(length + 0.0025, 0.86 * r), pen.ring(length + 0.0035, 0.74 * r)]
    if pen.end == "finial":
        return [pen.ring(length + 0.001, 0.94 * r), pen.ring(length + 0.003, 0.66 * r)]
    return [pen.ring(length + 0.0008, 0.97 * r), pen.ring(length + 0.0015, 0.88 * r)]


def _clip(pen: Pen) -> tuple[Shape, ...]:
    """Returns the clip, fixed at its upper end. It stays on one side, away from fingers that close across it."""
    if pen.clip == "none":
        return ()
    front, top = pen.radius * pen.depth, pen.length - 0.002
    look = pen.trim if pen.clip != "moulded" else pen.cap
    reach = min(0.74 * pen.length, 0.042)
    half_width = {"moulded": 0.0020, "flat": 0.0032}.get(pen.clip, 0.0015)
    out = front + 0.0024
    root = box(((front + out) / 2 - 0.0006, 0, top - 0.0015), ((out - front) / 2 + 0.0008, half_width, 0.0015), look)
    blade = chamfered_box((out, 0, top - reach / 2), (0.0007, half_width, reach / 2), 0.0004, look)
    low = top - reach
    if pen.clip == "ball":
        ball = [Ring(low + 0.0022 * s, 0.0021 * float(np.sqrt(1.0001 - s * s))) for s in np.linspace(-0.95, 0.95, 8)]
        return (root, blade, *turned(ball, look, axis=(out, 0.0), sides=16))
    if pen.clip == "arrow":
        outline = np.array([(0.0006, low), (0.0027, low + 0.008), (-0.0006, low), (-0.0027, low + 0.008)])
        points = [(s * 0.0009, y, z - low - 0.004) for s in (-1, 1) for y, z in outline]
        return (root, blade, convex_mesh(np.array(points), transform((out, 0, low + 0.004)), look))
    foot = box((out - 0.0009, 0, low + 0.0012), (0.0010, half_width, 0.0012), look)
    return (root, blade, foot)


def barrel_shapes(pen: Pen, bottom: float, lip: float, axis: tuple[float, float]) -> tuple[Shape, ...]:
    """Returns the barrel from ``bottom`` [m], inside its stand, to the cap's lip."""
    r = pen.barrel_radius
    waist = lip - 0.62 * pen.exposed
    rings = [pen.ring(bottom, 0.86 * r), pen.ring(waist, r), pen.ring(lip - 0.0008, r)]
    shapes = turned(rings, pen.barrel, axis=axis, sides=pen.sides or SIDES)
    surface = [pen.ring(lip - pen.exposed, 1.004 * r), pen.ring(lip, 1.004 * r)]
    if pen.print == "rings":
        for height in (0.0025, 0.0048):
            low = lip - height
            shapes += turned(
                (Ring(low, r + 0.0003), Ring(low + 0.0008, r + 0.0003)), pen.trim, axis=axis, collides=False
            )
        return shapes
    dark = Material((0.02, 0.02, 0.025), 0.6)
    ink = dark if max(pen.barrel.color) > 0.2 else Material((0.72, 0.62, 0.36), 0.4)
    if pen.print in ("maker", "stripe"):
        low, high = lip - 0.55 * pen.exposed, lip - 0.008
        band = pen.cap if pen.print == "stripe" or pen.cap is not pen.barrel else ink
        colored = (pen.ring(low, r + 0.0002), pen.ring(low + 0.0045, r + 0.0002))
        shapes += turned(colored, band, axis=axis, collides=False)
        shapes += (decal(surface, patch(0.9 * r, low + 0.008, high, 9), ink, axis=axis),)
    if pen.print == "column":
        for row in range(5):
            z = lip - 0.010 - 0.0055 * row
            width = r * (0.9, 0.6, 0.8, 0.7, 0.9)[row]
            shapes += (decal(surface, patch(width, z - 0.0018, z + 0.0018, 5), ink, axis=axis),)
    return shapes


def tip_shapes(pen: Pen, lip: float, axis: tuple[float, float]) -> tuple[Shape, ...]:
    """Returns the tip, visible once the cap is off; it does not collide, because the cap is solid."""
    r = min(pen.radius * pen.depth, pen.barrel_radius) * 0.80
    grip = {"nib": pen.cap, "ball": pen.trim}.get(pen.tip, Material((0.05, 0.05, 0.055), 0.5))
    room = pen.length - 0.006
    neck = min(0.018, 0.45 * room)
    shapes = turned((Ring(lip - 0.0008, r), Ring(lip + neck, 0.72 * r)), grip, axis=axis, collides=False)
    base = lip + neck
    if pen.tip == "nib":
        outline = [(-0.0030, base - 0.002), (0.0030, base - 0.002), (0.0038, base + 0.006), (-0.0038, base + 0.006)]
        outline += [(0.0003, base + 0.019), (-0.0003, base + 0.019)]
        points = np.array([(axis[0] + 0.0016 + s, axis[1] + y, z) for s in (-0.0004, 0.0004) for y, z in outline])
        return (*shapes, convex_mesh(points, np.eye(4), Material((0.76, 0.55, 0.2), 0.25, 0.9), collides=False))
    length, start, end = {"ball": (0.012, 0.62, 0.10), "felt": (0.012, 0.34, 0.20), "brush": (0.018, 0.40, 0.04)}.get(
        pen.tip, (0.010, 0.42, 0.40)
    )
    ink = Material((0.62, 0.62, 0.63), 0.3, 0.9) if pen.tip == "ball" else pen.cap.darker()
    cone = (Ring(base, start * r), Ring(base + min(length, room - neck), end * r))
    return (*shapes, *turned(cone, ink, axis=axis, sides=SIDES // 2, collides=False))
