"""Safes: a steel box with a hinged door, a pull handle and a lock knob. Sizes follow home and office safes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Shape, annotate, facing
from lerobot_adamanip.objects.drawing import chance, chosen, computed, draw, either_side, makers, picked, uniform
from lerobot_adamanip.objects.geometry.shapes import ball_bar, box, chamfered_box, disk, dot, mark, prism, rod

Range = tuple[float, float]

WALL = 0.028
DOOR_THICKNESS = 0.035
GAP = 0.003
DOOR_UPPER = 1.578
"""Opening limit of the door [rad] (paper code: 1.578)."""
GRASP_REACH = 0.052
"""Distance of a grip from the door [m]; leaves space for the hand in front of other protruding parts."""
MIN_PART_DISTANCE = 0.125
"""Minimum distance between handle and knob [m], so that open fingers around one do not touch the other."""

_BODY_COLORS = (
    (0.05, 0.055, 0.06), (0.11, 0.12, 0.13), (0.28, 0.30, 0.31), (0.55, 0.53, 0.48), (0.06, 0.11, 0.09),
    (0.05, 0.08, 0.16), (0.30, 0.05, 0.05), (0.62, 0.64, 0.65), (0.20, 0.16, 0.11),
)  # fmt: skip
_METALS = (
    Material((0.75, 0.75, 0.76), 0.25, 0.9), Material((0.72, 0.55, 0.22), 0.3, 0.9),
    Material((0.30, 0.30, 0.31), 0.4, 0.8), Material((0.09, 0.09, 0.09), 0.5, 0.2),
)  # fmt: skip
HANDLE_STYLES = ("round bar", "flat bar", "arch")
KNOB_STYLES = ("thumb turn", "octagon", "pointer")
PANEL_STYLES = ("keypad", "dial", "plate")
LAYOUT: tuple[Range, ...] = ((0.66, 0.80), (0.38, 0.60), (0.30, 0.62), (0.32, 0.74))
"""Ranges of u and v, for the handle and for the knob."""
NOVEL_LAYOUT: tuple[Range, ...] = ((0.66, 0.80), (0.30, 0.62), (0.30, 0.66), (0.24, 0.76))
NOVEL_HANDLE_STYLES = ("fin", "ball bar")
NOVEL_KNOB_STYLES = ("hexagon", "cross")
NOVEL_COLORS = ((0.62, 0.30, 0.05), (0.02, 0.28, 0.30), (0.44, 0.20, 0.34), (0.70, 0.58, 0.16), (0.34, 0.46, 0.24))


@dataclass(frozen=True, kw_only=True)
class SafeDesign:
    """Parameters of one safe [m, rad].

    ``layout``: positions of handle and knob on the door, u from the hinge, v from the bottom, as fractions.
    """

    width: float = uniform(0.34, 0.46)
    height: float = uniform(0.32, 0.48)
    color: tuple[float, float, float] = picked(_BODY_COLORS)
    shade: float = uniform(0.75, 1.5)
    layout: tuple[Range, Range] = computed(
        lambda rng, d: _draw_layout(rng, d.width - 2 * WALL, d.height - 2 * WALL, LAYOUT, MIN_PART_DISTANCE)
    )
    depth: float = uniform(0.28, 0.40)
    hinge_side: int = either_side()
    handle_style: str = chosen(HANDLE_STYLES)
    handle_length: float = uniform(0.10, 0.14)
    handle_radius: float = uniform(0.008, 0.011)
    knob_style: str = chosen(KNOB_STYLES)
    knob_radius: float = uniform(0.021, 0.027)
    knob_range: float = uniform(np.deg2rad(60), np.deg2rad(95))
    panel_style: str = chosen(PANEL_STYLES)
    body: Material = computed(lambda rng, d: Material(d.color, rng.uniform(0.4, 0.8), 0.2))
    door: Material = computed(
        lambda rng, d: Material(tuple(np.clip(np.asarray(d.color) * d.shade, 0.02, 0.8)), rng.uniform(0.35, 0.7), 0.3)
    )
    metal: Material = picked(_METALS)
    feet: bool = chance(0.5)
    trim: bool = chance(0.6)

    @property
    def door_width(self) -> float:
        """Width of the door leaf [m]."""
        return self.width - 2 * WALL - 2 * GAP

    @property
    def door_height(self) -> float:
        """Height of the door leaf [m]."""
        return self.height - 2 * WALL - 2 * GAP

    def on_door(self, uv: Range) -> Range:
        """Returns (y, z) in the door link's frame; the sign of y depends on the hinge side."""
        return -self.hinge_side * uv[0] * self.door_width, (uv[1] - 0.5) * self.door_height


def _draw_layout(
    rng: np.random.Generator, width: float, height: float, ranges: Sequence[Range], apart: float
) -> tuple[Range, Range]:
    """Returns (u, v) of handle and knob on a door of this size, at least ``apart`` [m] from each other."""
    while True:
        handle_u, handle_v, knob_u, knob_v = (rng.uniform(*each) for each in ranges)
        if np.hypot((handle_u - knob_u) * width, (handle_v - knob_v) * height) >= apart:
            return (handle_u, handle_v), (knob_u, knob_v)


def draw_novel_design(rng: np.random.Generator) -> SafeDesign:
    """Samples a novel safe: narrower and taller, or wider and lower, than every seen one; new handles and knobs."""
    base = draw(SafeDesign, rng)
    tall = rng.random() < 0.5
    width = rng.uniform(0.29, 0.33) if tall else rng.uniform(0.47, 0.50)
    height = rng.uniform(0.49, 0.56) if tall else rng.uniform(0.27, 0.31)
    color = np.asarray(NOVEL_COLORS[rng.integers(len(NOVEL_COLORS))])
    door = np.clip(color * rng.uniform(0.75, 1.4), 0.02, 0.8)
    layout = _draw_layout(rng, width - 2 * WALL, height - 2 * WALL, NOVEL_LAYOUT, 1.03 * MIN_PART_DISTANCE)
    return replace(
        base,
        width=width,
        height=height,
        handle_style=str(rng.choice(NOVEL_HANDLE_STYLES)),
        knob_style=str(rng.choice(NOVEL_KNOB_STYLES)),
        handle_length=rng.uniform(0.11, 0.14) if tall else rng.uniform(0.09, 0.11),
        layout=layout,
        body=Material(tuple(color), base.body.roughness, 0.2),
        door=Material(tuple(door), base.door.roughness, 0.3),
    )


def build_safe(object_id: str, design: SafeDesign) -> ArticulatedObject:
    """Builds links and annotations of a design: joints ``door`` and ``knob``, parts ``handle`` and ``knob``."""
    foot = 0.015 if design.feet else 0.0
    origin = np.asarray((0.0, design.hinge_side * (design.width / 2 - WALL), foot + design.height / 2))
    links = _links(design, foot, origin)
    knob_y, knob_z = design.on_door(design.layout[1])
    handle_y, handle_z = design.on_door(design.layout[0])
    parts = (
        annotate(links, "leaf", "handle", facing(origin + np.array((GRASP_REACH, handle_y, handle_z)))),
        annotate(links, "knob", "knob", facing(origin + np.array((GRASP_REACH, knob_y, knob_z)))),
    )
    side = "left" if design.hinge_side < 0 else "right"
    description = f"{design.handle_style}, {design.knob_style}, hinge {side}"
    size = (design.width, design.depth, design.height + foot)
    return ArticulatedObject(object_id, "safe", links, parts, size, description)


def _links(design: SafeDesign, foot: float, hinge: NDArray[np.float64]) -> tuple[Link, ...]:
    door_axis = (0.0, 0.0, float(design.hinge_side))
    door_origin = (float(hinge[0]), float(hinge[1]), float(hinge[2]))
    knob_y, knob_z = design.on_door(design.layout[1])
    turn = (-design.knob_range, design.knob_range)
    door = Joint("door", "revolute", door_axis, door_origin, (0.0, DOOR_UPPER), damping=1.0)
    # Positive is clockwise, seen from the front: about -x, into the door.
    knob = Joint("knob", "revolute", (-1.0, 0.0, 0.0), (0.0, knob_y, knob_z), turn, damping=0.02)
    door_shapes = _door_shapes(design) + _handle_shapes(design, *design.on_door(design.layout[0]))
    return (
        Link("body", _body_shapes(design, foot), mass=40.0),
        Link("leaf", door_shapes, mass=4.0, parent="body", joint=door),
        Link("knob", _knob_shapes(design), mass=0.15, parent="leaf", joint=knob),
    )


def _body_shapes(design: SafeDesign, foot: float) -> tuple[Shape, ...]:
    w, h, d, t = design.width / 2, design.height / 2, design.depth / 2, WALL / 2
    z = foot + h
    dark = Material((0.02, 0.02, 0.022), 0.9)
    shapes = [
        chamfered_box((-d, 0, foot + t), (d, w, t), 0.006, design.body),
        chamfered_box((-d, 0, foot + 2 * h - t), (d, w, t), 0.006, design.body),
        chamfered_box((-d, -w + t, z), (d, t, h), 0.006, design.body),
        chamfered_box((-d, w - t, z), (d, t, h), 0.006, design.body),
        box((-2 * d + t, 0, z), (t, w - t, h - t), design.body),
        mark((-d - 0.01, 0, foot + 1.0 * h), (d - DOOR_THICKNESS - 0.01, w - 2 * t, 0.006), dark),
    ]
    hinge_y = design.hinge_side * (w - WALL * 0.45)
    for dz in (-0.32, 0.32):
        center, half = np.array([0.004, hinge_y, z + dz * 2 * h]), np.array([0.0, 0.0, 0.025])
        shapes.append(rod(center - half, center + half, 0.007, design.metal))
    if foot:
        for x in (-0.12 * design.depth, -0.88 * design.depth):
            shapes += [box((x, y, foot / 2), (0.02, 0.02, foot / 2), dark) for y in (-w + 0.04, w - 0.04)]
    return tuple(shapes)


def _door_shapes(design: SafeDesign) -> tuple[Shape, ...]:
    half_w, half_h, half_t = design.door_width / 2, design.door_height / 2, DOOR_THICKNESS / 2
    middle = -design.hinge_side * (half_w + GAP)
    shapes = [chamfered_box((-half_t, middle, 0), (half_t, half_w, half_h), 0.004, design.door)]
    if design.trim:
        inset = 0.022
        for z in (-half_h + inset, half_h - inset):
            shapes.append(mark((0.0008, middle, z), (0.0012, half_w - inset, 0.0015), design.metal))
        for y in (-half_w + inset, half_w - inset):
            shapes.append(mark((0.0008, middle + y, 0), (0.0012, 0.0015, half_h - inset), design.metal))
    free_edge = -design.hinge_side * (design.door_width + GAP)
    for z in (-0.3, 0.0, 0.3):
        y = free_edge + design.hinge_side * 0.012
        bolt = dot((-DOOR_THICKNESS - 0.012, y, z * design.door_height), 0.008, 0.014, _METALS[0])
        shapes.append(bolt)
    return tuple(shapes) + _panel_shapes(design)


def _panel_shapes(design: SafeDesign) -> tuple[Shape, ...]:
    """Returns decoration in the door's upper corner on the hinge side, out of the hand's way."""
    y, z = design.on_door((0.17, 0.86))
    black = Material((0.015, 0.015, 0.018), 0.35)
    if design.panel_style == "plate":
        return (mark((0.001, y, z), (0.002, 0.028, 0.010), _METALS[1]),)
    if design.panel_style == "dial":
        return (dot((0.003, y, z), 0.022, 0.003, _METALS[0]), dot((0.007, y, z), 0.015, 0.004, black))
    keys = [mark((0.002, y, z), (0.003, 0.026, 0.019), black)]
    pale = Material((0.75, 0.76, 0.78), 0.5)
    for row in range(3):
        for column in range(4):
            at = (0.0055, y + (column - 1.5) * 0.011, z + (row - 1.4) * 0.010)
            keys.append(mark(at, (0.001, 0.0042, 0.0036), pale))
    keys.append(mark((0.0055, y, z + 0.0155), (0.001, 0.008, 0.0016), Material((0.05, 0.55, 0.12), 0.3)))
    return tuple(keys)


def _handle_shapes(design: SafeDesign, y: float, z: float) -> tuple[Shape, ...]:
    half, radius, metal, x = design.handle_length / 2, design.handle_radius, design.metal, GRASP_REACH
    foot_plates = tuple(dot((0.002, y, z + s * half), radius * 1.7, 0.002, metal) for s in (-1, 1))
    if design.handle_style == "fin":
        return (chamfered_box((x / 2, y, z), (x / 2 + 0.008, radius, half), 0.003, metal), *foot_plates)
    if design.handle_style == "ball bar":
        radii = (radius * 0.9, 1.6 * radius, radius * 0.8)
        return (*ball_bar((x, y, z), half, radii, metal), *foot_plates)
    if design.handle_style == "flat bar":
        bar = chamfered_box((x, y, z), (radius * 0.7, radius, half + radius), 0.002, metal)
        post = (x / 2, radius * 0.7, radius * 0.7)
        posts = tuple(box((x / 2, y, z + s * (half - radius)), post, metal) for s in (-1, 1))
        return (bar, *posts, *foot_plates)
    grip_half = half if design.handle_style == "round bar" else 0.62 * half
    ends = [np.array([x, y, z + s * grip_half]) for s in (-1, 1)]
    roots = [np.array([0.0, y, z + s * half]) for s in (-1, 1)]
    posts = tuple(rod(root, end, radius * 0.85, metal) for root, end in zip(roots, ends, strict=True))
    return (rod(ends[0], ends[1], radius, metal), *posts, *foot_plates)


def _knob_shapes(design: SafeDesign) -> tuple[Shape, ...]:
    """Returns the knob in its own frame: x out of the door, grip perpendicular to y for flat finger contact."""
    style, radius, metal, tip = design.knob_style, design.knob_radius, design.metal, GRASP_REACH + 0.012
    dark, white = Material((0.04, 0.04, 0.045), 0.4), Material((0.9, 0.9, 0.88), 0.5)
    if style == "octagon":
        shapes = [
            disk((0.004, 0, 0), radius * 1.35, 0.004, dark),
            prism(((tip + 0.008) / 2, 0, 0), radius, (tip - 0.008) / 2, 8, metal, top=0.96),
        ]
    elif style == "hexagon":
        shapes = [
            disk((0.006, 0, 0), radius * 1.3, 0.006, metal),
            prism(((tip + 0.012) / 2, 0, 0), 0.9 * radius, (tip - 0.012) / 2, 6, dark, top=0.98),
        ]
    elif style == "cross":
        arms = [(0.0080, 1.25 * radius), (1.1 * radius, 0.0095)]
        shapes = [disk((0.017, 0, 0), 0.62 * radius, 0.017, dark)]
        shapes += [chamfered_box(((0.03 + tip) / 2, 0, 0), ((tip - 0.03) / 2, *arm), 0.002, metal) for arm in arms]
    else:
        slim, base = (0.0075 if style == "thumb turn" else 0.009), 0.022
        shapes = [
            disk((base / 2, 0, 0), radius * 1.25, base / 2, metal if style == "pointer" else dark),
            chamfered_box(((base + tip) / 2, 0, 0), ((tip - base) / 2, slim, radius * 1.2), 0.002, metal),
        ]
    up = radius * {"octagon": 0.55, "hexagon": 0.55, "cross": 0.95}.get(style, 0.85)
    return (*shapes, mark((tip, 0, up), (0.0012, 0.0018, radius * 0.22), white))


make_safe, make_novel_safe = makers("safe", 0x5AFE, SafeDesign, draw_novel_design, build_safe)
