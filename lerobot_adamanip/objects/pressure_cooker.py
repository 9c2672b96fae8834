"""Pressure cookers: a pot, a domed lid with a valve, and two long handles, one above the other. Sizes: 3 to 8 litres.

The lid's handle is above the pot's, as on a closed cooker, and turns in either direction before the lid can be lifted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Shape, annotate, from_above
from lerobot_adamanip.objects.drawing import chance, chosen, computed, draw, makers, picked, uniform
from lerobot_adamanip.objects.geometry.rounded import SMOOTH, bar, revolved, upright
from lerobot_adamanip.objects.geometry.shapes import box, chamfered_box, mark, rod

LID_RANGE = 0.824
"""Nominal turn of the lid to either side [rad] (paper code)."""
LIFT_UPPER = 0.05
"""Lift travel of the lid [m] (paper code)."""
GAP = 0.0015
"""Gap between the pot's rim and the turning lid [m]."""
LOOP_DEPTH = 0.045
HANDLE_GAP = 0.010
"""Gap between the handles [m]: fingertips reach 1 cm below the tool point and must not touch the lower handle."""
_STEELS = (
    Material((0.80, 0.81, 0.83), 0.25, 0.7), Material((0.66, 0.67, 0.69), 0.32, 0.75),
    Material((0.76, 0.75, 0.72), 0.42, 0.7),
)  # fmt: skip
_ENAMELS = (
    Material((0.50, 0.02, 0.025), 0.25, 0.1), Material((0.03, 0.08, 0.22), 0.25, 0.1),
    Material((0.04, 0.20, 0.12), 0.25, 0.1), Material((0.60, 0.20, 0.02), 0.25, 0.1),
    Material((0.70, 0.68, 0.60), 0.25, 0.1), Material((0.07, 0.07, 0.075), 0.35, 0.2),
)  # fmt: skip
_PLASTICS = tuple(
    Material(color, 0.45)
    for color in ((0.018, 0.018, 0.02), (0.05, 0.05, 0.055), (0.11, 0.02, 0.015), (0.09, 0.05, 0.03))
)
_ACCENTS = tuple(
    Material(color, 0.35) for color in ((0.65, 0.05, 0.02), (0.75, 0.38, 0.02), (0.05, 0.30, 0.10), (0.60, 0.60, 0.62))
)
BODY_STYLES = ("straight", "bellied", "tapered")
LID_STYLES = ("dome", "stepped", "flat")
VALVE_STYLES = ("weight", "indicator", "dial")
HANDLE_STYLES = ("straight", "tapered", "moulded")

NOVEL_BODY_STYLES = ("bowl", "chamfered")
NOVEL_LID_STYLES = ("cone", "plateau")
NOVEL_VALVE_STYLES = ("bell", "twin")
NOVEL_COLORS = ((0.02, 0.30, 0.34), (0.55, 0.30, 0.42), (0.36, 0.17, 0.06), (0.55, 0.50, 0.06), (0.20, 0.10, 0.34))


@dataclass(frozen=True, kw_only=True)
class PressureCookerDesign:
    """Parameters of one cooker [m]. The grip is far enough out for the hand to clear the dome."""

    radius: float = uniform(0.092, 0.124)
    handle_reach: float = uniform(0.066, 0.078)
    steel: Material = picked(_STEELS)
    enamel: Material = picked(_ENAMELS)
    coloured: bool = chance(0.45)
    height: float = computed(lambda rng, d: float(np.clip(2 * d.radius * rng.uniform(0.58, 0.88), 0.12, 0.185)))
    body_style: str = chosen(BODY_STYLES)
    lid_style: str = chosen(LID_STYLES)
    lid_rise: float = uniform(0.024, 0.042)
    valve_style: str = chosen(VALVE_STYLES)
    handle_style: str = chosen(HANDLE_STYLES)
    handle_length: float = computed(lambda rng, d: d.handle_reach + rng.uniform(0.045, 0.075))
    handle_half: tuple[float, float] = computed(
        lambda rng, d: (rng.uniform(0.011, 0.0145), rng.uniform(0.0105, 0.0135))
    )
    helper_loop: bool = chance(0.75)
    band: bool = chance(0.5)
    body: Material = computed(lambda rng, d: d.enamel if d.coloured else d.steel)
    lid: Material = computed(lambda rng, d: d.steel if not d.coloured or rng.random() < 0.7 else d.enamel)
    plastic: Material = picked(_PLASTICS)
    accent: Material = picked(_ACCENTS)

    @property
    def axis_x(self) -> float:
        """Distance of the pot's axis behind its front [m]: one radius."""
        return -self.radius

    @property
    def handle_z(self) -> float:
        """Height of the lid handle's middle [m]."""
        return self.height + 0.002 + self.handle_half[1]


def draw_novel_design(rng: np.random.Generator) -> PressureCookerDesign:
    """Samples a novel cooker: wider and lower, or slimmer and taller, than every seen one; new styles."""
    base = draw(PressureCookerDesign, rng)
    wide = rng.random() < 0.5
    radius = rng.uniform(0.126, 0.134) if wide else rng.uniform(0.082, 0.090)
    color = Material(NOVEL_COLORS[rng.integers(len(NOVEL_COLORS))], 0.25, 0.1)
    return replace(
        base,
        radius=radius,
        height=rng.uniform(0.098, 0.116) if wide else rng.uniform(0.188, 0.21),
        body_style=str(rng.choice(NOVEL_BODY_STYLES)),
        lid_style=str(rng.choice(NOVEL_LID_STYLES)),
        lid_rise=rng.uniform(0.026, 0.038),
        valve_style=str(rng.choice(NOVEL_VALVE_STYLES)),
        handle_style="banded",
        body=color,
        lid=color if rng.random() < 0.5 else base.steel,
    )


def build_pressure_cooker(object_id: str, design: PressureCookerDesign) -> ArticulatedObject:
    """Builds links and annotation of a design: joints ``lift`` and ``lid``, part ``handle`` (the lid's)."""
    rim, up = (design.axis_x, 0.0, design.height), (0.0, 0.0, 1.0)
    # A lid of sheet aluminium, as light as a real one: an arm that reaches down yields half a millimetre per newton.
    lift = Joint("lift", "prismatic", up, rim, (0.0, LIFT_UPPER), damping=8.0)
    lid = Joint("lid", "revolute", up, (0.0, 0.0, 0.0), (-LID_RANGE, LID_RANGE), damping=0.15)
    links = (
        Link("pot", pot_shapes(design), mass=2.5),
        Link("seal", seal_shapes(design), mass=0.05, parent="pot", joint=lift),
        Link("lid", lid_shapes(design), mass=0.4, parent="seal", joint=lid),
    )
    grip = (design.axis_x + (design.radius + design.handle_reach), 0.0, design.handle_z + 0.002)
    depth = 2 * design.radius + (LOOP_DEPTH if design.helper_loop else 0.0)
    return ArticulatedObject(
        object_id,
        "pressure_cooker",
        links,
        (annotate(links, "lid", "handle", from_above(grip)),),
        (2 * design.radius, depth, design.height + design.lid_rise + 0.035),
        f"{design.body_style} pot, {design.lid_style} lid, {design.valve_style} valve, {design.handle_style} handle",
    )


def pot_shapes(design: PressureCookerDesign) -> tuple[Shape, ...]:
    """Returns the pot with its handle and helper loop."""
    r, h, axis = design.radius, design.height, (design.axis_x, 0.0, 0.0)
    outlines = {
        "straight": [(r - 0.006, 0.004), (r, 0.012), (r, h)],
        "bellied": [(0.86 * r, 0.004), (0.95 * r, 0.14 * h), (r, 0.32 * h), (r, 0.62 * h), (0.985 * r, 0.85 * h),
                    (0.97 * r, h)],
        "tapered": [(0.82 * r, 0.004), (0.86 * r, 0.012), (r, 0.8 * h), (r, h)],
        "bowl": [(0.52 * r, 0.004), (0.74 * r, 0.10 * h), (0.90 * r, 0.30 * h), (0.98 * r, 0.62 * h), (r, h)],
        "chamfered": [(0.74 * r, 0.004), (r, 0.26 * h), (r, 0.80 * h), (0.95 * r, h)],
    }  # fmt: skip
    outline = outlines[design.body_style]
    base = outline[0][0] - 0.004
    dark = Material((0.02, 0.02, 0.022), 0.8)
    shapes = [
        revolved(axis, outline, design.body, sides=SMOOTH),
        revolved(axis, [(base, 0.0), (base + 0.003, 0.006)], design.steel, sides=SMOOTH, collides=False),
        upright((axis[0], 0, h), 0.93 * r, 0.0006, dark, collides=False),
        revolved(axis, [(r + 0.0015, h - 0.012), (r + 0.0015, h - 0.0005)], design.steel, sides=SMOOTH, collides=False),
    ]
    if design.band:
        band = [(r + 0.001, 0.68 * h), (r + 0.001, 0.68 * h + 0.004)]
        shapes.append(revolved(axis, band, design.steel, sides=SMOOTH, collides=False))
    shapes += _pot_handle_shapes(design)
    if design.helper_loop:
        shapes += _loop_shapes(design)
    return tuple(shapes)


def _pot_handle_shapes(design: PressureCookerDesign) -> list[Shape]:
    """Returns the lower handle, slightly thicker than the lid's, on a bracket below the rim."""
    half_width, half_height = design.handle_half[0] + 0.001, design.handle_half[1] + 0.002
    z = design.handle_z - design.handle_half[1] - HANDLE_GAP - half_height
    length = design.handle_length - 0.004
    shapes = _grip_shapes(design, (0.020, length), z, (half_width, half_height), droop=0.006)
    bracket = chamfered_box((0.008, 0, z), (0.016, 0.75 * half_width, 0.7 * half_height), 0.002, design.steel)
    return [*shapes, bracket]


def _loop_shapes(design: PressureCookerDesign) -> list[Shape]:
    z, back = 0.72 * design.height, 2 * design.axis_x
    out = back - LOOP_DEPTH + 0.012
    radius, half = 0.009, 0.036
    ends = [(out, -half, z), (out, half, z)]
    shapes = [rod(ends[0], ends[1], radius, design.plastic)]
    for side, end in zip((-1, 1), ends, strict=True):
        shapes.append(rod(end, (back + 0.008, side * (half + 0.004), z), radius * 0.85, design.plastic))
        shapes.append(box((back - 0.003, side * (half + 0.004), z), (0.006, 0.010, 0.011), design.steel))
    return shapes


def seal_shapes(design: PressureCookerDesign) -> tuple[Shape, ...]:
    """Returns the gasket under the lid: it lifts with the lid but does not turn."""
    rubber = Material((0.30, 0.30, 0.31), 0.9)
    r = 0.93 * design.radius
    profile = [(r - 0.004, -0.006), (r, -0.003), (r, 0.0008)]
    return (revolved((0, 0, 0), profile, rubber, sides=SMOOTH, collides=False),)


def lid_shapes(design: PressureCookerDesign) -> tuple[Shape, ...]:
    """Returns the lid about its axis, z from the rim."""
    r, rise, edge = design.radius + 0.004, design.lid_rise, 0.011
    outlines = {
        "dome": [(r, edge)] + [(r * np.sin(a), edge + (rise - edge) * np.cos(a)) for a in np.linspace(1.25, 0.12, 6)],
        "stepped": [(r, edge), (r - 0.004, edge + 0.003), (0.80 * r, rise - 0.005), (0.74 * r, rise - 0.001),
                    (0.66 * r, rise)],
        "cone": [(r, edge), (0.55 * r, 0.62 * rise), (0.16 * r, rise)],
        "plateau": [(r, edge), (0.90 * r, 0.92 * rise), (0.84 * r, rise)],
        "flat": [(r, edge), (0.96 * r, edge + 0.004), (0.90 * r, 0.66 * rise), (0.45 * r, 0.72 * rise)],
    }  # fmt: skip
    outline = outlines[design.lid_style]
    top = outline[-1][1]
    shapes = [
        # The visible shape covers the rim; the collision shape stays above it.
        revolved((0, 0, 0), [(r, -0.010), *outline], design.lid, sides=SMOOTH, collides=False),
        upright((0, 0, (GAP + edge) / 2), r, (edge - GAP) / 2, design.lid),
        revolved((0, 0, 0), [(0.97 * r, edge), *((0.98 * a, b - 0.001) for a, b in outline[1:])], design.lid, sides=20),
        revolved((0, 0, 0), [(r + 0.001, -0.011), (r + 0.001, -0.008)], design.steel, sides=SMOOTH, collides=False),
    ]
    if design.lid_style == "stepped":
        shapes.append(upright((0, 0, rise), 0.5 * r, 0.0008, design.steel, collides=False))
    return tuple(shapes + _valve_shapes(design, top) + _lid_handle_shapes(design, edge, top))


def _valve_shapes(design: PressureCookerDesign, top: float) -> list[Shape]:
    black, white, steel = Material((0.02, 0.02, 0.022), 0.5), Material((0.9, 0.9, 0.9), 0.5), design.steel
    low, along, side = top - 0.004, 0.05 * design.radius, -0.42 * design.radius
    shapes = [  # of the safety plug, beside the valve
        upright((along, side, low), 0.009, 0.007, design.accent),
        upright((along, side, low + 0.007), 0.0045, 0.002, design.steel, collides=False),
    ]
    if design.valve_style == "bell":
        shapes += [
            upright((0, 0, top), 0.006, 0.008, steel),
            revolved((0, 0, top + 0.006), [(0.022, 0), (0.019, 0.008), (0.010, 0.018), (0.003, 0.021)], design.accent),
        ]
    elif design.valve_style == "twin":
        for along, size in ((0.018, 0.008), (-0.016, 0.011)):
            shapes += [
                upright((along, 0, top + 0.006), size, 0.010, black),
                upright((along, 0, top + 0.017), 0.7 * size, 0.002, design.accent, collides=False),
            ]
    elif design.valve_style == "weight":
        shapes += [
            upright((0, 0, top), 0.0045, 0.010, steel),
            revolved((0, 0, top + 0.008), [(0.011, 0), (0.014, 0.003), (0.014, 0.017), (0.010, 0.021)], black),
            upright((0, 0, top + 0.030), 0.006, 0.002, steel, collides=False),
        ]
    elif design.valve_style == "indicator":
        shapes += [
            revolved((0, 0, top - 0.002), [(0.026, 0), (0.024, 0.007), (0.018, 0.009)], black),
            upright((0, 0, top + 0.014), 0.0075, 0.008, design.accent),
            *(upright((0, 0, top + z), 0.0078, 0.0009, white, collides=False) for z in (0.012, 0.017)),
        ]
    else:
        shapes += [
            revolved((0, 0, top - 0.002), [(0.030, 0), (0.030, 0.008), (0.027, 0.011)], steel),
            revolved((0, 0, top + 0.008), [(0.024, 0), (0.021, 0.013), (0.018, 0.015)], black),
            mark((0.010, 0, top + 0.0235), (0.008, 0.0018, 0.0012), design.accent),
        ]
    return shapes


def _lid_handle_shapes(design: PressureCookerDesign, edge: float, top: float) -> list[Shape]:
    """Returns the upper handle: a bracket on the dome, and the grip beyond the rim."""
    r, z = design.radius, design.handle_z - design.height
    half_width, half_height = design.handle_half
    shapes = _grip_shapes(design, (r + 0.007, r + design.handle_length), z, design.handle_half)
    saddle = [(0.62 * r, top - 0.001, 0.8 * half_width, 0.004), (0.70 * r, top + 0.001, half_width, 0.006),
              (r + 0.012, z, half_width + 0.001, half_height)]  # fmt: skip
    shapes.append(bar(saddle, design.plastic, squareness=0.5, collides=False))
    shapes.append(chamfered_box((r - 0.004, 0, edge + 0.004), (0.014, half_width, 0.006), 0.002, design.plastic))
    shapes.append(mark((r + 0.028, 0, z + half_height), (0.011, 0.005, 0.002), design.accent))
    return shapes


def _eyelet(design: PressureCookerDesign, end: float, z: float) -> Shape:  # the rivet of the ring a cooker hangs by
    return Shape("capsule", (0.0025, 0.004), transform((end, 0, z)), design.steel, False)


def _grip_shapes(
    design: PressureCookerDesign, ends: tuple[float, float], z: float, half: tuple[float, float], droop: float = 0.0
) -> list[Shape]:
    """Returns a handle along x between two ``ends``, with parallel sides at the grip."""
    (start, end), (w, h), plastic = ends, half, design.plastic
    tail, low = end - 0.022, z - droop
    if design.handle_style == "straight":
        stations = [(start, z, w, h), (tail, z, w, h), (end - 0.003, low, w, 0.9 * h), (end, low, 0.8 * w, 0.7 * h)]
        return [bar(stations, plastic, squareness=0.45), _eyelet(design, end, low)]
    if design.handle_style == "banded":
        stations = [(start, z, w, h), (tail, z, w, h), (end, low, w, 0.95 * h)]
        rings = [mark((at, 0, z), (0.0022, w + 0.0004, h + 0.0004), design.accent) for at in (tail, end - 0.006)]
        return [bar(stations, plastic, squareness=0.9), *rings]
    if design.handle_style == "tapered":
        stations = [(start, z, w, h), (tail, z, w, 0.92 * h), (end, low, 0.72 * w, 0.62 * h)]
        return [bar(stations, plastic, squareness=0.6), _eyelet(design, end, low)]
    # Moulded: a hump in front of the fingers and a bulb behind them.
    grip = [(start, z, w, h), (end, low, w, 0.85 * h)]
    hump = [(start, z, w + 0.004, h), (start + 0.018, z, w + 0.005, h), (start + 0.030, z, w, 0.9 * h)]
    bulb = [(tail, z, w, 0.85 * h), (end - 0.006, low, w + 0.003, h), (end + 0.002, low, 0.8 * w, 0.75 * h)]
    return [bar(each, plastic, squareness=0.7) for each in (grip, hump, bulb)]


make_pressure_cooker, make_novel_pressure_cooker = makers(
    "pressure_cooker", 0xC270, PressureCookerDesign, draw_novel_design, build_pressure_cooker
)
