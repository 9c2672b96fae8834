"""Lamp heads: stems, shades, globes, arms. All of them collide and stay clear of a hand at the switch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.contract.rotations import rotation_with_x_along, transform
from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.rounded import revolved, shell
from lerobot_adamanip.objects.geometry.shapes import convex_mesh, rod

HAND_CLEARANCE = 0.135
"""Free radius around the switch's axis [m]: half of a hand 20 cm wide, plus the approach error."""
BRASS = Material((0.72, 0.53, 0.20), 0.3, 0.9)
METALS = (
    Material((0.72, 0.72, 0.73), 0.28, 0.9), Material((0.045, 0.045, 0.048), 0.5, 0.2), BRASS,
    Material((0.62, 0.33, 0.20), 0.35, 0.85),
)  # fmt: skip
PAINTS = (
    Material((0.78, 0.78, 0.77), 0.5), Material((0.06, 0.062, 0.066), 0.5), Material((0.50, 0.06, 0.05), 0.4),
    Material((0.10, 0.22, 0.33), 0.45), Material((0.28, 0.40, 0.33), 0.5), Material((0.74, 0.50, 0.13), 0.5),
)  # fmt: skip
WOODS = (Material((0.46, 0.28, 0.14), 0.7), Material((0.62, 0.45, 0.27), 0.7), Material((0.20, 0.11, 0.06), 0.6))
_FABRICS = (
    Material((0.80, 0.74, 0.62), 0.95), Material((0.82, 0.81, 0.78), 0.95), Material((0.55, 0.27, 0.18), 0.95),
    Material((0.14, 0.20, 0.31), 0.95), Material((0.40, 0.47, 0.38), 0.95), Material((0.36, 0.35, 0.34), 0.95),
)  # fmt: skip
_OPAL, _BULB = Material((0.86, 0.82, 0.70), 0.35), Material((0.86, 0.78, 0.52), 0.4)
_BANKER = (Material((0.02, 0.26, 0.12), 0.15), Material((0.02, 0.09, 0.30), 0.15), Material((0.60, 0.30, 0.04), 0.2))


@dataclass(frozen=True)
class Place:
    """Positions on a lamp's base [m].

    Attributes:
        switch, foot: (2,) of the switch's and the stem's axes.
        away: (2,) unit vector from the switch to the stem.
        half: (2,) half extents of the base in x and y.
        top: height of the base's upper side.
    """

    switch: NDArray[np.float64]
    foot: NDArray[np.float64]
    away: NDArray[np.float64]
    half: NDArray[np.float64]
    top: float

    def at(self, back: float, aside: float, up: float) -> NDArray[np.float64]:
        """Returns the point (3,) behind, beside and above the stem's foot, as seen from the switch [m]."""
        side = np.array([-self.away[1], self.away[0]])
        return np.array([*(self.foot + back * self.away + aside * side), self.top + up])


@dataclass(frozen=True)
class Head:
    """Style, size and colours of everything above the base.

    Attributes:
        radius: extent of shade or globe towards the switch [m].
        height: total height above the base [m].
        stem: radius of the stem [m].
        lean: offset of the stem's top away from the switch [m].
        side: side of arms and bars.
    """

    style: str
    radius: float
    height: float
    stem: float
    lean: float
    side: int
    metal: Material
    shade: Material

    @classmethod
    def drawn(cls, rng: np.random.Generator, style: str) -> Head:
        """Samples sizes and colours for a style."""
        low, high = _RADII[style]
        slender = style not in ("gourd", "mushroom", "lantern")
        fabric = style in ("drum", "empire", "gourd")
        shades = {"banker": _BANKER, "globe": (_OPAL,), "lantern": (_OPAL,), "bar": METALS, "ring": METALS}
        choices = shades.get(style, _FABRICS if fabric else (*PAINTS, *METALS[:3]))
        metal = (*METALS, PAINTS[0])[rng.integers(5)]
        return cls(
            style=style,
            radius=rng.uniform(low, high),
            height=rng.uniform(0.21, 0.27) if style == "lantern" else rng.uniform(0.33, 0.42),
            stem=rng.uniform(0.006, 0.010) if slender else rng.uniform(0.020, 0.028),
            lean=float(rng.choice([0.0, 0.0, 1.0])) * rng.uniform(0.02, 0.05) if style in _LEANING else 0.0,
            side=int(rng.choice([-1, 1])),
            metal=BRASS if style == "banker" else metal,
            shade=choices[rng.integers(len(choices))],
        )

    @property
    def foot_margin(self) -> float:
        """Distance from the stem's axis to the edge of the base [m]."""
        return {"lantern": self.radius + 0.012, "gourd": 0.068, "mushroom": 0.070}.get(self.style, 0.058)

    def clear_distance(self, clearance: float) -> float:
        """Returns the distance of the stem from the switch at which everything keeps ``clearance`` to the switch."""
        thickest = max(self.stem, 0.012) if self.style != "gourd" else 0.052
        return max(clearance + thickest + 0.004, clearance + self.radius - self.lean)

    def shapes(self, place: Place) -> tuple[Shape, ...]:
        """Builds the head on a base."""
        return HEADS[self.style](self, place)


def _stem(head: Head, place: Place, up: float) -> tuple[Shape, ...]:
    collar = revolved(place.at(0, 0, 0), ((head.stem + 0.014, 0), (head.stem + 0.003, 0.012)), head.metal)
    lean = head.lean * up / head.height
    return (collar, rod(place.at(0, 0, 0), place.at(lean, 0, up), head.stem, head.metal, round_ends=False))


def _fabric(head: Head, place: Place, taper: float) -> tuple[Shape, ...]:
    """Returns a hollow shade on a spider, with its bulb."""
    tall = min(0.17, 2.0 * head.radius)
    low, across = head.height - tall, 0.92 * taper * head.radius
    top = place.at(head.lean, 0, low)
    wall = shell(top, ((head.radius, 0.0), (taper * head.radius, tall)), 0.0025, head.shade)
    bulb = revolved(top, ((0.012, 0.02), (0.026, 0.055), (0.026, 0.075), (0.012, 0.092)), _BULB)
    bars = [
        rod(top + np.array([*end, 0.9 * tall]), top + np.array([*-end, 0.9 * tall]), 0.0018, head.metal)
        for end in across * np.eye(2)
    ]
    finial = rod(place.at(head.lean, 0, low + 0.02), place.at(head.lean, 0, head.height + 0.012), 0.0045, head.metal)
    return (*wall, bulb, *bars, finial)


def _drum(head: Head, place: Place) -> tuple[Shape, ...]:
    return _stem(head, place, head.height - 0.10) + _fabric(head, place, 0.94)


def _empire(head: Head, place: Place) -> tuple[Shape, ...]:
    return _stem(head, place, head.height - 0.10) + _fabric(head, place, 0.58)


def _gourd(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns a ceramic body of two bellies under a fabric shade."""
    glaze = Material(head.shade.color, 0.15) if sum(head.shade.color) < 1.8 else Material((0.10, 0.24, 0.34), 0.12)
    foot = place.at(0, 0, 0)
    lower = revolved(foot, ((0.034, 0.0), (0.047, 0.025), (0.052, 0.05), (0.044, 0.08), (0.022, 0.105)), glaze)
    upper = revolved(foot, ((0.020, 0.09), (0.030, 0.115), (0.030, 0.135), (0.014, 0.165)), glaze)
    neck = rod(place.at(0, 0, 0.15), place.at(0, 0, head.height - 0.10), 0.008, head.metal, round_ends=False)
    pale = replace(head, shade=_FABRICS[1]) if glaze.color == head.shade.color else head
    return (lower, upper, neck, *_fabric(pale, place, 0.66))


def _globe(head: Head, place: Place) -> tuple[Shape, ...]:
    up = head.height - head.radius
    holder = revolved(place.at(head.lean, 0, up - head.radius - 0.012), ((0.014, 0), (0.026, 0.024)), head.metal)
    sphere = rod(place.at(head.lean, 0, up - 5e-4), place.at(head.lean, 0, up + 5e-4), head.radius, _OPAL)
    return (*_stem(head, place, up - head.radius), holder, sphere)


def _mushroom(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns a dome on a thick column."""
    tall = 0.72 * head.radius
    low = place.at(0, 0, 0.85 * head.height - tall)
    arc = np.linspace(0, 0.5 * np.pi, 7)
    dome = [(max(head.radius * np.cos(a), 1e-3), tall * np.sin(a)) for a in arc]
    column = revolved(
        place.at(0, 0, 0), ((1.5 * head.stem, 0), (head.stem, 0.85 * head.height - tall)), head.shade, sides=32
    )
    glow = revolved(low - (0, 0, 0.004), ((0.9 * head.radius, 0.0), (0.9 * head.radius, 0.004)), _OPAL)
    return (column, glow, revolved(low, dome, head.shade, sides=30))


def _lantern(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns an opal cylinder between two rims."""
    wood = WOODS[0] if head.side > 0 else head.metal
    rim = ((head.radius, 0.0), (head.radius, 0.012), (head.radius - 0.002, 0.014))
    rims = [revolved(place.at(0, 0, up), rim, wood, sides=40) for up in (0.0, head.height - 0.014)]
    glass = revolved(
        place.at(0, 0, 0.012), ((head.radius - 0.004, 0), (head.radius - 0.004, head.height - 0.024)), _OPAL
    )
    return (*rims, glass)


def _banker(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns a trough of coloured glass across a brass stem."""
    up, half = head.height - 0.02, 0.115
    arc = np.linspace(-0.12 * np.pi, 0.86 * np.pi, 12)
    profile = np.column_stack([head.radius * np.cos(arc), 0.82 * head.radius * np.sin(arc)])
    points = [place.at(head.lean + a, s * half, up - 0.03 + z) for a, z in profile for s in (-1, 1)]
    center = np.mean(points, axis=0)
    trough = convex_mesh(np.asarray(points) - center, transform(center), head.shade)
    pivots = [
        rod(place.at(head.lean, s * half, up - 0.01), place.at(head.lean, s * (half + 0.010), up - 0.01), 0.007, BRASS)
        for s in (-1, 1)
    ]
    chain = rod(place.at(head.lean, 0.06, up - 0.13), place.at(head.lean, 0.06, up - 0.03), 0.0012, BRASS)
    return (*_stem(head, place, up - 0.02), trough, *pivots, chain)


def _bar(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns a slim LED bar across the top of the stem, or to one side of it."""
    up = head.height
    reach = (-0.05, 0.23) if head.radius < 0.0095 else (-0.15, 0.15)
    ends = [place.at(0, head.side * b, up) for b in reach]
    glow = [place.at(0, head.side * b, up - 0.009) for b in (reach[0] + 0.01, reach[1] - 0.01)]
    return (
        *_stem(head, place, up),
        rod(ends[0], ends[1], head.radius, head.shade),
        rod(glow[0], glow[1], 0.006, _OPAL),
    )


def _ring(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns a light ring on a short stem."""
    across = 0.42 * (head.height - 0.08)
    middle = head.height - across
    angles = np.linspace(0, 2 * np.pi, 29)
    points = [place.at(0, across * np.sin(a), middle + across * np.cos(a)) for a in angles]
    lit = [place.at(0, (across - 0.007) * np.sin(a), middle + (across - 0.007) * np.cos(a)) for a in angles]
    hoop = [rod(a, b, head.radius, head.shade) for a, b in pairwise(points)]
    glow = [rod(a, b, 0.006, _OPAL) for a, b in pairwise(lit)]
    return (*_stem(head, place, middle - across), *hoop, *glow)


def _cone(head: Head, tip: NDArray[np.float64], points_to: ArrayLike, radius: float) -> tuple[Shape, ...]:
    """Returns a reflector of ``radius`` [m] that opens towards a direction (3,), with its bulb."""
    turn = rotation_with_x_along(points_to) @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    profile = ((0.016, -0.012), (0.022, 0.004), (0.55 * radius + 0.012, 0.028), (radius, 0.085))
    bulb = ((0.86 * radius, 0.080), (0.86 * radius, 0.087))
    shapes = [revolved((0, 0, 0), profile, head.shade, sides=32), revolved((0, 0, 0), bulb, _BULB)]
    return tuple(replace(shape, pose_in_link=transform(tip, turn)) for shape in shapes)


def _architect(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns two jointed arms of parallel rods, and a reflector."""
    s, tall = head.side, head.height
    foot, elbow = place.at(0, 0, 0.02), place.at(0.035, -s * 0.05, 0.56 * tall)
    tip = place.at(0.045, s * 0.09, 0.92 * tall)
    gap = place.at(0, 0, 0) - place.at(0.011, 0, 0)
    arms = [
        rod(a + k * gap, b + k * gap, 0.0038, head.metal) for a, b in ((foot, elbow), (elbow, tip)) for k in (0, -1)
    ]
    joints = [rod(at + 0.3 * gap, at - 1.3 * gap, 0.011, head.metal, round_ends=False) for at in (foot, elbow, tip)]
    collar = revolved(place.at(0, 0, 0), ((0.026, 0), (0.022, 0.014)), head.metal)
    aim = place.at(0.01, s * 0.05, 0) - place.at(0, 0, 0.11)
    return (collar, *arms, *joints, *_cone(head, tip + 0.1 * aim, aim, head.radius))


def _gooseneck(head: Head, place: Place) -> tuple[Shape, ...]:
    """Returns a neck that bends to one side."""
    bend, s = 0.065, head.side
    straight = head.height - bend
    angles = np.linspace(0, 0.86 * np.pi, 12)
    arc = [place.at(0.03 * np.sin(a / 2), s * bend * (1 - np.cos(a)), straight + bend * np.sin(a)) for a in angles]
    neck = [rod(a, b, head.stem, head.metal) for a, b in pairwise(arc)]
    return (*_stem(head, place, straight), *neck, *_cone(head, arc[-1], arc[-1] - arc[-2], head.radius))


HEADS: dict[str, Callable[[Head, Place], tuple[Shape, ...]]] = {
    "drum": _drum, "empire": _empire, "gourd": _gourd, "globe": _globe, "mushroom": _mushroom, "lantern": _lantern,
    "banker": _banker, "bar": _bar, "ring": _ring, "architect": _architect, "gooseneck": _gooseneck,
}  # fmt: skip
_RADII = {
    "drum": (0.070, 0.085), "empire": (0.072, 0.088), "gourd": (0.075, 0.090), "globe": (0.055, 0.072),
    "mushroom": (0.075, 0.090), "lantern": (0.045, 0.058), "banker": (0.058, 0.068), "bar": (0.008, 0.011),
    "ring": (0.007, 0.009), "architect": (0.048, 0.058), "gooseneck": (0.046, 0.055),
}  # fmt: skip
_LEANING = ("drum", "empire", "globe", "banker")
WIDE = ("banker", "bar", "ring")
"""Styles that extend to both sides of the stem; they stand behind the switch, not beside it."""
