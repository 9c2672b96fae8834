"""Appearance of a coffee maker's housing: base and drip tray, column, head, group, panel, wand and top."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.rounded import revolved, round_cornered, upright
from lerobot_adamanip.objects.geometry.shapes import disk, dot, mark, rod

if TYPE_CHECKING:
    from lerobot_adamanip.objects.coffee_maker.generator import CoffeeMakerDesign

BLACK = Material((0.022, 0.022, 0.025), 0.5)
GLASS = Material((0.01, 0.012, 0.015), 0.12)
WHITE = Material((0.85, 0.85, 0.83), 0.4)
RED = Material((0.65, 0.03, 0.02), 0.4)
GROUP_RADIUS = 0.039
_CORNERS = {
    "box": (0.010, 0.004), "column": (0.016, 0.006), "rounded": (0.048, 0.020), "slim": (0.003, 0.0015),
    "barrel": (0.09, 0.012),
}  # fmt: skip
"""Radius of the vertical edges and bevel of the horizontal ones [m]."""


def machine_shapes(design: CoffeeMakerDesign) -> tuple[Shape, ...]:
    """Returns all static shapes."""
    return tuple(shape for build in (_base, _housing, _group, _panel, _wand, _top) for shape in build(design))


def _slab(
    design: CoffeeMakerDesign,
    front: float,
    low: float,
    high: float,
    material: Material,
    *,
    inset: float = 0.0,
    collides: bool = True,
) -> Shape:
    """Returns a part of the housing from ``front`` to the back, between two heights."""
    corner, bevel = _CORNERS[design.body_style]
    half = ((design.depth + front) / 2 - inset, design.width / 2 - inset, (high - low) / 2)
    center = ((front - design.depth) / 2, 0, (low + high) / 2)
    return round_cornered(center, half, corner, material, bevel=min(bevel, 0.2 * (high - low)), collides=collides)


def _base(design: CoffeeMakerDesign) -> list[Shape]:
    t, w = design.tray_height, design.width / 2
    column = design.axis_x + design.column_x
    shapes = [_slab(design, 0.0, 0.010, t, design.base)]
    for x in (-0.035, -design.depth + 0.035):
        shapes += [upright((x, s * (w - 0.035), 0.006), 0.014, 0.006, BLACK) for s in (-1, 1)]
    deep, wide = (0.012 - column) / 2 - 0.012, w - 0.026
    middle = column + deep + 0.002
    shapes.append(mark((middle, 0, t), (deep, wide, 0.0012), design.chrome))
    for y in np.linspace(-wide + 0.012, wide - 0.012, 13):
        shapes.append(mark((middle, y, t + 0.0006), (deep - 0.008, 0.0022, 0.0012), BLACK))
    lip = mark((0.0005, 0, t * 0.55), (0.001, w - 0.055, 0.0035), design.chrome)
    return [*shapes, lip]


def _housing(design: CoffeeMakerDesign) -> list[Shape]:
    t, top = design.tray_height, design.height
    column, head = design.axis_x + design.column_x, design.head_face
    if design.body_style == "box":
        panel = round_cornered(
            (head, 0, (t + top) / 2),
            (0.002, design.width / 2 - 0.012, (top - t) / 2 - 0.010),
            0.0018,
            design.chrome,
            bevel=0.001,
            collides=False,
        )
        return [_slab(design, head, t - 0.002, top, design.body), panel]
    low = design.group_z + 0.010
    splash = mark(
        (column + 0.0005, 0, (t + low) / 2), (0.001, design.width / 2 - 0.05, (low - t) / 2 - 0.012), design.chrome
    )
    shapes = [
        _slab(design, column, t - 0.002, low + 0.002, design.body, inset=0.004),
        _slab(design, head, low, top, design.body),
        splash,
    ]
    if design.body_style == "rounded":
        band = _slab(design, head + 0.0012, top - 0.030, top - 0.025, design.chrome, inset=-0.0012, collides=False)
        shapes.append(band)
    else:
        shapes.append(_slab(design, head - 0.01, top - 0.001, top + 0.004, BLACK, inset=0.012))
    return shapes


def _group(design: CoffeeMakerDesign) -> list[Shape]:
    """Returns the group head above the portafilter, with its lower face at ``group_z``."""
    x, z, r, chrome = design.axis_x, design.group_z, GROUP_RADIUS, design.chrome
    if design.body_style == "box":
        reach = design.head_x
        return [
            revolved((x, 0, z), [(r, 0), (r, 0.016), (0.8 * r, 0.024), (0.72 * r, 0.052)], chrome, sides=32),
            revolved((x, 0, z + 0.052), [(0.55 * r, 0), (0.55 * r, 0.010), (0.30 * r, 0.018)], chrome, sides=24),
            rod((x, 0, z + 0.036), (x + reach - 0.004, 0, z + 0.036), 0.022, chrome, round_ends=False),
            disk((x + reach + 0.004, 0, z + 0.036), 0.034, 0.004, chrome),
        ]
    return [
        revolved((x, 0, z), [(r, 0), (r, 0.014), (r - 0.003, 0.017)], chrome, sides=32),
        revolved(
            (x, 0, z + 0.017),
            [(r - 0.003, 0), (r + 0.002, 0.004), (r + 0.002, 0.028), (r - 0.006, 0.036)],
            design.base if design.base is BLACK else design.body,
            sides=32,
        ),
    ]


def _panel(design: CoffeeMakerDesign) -> list[Shape]:
    """Returns the controls on the upper front, none farther out than the group's axis."""
    face = design.head_face + (0.002 if design.body_style == "box" else 0.0)
    z = (design.group_z + 0.062 + design.height - 0.016) / 2
    side = design.width / 2 - 0.048
    away = -design.wand_side * side
    plate_z = design.group_z + 0.052 if design.body_style != "box" else design.height - 0.020
    plate = mark((face + 0.001, side * design.wand_side * 0.9, plate_z), (0.001, 0.017, 0.0035), design.chrome)
    return [*_PANELS[design.panel_style](design, face, z, away), plate]


def _gauge(face: float, y: float, z: float, radius: float, chrome: Material) -> list[Shape]:
    return [
        dot((face + 0.003, y, z), radius, 0.003, chrome),
        dot((face + 0.006, y, z), 0.84 * radius, 0.0008, WHITE),
        *(
            dot((face + 0.0068, y + 0.66 * radius * np.cos(a), z + 0.66 * radius * np.sin(a)), 0.0013, 0.0004, BLACK)
            for a in np.linspace(-0.6, np.pi + 0.6, 9)
        ),
        rod((face + 0.007, y, z), (face + 0.007, y - 0.45 * radius, z + 0.5 * radius), 0.0009, RED),
        dot((face + 0.007, y, z), 0.003, 0.001, BLACK),
    ]


def _gauge_panel(design: CoffeeMakerDesign, face: float, z: float, away: float) -> list[Shape]:
    shapes = _gauge(face, 0.0, z, 0.022, design.chrome)
    for k, light in enumerate((WHITE, RED)):
        y = away - np.sign(away) * 0.026 * k
        shapes.append(mark((face + 0.002, y, z), (0.003, 0.009, 0.014), BLACK))
        shapes.append(mark((face + 0.005, y, z + 0.006), (0.001, 0.006, 0.004), light))
    knob = dot((face + 0.010, -away, z), 0.017, 0.010, BLACK)
    return [*shapes, knob, dot((face + 0.020, -away, z), 0.010, 0.001, design.chrome)]


def _button_panel(design: CoffeeMakerDesign, face: float, z: float, away: float) -> list[Shape]:
    count = 3 if design.width < 0.25 else 4
    shapes = [mark((face + 0.001, 0, z), (0.0015, design.width / 2 - 0.030, 0.021), BLACK)]
    for y in np.linspace(-1, 1, count) * (design.width / 2 - 0.055):
        shapes.append(dot((face + 0.004, y, z), 0.0125, 0.003, design.chrome))
        shapes.append(dot((face + 0.0072, y, z), 0.004, 0.0006, Material((0.55, 0.75, 0.95), 0.3)))
    return shapes


def _twin_gauge_panel(design: CoffeeMakerDesign, face: float, z: float, away: float) -> list[Shape]:
    apart = min(0.030, 0.3 * design.width)
    return [shape for y in (-apart, apart) for shape in _gauge(face, y, z, 0.024, design.chrome)]


def _slot_panel(design: CoffeeMakerDesign, face: float, z: float, away: float) -> list[Shape]:
    glow = Material((0.95, 0.55, 0.10), 0.3)
    wide = design.width / 2 - 0.035
    return [
        mark((face + 0.001, 0, z + 0.008), (0.0015, wide, 0.006), BLACK),
        mark((face + 0.0028, -0.4 * wide, z + 0.008), (0.0004, 0.4 * wide, 0.0018), glow),
        *(dot((face + 0.003, y, z - 0.014), 0.006, 0.003, design.chrome) for y in (-0.02, 0.0, 0.02)),
    ]


def _dial_panel(design: CoffeeMakerDesign, face: float, z: float, away: float) -> list[Shape]:
    pointer = mark((face + 0.0225, away, z + 0.010), (0.0008, 0.0014, 0.007), WHITE)
    return [
        *_gauge(face, -away, z, 0.020, design.chrome),
        dot((face + 0.002, away, z), 0.027, 0.002, design.chrome),
        dot((face + 0.012, away, z), 0.021, 0.010, BLACK),
        pointer,
        *(dot((face + 0.004, y, z), 0.007, 0.003, design.chrome) for y in (-0.012, 0.012)),
    ]


def _display_panel(design: CoffeeMakerDesign, face: float, z: float, away: float) -> list[Shape]:
    blue = Material((0.25, 0.65, 0.9), 0.3)
    shapes = [mark((face + 0.001, 0, z), (0.0015, 0.040, 0.018), GLASS)]
    for k in range(4):
        height = 0.004 + 0.002 * ((k * 7) % 3)
        shapes.append(mark((face + 0.0028, (k - 1.5) * 0.013, z), (0.0004, 0.004, height), blue))
    for y in (away, -away):
        shapes.append(dot((face + 0.007, y, z), 0.015, 0.007, design.chrome))
        shapes.append(dot((face + 0.014, y, z), 0.011, 0.0008, BLACK))
    return shapes


_PANELS = {
    "gauge": _gauge_panel, "buttons": _button_panel, "dial": _dial_panel, "display": _display_panel,
    "twin gauge": _twin_gauge_panel, "slot": _slot_panel,
}  # fmt: skip


def _wand(design: CoffeeMakerDesign) -> list[Shape]:
    """Returns the steam wand, behind the group's axis and out of the turned hand's way."""
    s, chrome = design.wand_side, design.chrome
    y = s * (design.width / 2 - 0.030)
    if design.body_style == "box":
        start = np.array([design.head_face + 0.012, y, design.group_z + 0.030])
        hinge = [disk((design.head_face + 0.006, y, start[2]), 0.013, 0.007, chrome)]
    else:
        start = np.array([design.axis_x - 0.046, y, design.group_z + 0.006])
        hinge = [upright((start[0], y, start[2]), 0.012, 0.006, chrome)]
    knee = np.array([design.axis_x - 0.024, y + s * 0.010, design.tray_height + 0.075])
    tip = knee + np.array([0.010, s * 0.006, -0.040])
    sleeve = start + 0.45 * (knee - start)
    return [
        *hinge,
        rod(start, knee, 0.0045, chrome),
        rod(knee, tip, 0.0045, chrome),
        rod(sleeve, start + 0.8 * (knee - start), 0.0075, BLACK),
        rod(tip, tip - (0, 0, 0.006), 0.0058, chrome),
        *_side_knob(design),
    ]


def _side_knob(design: CoffeeMakerDesign) -> list[Shape]:
    """Returns the steam valve's knob, on the wand's side of the housing."""
    y, z = design.wand_side * design.width / 2, design.height - 0.045
    x = design.head_face - 0.075
    root, tip = np.array([x, y - 0.002 * design.wand_side, z]), np.array([x, y + 0.026 * design.wand_side, z])
    middle = root + 0.45 * (tip - root)
    return [rod(root, middle, 0.008, design.chrome, round_ends=False), rod(middle, tip, 0.019, BLACK, round_ends=False)]


def _top(design: CoffeeMakerDesign) -> list[Shape]:
    z, w, front, back = design.height + 0.002, design.width / 2 - 0.022, design.head_face - 0.030, -design.depth + 0.022
    if design.top_style == "plain":
        slots = np.linspace(-0.5, 0.5, 5) * w
        return [mark(((front + back) / 2, y, z + 0.002), (0.05, 0.004, 0.0012), BLACK) for y in slots]
    if design.top_style == "boiler":
        x = (front + back) / 2
        r = min(0.6 * w + 0.02, 0.07)
        return [
            revolved(
                (x, 0, z), [(r, 0), (r, 0.030), (0.86 * r, 0.050), (0.5 * r, 0.064), (0.1 * r, 0.070)], design.chrome
            ),
            upright((x, 0, z + 0.074), 0.008, 0.006, BLACK),
        ]
    if design.top_style == "hopper":
        smoke, x = Material((0.10, 0.075, 0.06), 0.15), (front + back) / 2 - 0.01
        return [
            revolved((x, 0, z), [(0.046, 0), (0.062, 0.030), (0.066, 0.066)], smoke, sides=32),
            revolved((x, 0, z + 0.066), [(0.069, 0), (0.069, 0.008), (0.055, 0.013)], BLACK, sides=32),
        ]
    corners = [(front, -w), (front, w), (back, w), (back, -w)]
    shapes = [rod((x, y, z), (x, y, z + 0.026), 0.0032, design.chrome) for x, y in corners]
    for k in range(4):
        first, second = corners[k], corners[(k + 1) % 4]
        shapes.append(rod((*first, z + 0.026), (*second, z + 0.026), 0.0032, design.chrome))
    if design.top_style == "cups":
        for y in np.linspace(-1, 1, 3) * (w - 0.036):
            shapes += _cup((front - 0.042, y, z))
    return shapes


def _cup(at: tuple[float, float, float]) -> list[Shape]:
    """Returns an upside-down espresso cup, as on a cup warmer."""
    x, y, z = at
    return [
        revolved(at, [(0.031, 0), (0.030, 0.012), (0.024, 0.044), (0.017, 0.048)], WHITE, sides=32),
        revolved((x, y, z + 0.046), [(0.016, 0), (0.015, 0.006)], WHITE, sides=24, collides=False),
        rod((x + 0.028, y, z + 0.012), (x + 0.038, y, z + 0.026), 0.004, WHITE),
        rod((x + 0.038, y, z + 0.026), (x + 0.024, y, z + 0.038), 0.004, WHITE),
    ]
