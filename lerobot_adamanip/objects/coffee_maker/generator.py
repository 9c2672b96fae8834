"""Coffee makers: espresso machines with a portafilter under the group head. Sizes follow home machines.

The bar handle at the front is gripped from above. A downward hand can swing it 46 degrees to either side of a slightly
rotated machine; a horizontal hand reaches its yaw limit at 43 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Shape, annotate, from_above
from lerobot_adamanip.objects.coffee_maker import looks
from lerobot_adamanip.objects.coffee_maker.looks import BLACK
from lerobot_adamanip.objects.drawing import chosen, computed, draw, either_side, picked, uniform
from lerobot_adamanip.objects.geometry.rounded import bar, revolved, upright
from lerobot_adamanip.objects.geometry.shapes import dot, mark, rod

PORTAFILTER_RANGE = 0.80
"""Nominal turn to either side [rad] (paper code)."""
DROP_UPPER = 0.05
"""Downward travel of the portafilter [m] (paper code)."""
GAP = 0.0015
"""Gap between the group head and the turning parts below it [m]."""
BASKET_RADIUS = 0.035
BODY_STYLES = ("box", "column", "rounded")
PANEL_STYLES = ("gauge", "buttons", "dial", "display")
TOP_STYLES = ("cups", "rail", "hopper", "plain")
HANDLE_STYLES = ("tapered", "straight", "waisted")
SPOUT_STYLES = ("double", "single", "bottomless")

_BODY_COLORS = (
    Material((0.70, 0.71, 0.73), 0.25, 0.95), Material((0.58, 0.59, 0.61), 0.38, 0.95),
    Material((0.035, 0.036, 0.04), 0.4, 0.2), Material((0.50, 0.02, 0.025), 0.28, 0.1),
    Material((0.72, 0.66, 0.52), 0.35), Material((0.36, 0.58, 0.52), 0.35), Material((0.78, 0.78, 0.77), 0.35),
    Material((0.06, 0.12, 0.24), 0.3, 0.1), Material((0.12, 0.125, 0.13), 0.45, 0.4),
)  # fmt: skip
_GRIPS = (
    Material((0.02, 0.02, 0.022), 0.45), Material((0.02, 0.02, 0.022), 0.45), Material((0.23, 0.10, 0.035), 0.5),
    Material((0.38, 0.22, 0.10), 0.5), Material((0.70, 0.66, 0.55), 0.4),
)  # fmt: skip

NOVEL_PANEL_STYLES = ("twin gauge", "slot")
NOVEL_COLORS = ((0.72, 0.30, 0.04), (0.30, 0.05, 0.20), (0.10, 0.28, 0.10), (0.72, 0.54, 0.10), (0.20, 0.36, 0.56))


@dataclass(frozen=True, kw_only=True)
class CoffeeMakerDesign:
    """Parameters of one machine [m]. ``x`` values are measured forwards from the group's axis. Only the group and the
    tray extend farther forward than that axis.

    Attributes:
        tray_height: height of the base with the drip tray.
        group_z: height of the group head's lower face.
        axis_x: distance of the group's axis behind the tray's front.
        head_x: front face of the upper housing.
        column_x: front face of the back wall behind the cups.
        grip_radius: distance of the grip from the axis.
        handle_length: distance of the handle's end from the axis.
        handle_half: half width and height of the handle.
    """

    body_style: str = chosen(BODY_STYLES)
    tray_height: float = uniform(0.045, 0.062)
    group_z: float = computed(lambda rng, d: d.tray_height + rng.uniform(0.145, 0.165))
    grip_radius: float = uniform(0.155, 0.175)
    body: Material = picked(_BODY_COLORS)
    base: Material = computed(lambda rng, d: BLACK if rng.random() < 0.5 else d.body)
    width: float = uniform(0.20, 0.30)
    height: float = computed(lambda rng, d: d.group_z + rng.uniform(0.115, 0.155))
    depth: float = uniform(0.25, 0.33)
    axis_x: float = computed(lambda rng, d: -rng.uniform(0.055, 0.070))
    head_x: float = computed(
        lambda rng, d: -rng.uniform(*((0.058, 0.068) if d.body_style == "box" else (0.022, 0.034)))
    )
    column_x: float = computed(lambda rng, d: -rng.uniform(0.066, 0.078))
    handle_length: float = computed(lambda rng, d: d.grip_radius + rng.uniform(0.040, 0.052))
    handle_half: tuple[float, float] = computed(lambda rng, d: (rng.uniform(0.012, 0.015), rng.uniform(0.012, 0.0145)))
    wand_side: int = either_side()
    panel_style: str = chosen(PANEL_STYLES)
    top_style: str = chosen(TOP_STYLES)
    handle_style: str = chosen(HANDLE_STYLES)
    spout_style: str = chosen(SPOUT_STYLES)
    chrome: Material = computed(lambda rng, d: Material((0.80, 0.81, 0.83), rng.uniform(0.12, 0.25), 0.95))
    grip: Material = picked(_GRIPS)

    @property
    def head_face(self) -> float:
        """Front of the upper housing in the object's frame [m]."""
        return self.axis_x + self.head_x


def draw_novel_design(rng: np.random.Generator) -> CoffeeMakerDesign:
    """Samples a novel machine: slimmer, or wider and lower, than every seen one; new styles."""
    base = draw(CoffeeMakerDesign, rng)
    slim = rng.random() < 0.5
    body = Material(NOVEL_COLORS[rng.integers(len(NOVEL_COLORS))], rng.uniform(0.25, 0.45), 0.1)
    return replace(
        base,
        width=rng.uniform(0.175, 0.195) if slim else rng.uniform(0.31, 0.345),
        height=base.group_z + (rng.uniform(0.16, 0.19) if slim else rng.uniform(0.105, 0.114)),
        depth=rng.uniform(0.335, 0.36) if slim else rng.uniform(0.23, 0.248),
        head_x=-rng.uniform(0.022, 0.034),
        body_style="slim" if slim else "barrel",
        panel_style=str(rng.choice(NOVEL_PANEL_STYLES)),
        top_style="boiler",
        handle_style="ball end",
        body=body,
        base=BLACK if rng.random() < 0.5 else body,
    )


def build_coffee_maker(object_id: str, design: CoffeeMakerDesign) -> ArticulatedObject:
    """Builds links and annotation of a design: joints ``drop`` and ``portafilter``, part ``handle``."""
    group = (design.axis_x, 0.0, design.group_z)
    # Damped, so that portafilter and puck (5 N) do not fall when they are released.
    drop = Joint("drop", "prismatic", (0.0, 0.0, -1.0), group, (0.0, DROP_UPPER), damping=20.0)
    limits = (-PORTAFILTER_RANGE, PORTAFILTER_RANGE)
    turn = Joint("portafilter", "revolute", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), limits, damping=0.15)
    links = (
        Link("machine", looks.machine_shapes(design), mass=9.0),
        Link("puck", _puck_shapes(), mass=0.05, parent="machine", joint=drop),
        Link("portafilter", _portafilter_shapes(design), mass=0.45, parent="puck", joint=turn),
    )
    grip = (design.axis_x + design.grip_radius, 0.0, design.group_z + HANDLE_Z + 0.002)
    top = {"cups": 0.062, "rail": 0.03, "hopper": 0.085, "plain": 0.0, "boiler": 0.082}[design.top_style]
    return ArticulatedObject(
        object_id,
        "coffee_maker",
        links,
        (annotate(links, "portafilter", "handle", from_above(grip)),),
        (design.width, design.depth, design.height + top),
        f"{design.body_style} body, {design.panel_style} panel, {design.top_style} top, {design.spout_style} spout",
    )


HANDLE_Z = -0.017
"""Height of the handle's middle relative to the group head [m]."""


def _puck_shapes() -> tuple[Shape, ...]:
    """Returns the coffee puck: it moves down with the portafilter and, being round, need not turn with it."""
    coffee = Material((0.045, 0.022, 0.012), 0.9)
    return (upright((0, 0, -GAP - 0.0002), BASKET_RADIUS - 0.006, 0.0006, coffee, collides=False),)


def _portafilter_shapes(design: CoffeeMakerDesign) -> tuple[Shape, ...]:
    """Returns the portafilter about the group's axis, z from the group's lower face."""
    r, chrome = BASKET_RADIUS, design.chrome
    bottomless = design.spout_style == "bottomless"
    low = -0.030 if bottomless else -0.036
    bowl = [(r - 0.002, low if bottomless else -0.026), (r - 0.002, -0.010), (r, -0.008), (r, -GAP)]
    if not bottomless:
        bowl = [(0.60 * r, low), *bowl]
    shapes = [revolved((0, 0, 0), bowl, chrome, sides=24)]
    shapes += [mark((0, side * (r + 0.002), -0.005), (0.008, 0.003, 0.003), chrome) for side in (-1, 1)]
    start = 0.072
    shapes.append(rod((r - 0.006, 0, -0.017), (start + 0.012, 0, HANDLE_Z), 0.0075, chrome, round_ends=False))
    shapes += _handle_shapes(design, start)
    return tuple(shapes + _spout_shapes(design, low))


def _spout_shapes(design: CoffeeMakerDesign, low: float) -> list[Shape]:
    chrome, end = design.chrome, low - 0.026
    if design.spout_style == "bottomless":
        return [upright((0, 0, low - 0.0005), 0.027, 0.0008, BLACK, collides=False)]
    if design.spout_style == "single":
        return [rod((0, 0, low), (0.004, 0, end + 0.006), 0.0075, chrome)]
    shapes = [upright((0, 0, low - 0.004), 0.011, 0.005, chrome)]
    for side in (-1, 1):
        knee = (0.0, side * 0.017, low - 0.012)
        shapes += [rod((0, side * 0.004, low - 0.005), knee, 0.006, chrome)]
        shapes += [rod(knee, (0.0, side * 0.018, end), 0.0055, chrome)]
    return shapes


def _handle_shapes(design: CoffeeMakerDesign, start: float) -> list[Shape]:
    """Returns the bar handle along x, with parallel sides at the grip."""
    (w, h), z, end, grip = design.handle_half, HANDLE_Z, design.handle_length, design.grip
    collar = dot((start - 0.001, 0, z), 0.92 * w, 0.004, design.chrome)
    if design.handle_style == "straight":
        bars = [bar([(start, z, w, h), (end - 0.004, z, w, h), (end, z, 0.8 * w, 0.8 * h)], grip, squareness=0.7)]
    elif design.handle_style == "ball end":
        bars = [
            bar([(start, z, w, h), (end - 0.010, z, w, h), (end - 0.008, z, 0.8 * w, 0.8 * h)], grip, squareness=0.5)
        ]
        bars.append(rod((end - 0.004, 0, z), (end - 0.003, 0, z), 1.25 * w, grip))
    elif design.handle_style == "tapered":
        stations = [(start, z, 0.78 * w, 0.78 * h), (start + 0.030, z, w, h), (end - 0.012, z, w, h),
                    (end - 0.003, z, 0.85 * w, 0.85 * h), (end, z, 0.6 * w, 0.6 * h)]  # fmt: skip
        bars = [bar(stations, grip, sides=20)]
    else:
        front, tail = design.grip_radius - 0.022, design.grip_radius + 0.018
        bars = [
            bar([(start, z, w + 0.003, h + 0.002), (front - 0.012, z, w + 0.003, h + 0.002), (front, z, w, h)], grip),
            bar([(front, z, w, h), (tail, z, w, h)], grip),
            bar([(tail, z, w, h), (end - 0.008, z, w + 0.004, h + 0.003), (end, z, 0.8 * w, 0.8 * h)], grip),
        ]
    cap = dot((end + 0.001, 0, z), 0.5 * w, 0.0015, design.chrome)
    return [collar, *bars, cap]
