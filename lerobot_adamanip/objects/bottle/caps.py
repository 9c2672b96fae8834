"""Bottle caps, which two fingers turn. Frame: on the axis at the cap's lower edge, z up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.lathe import Ring, fluted, grip_solid, turned
from lerobot_adamanip.objects.geometry.shapes import chamfered_box

_EXTRA = {"nozzle": 0.020, "spout": 0.018, "bulb": 0.024, "dome": 0.006, "ball": 0.019}
"""Height of the parts above the grip [m]."""


@dataclass(frozen=True)
class Cap:
    """A cap.

    Attributes:
        kind: ``fluted``, ``smooth``, ``long``, ``dome``, ``flip``, ``nozzle``, ``spout``, ``bulb``, ``beaker``,
            ``ball``.
        radius: radius of the gripped part [m].
        height: height of the gripped part [m].
        look: material of the cap.
        ribs: number of grooves; 0 for none.
    """

    kind: str
    radius: float
    height: float
    look: Material
    ribs: int = 30

    @property
    def whole_height(self) -> float:
        """Height including all parts on top [m]."""
        return self.height + _EXTRA.get(self.kind, 0.0)


def cap_shapes(cap: Cap) -> tuple[Shape, ...]:
    """Returns the shapes of a cap."""
    edge = min(0.0025, 0.12 * cap.height)
    wall = _wall(cap, edge)
    if cap.kind in ("fluted", "spout", "nozzle"):
        ribs = fluted(0.0022, cap.height - edge, cap.radius + 0.0006, cap.ribs, cap.look, groove=0.0009)
        wall = (*wall, ribs)
    if cap.kind == "long":
        seam = cap.look.darker()
        wall += turned(_band(0.30 * cap.height, 0.0008, cap.radius + 0.0003), seam, collides=False)
        wall += turned(_band(0.36 * cap.height, 0.0004, cap.radius + 0.0003), seam, collides=False)
    return wall + _on_top(cap)


def _wall(cap: Cap, edge: float) -> tuple[Shape, ...]:
    """Returns a solid wall up to the rounded upper edge."""
    h, r = cap.height, cap.radius
    narrow = {"flip": 0.93, "beaker": 0.94}.get(cap.kind, 1.0)
    top = narrow * r
    rounding = [Ring(h - edge * (1 - np.sin(a)), top - edge * (1 - np.cos(a))) for a in np.linspace(0, np.pi / 2, 4)]
    look = turned((Ring(0, r - 0.0008), Ring(0.0008, r), *rounding), cap.look, collides=False)
    return (grip_solid(Ring(0.0002, r), Ring(h - 0.6 * edge, top), cap.look), *look)


def _on_top(cap: Cap) -> tuple[Shape, ...]:
    h, r = cap.height, cap.radius
    if cap.kind == "nozzle":
        tip = replace(cap.look, color=(0.75, 0.06, 0.04)) if cap.look.color[1] > 0.4 else cap.look
        cone = (Ring(h, 0.62 * r), Ring(h + 0.004, 0.40 * r), Ring(h + 0.016, 0.20 * r))
        return turned(cone, cap.look) + turned((cone[-1], Ring(h + 0.020, 0.16 * r)), tip)
    if cap.kind == "spout":
        pale = Material((0.80, 0.82, 0.82), 0.4)
        dark = cap.look.darker()
        return (
            *turned((Ring(h, 0.66 * r), Ring(h + 0.005, 0.50 * r)), cap.look),
            *turned((Ring(h + 0.005, 0.24 * r), Ring(h + 0.013, 0.24 * r)), pale),
            *turned((Ring(h + 0.013, 0.33 * r), Ring(h + 0.018, 0.28 * r)), dark),
        )
    if cap.kind == "bulb":
        rubber = Material((0.03, 0.03, 0.032), 0.8)
        half = 0.52 * r
        profile = (Ring(h, half), Ring(h + 0.004, 0.9 * half), Ring(h + 0.016, half), Ring(h + 0.021, 0.86 * half))
        return turned((*profile, Ring(h + 0.024, 0.45 * half)), rubber)
    if cap.kind == "dome":
        steps = np.linspace(0, np.pi / 2, 6)[:-1]
        return turned([Ring(h + 0.006 * np.sin(a), (r - 0.0025) * np.cos(a)) for a in steps], cap.look, collides=False)
    if cap.kind == "ball":
        half, middle = min(0.92 * r, 0.0135), h + 0.009
        turns = np.linspace(-0.7, np.pi / 2 - 0.1, 8)
        return turned([Ring(middle + 0.010 * np.sin(a), half * np.cos(a)) for a in turns], cap.look)
    if cap.kind == "flip":
        lip = chamfered_box((0.93 * r, 0, h - 0.004), (0.003, 0.3 * r, 0.0018), 0.0008, cap.look, collides=False)
        seam = turned(_band(0.62 * h, 0.0005, 0.957 * r + 0.0004), cap.look.darker(), collides=False)
        return (lip, *seam)
    if cap.kind == "beaker":
        return turned(_band(0.003, 0.0012, r + 0.0006), cap.look.darker(), collides=False)
    return ()


def _band(height: float, half: float, radius: float) -> tuple[Ring, Ring]:
    return Ring(height - half, radius), Ring(height + half, radius)
