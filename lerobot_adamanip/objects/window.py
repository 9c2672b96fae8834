"""Windows: a sash in a piece of wall over a sill, with a handle that turns before the sash opens into the room.

Sizes follow small side-hung windows (30 to 38 cm by 36 to 52 cm of sash); some have fixed lights beside or above them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Shape, annotate, facing
from lerobot_adamanip.objects.drawing import chosen, computed, draw, either_side, makers, picked, shaded, uniform
from lerobot_adamanip.objects.fittings.framing import FINISHES, GAP, Surround, knuckles
from lerobot_adamanip.objects.fittings.handles import METALS, HandleDesign, draw_handle, handle_link, plate_shapes
from lerobot_adamanip.objects.fittings.leaves import Field, at_field, glazing
from lerobot_adamanip.objects.geometry.shapes import chamfered_box

SASH_UPPER = 1.57
"""Opening limit of the sash [rad] (paper code: 1.57)."""
HANDLE_RANGE = 1.57
"""Nominal range of the handle to either side [rad] (paper code: 1.57)."""
THICKNESS = 0.040
SILL_HEIGHT = 0.030
LAYOUTS = ("single", "side light", "transom")
BARS = ((0, 0), (1, 1), (0, 1), (1, 2), (1, 0), (0, 2))
HANDLE_STYLES = ("round lever", "flat lever", "tapered lever", "swept lever", "T bar", "olive", "drum knob")

_FRAME_COLORS = (
    (0.84, 0.84, 0.82), (0.84, 0.84, 0.82), (0.76, 0.72, 0.60), (0.46, 0.27, 0.12), (0.20, 0.09, 0.04),
    (0.10, 0.11, 0.12), (0.06, 0.17, 0.11), (0.08, 0.16, 0.30), (0.36, 0.44, 0.36), (0.40, 0.05, 0.04),
)  # fmt: skip
_WALLS = {
    "plaster": ((0.78, 0.75, 0.69), (0.72, 0.62, 0.45), (0.52, 0.60, 0.62), (0.68, 0.50, 0.42), (0.50, 0.55, 0.45)),
    "boarding": ((0.62, 0.64, 0.62), (0.42, 0.52, 0.58), (0.58, 0.52, 0.38), (0.36, 0.42, 0.38)),
    "brick": ((0.45, 0.16, 0.10), (0.52, 0.27, 0.17), (0.40, 0.30, 0.26)),
}
_SILLS = (Material((0.84, 0.84, 0.82), 0.5), Material((0.42, 0.26, 0.13), 0.6), Material((0.34, 0.34, 0.33), 0.8))

NOVEL_BARS = ((2, 2), (1, 3), (2, 1), (2, 0), (0, 4))
NOVEL_HANDLE_STYLES = ("paddle lever", "ball lever", "octagon knob", "cross bar")
NOVEL_COLORS = ((0.62, 0.30, 0.06), (0.34, 0.10, 0.30), (0.56, 0.54, 0.12), (0.03, 0.30, 0.34), (0.70, 0.36, 0.42))


@dataclass(frozen=True, kw_only=True)
class WindowDesign:
    """Parameters of one window [m]. Positions on the sash: u from its hinge edge, v from its lower edge.

    Attributes:
        width, height: width and height of the sash; ``stile`` is the width of its members.
        hinge_side: +1 if hinged at +y.
        light: width of a side light, or height of a transom; ``mullion`` is the width of the divider to the sash.
        bars: numbers of vertical and horizontal glazing bars.
        shift: offset of the opening from the wall's middle, towards the hinges.
        casing: width of the outer frame.
        sill: protrusion of the sill.
    """

    finish: str = chosen(FINISHES, p=(0.55, 0.2, 0.25))
    color: NDArray[np.float64] = shaded(_FRAME_COLORS, 0.92, 1.05)
    height: float = uniform(0.36, 0.52)
    layout: str = chosen(LAYOUTS, p=(0.5, 0.25, 0.25))
    light: float = computed(lambda rng, d: rng.uniform(*((0.08, 0.11) if d.layout == "side light" else (0.09, 0.14))))
    width: float = uniform(0.30, 0.38)
    stile: float = uniform(0.046, 0.056)
    hinge_side: int = either_side()
    mullion: float = uniform(0.024, 0.034)
    bars: tuple[int, int] = picked(BARS)
    handle: HandleDesign = computed(lambda rng, d: draw_handle(rng, HANDLE_STYLES, 0.0, METALS))
    handle_v: float = computed(lambda rng, d: d.height * rng.uniform(0.44, 0.54))
    wall_side: float = computed(
        lambda rng, d: rng.uniform(*((0.03, 0.05) if d.layout == "side light" else (0.05, 0.10)))
    )
    wall_above: float = uniform(0.06, 0.11)
    wall_below: float = uniform(0.12, 0.20)
    shift: float = computed(lambda rng, d: 0.0 if d.layout == "side light" else rng.uniform(0.02, 0.05))
    depth: float = uniform(0.09, 0.14)
    casing: float = uniform(0.034, 0.050)
    sill: float = uniform(0.020, 0.042)
    wall: Material = computed(lambda rng, d: Material(_WALLS[d.finish][rng.integers(len(_WALLS[d.finish]))], 0.9))
    frame: Material = computed(lambda rng, d: Material(tuple(np.clip(d.color, 0.02, 0.86)), rng.uniform(0.35, 0.65)))
    board: Material = picked(_SILLS)

    @property
    def pivot(self) -> tuple[float, float]:
        """The handle's pivot (y, z) in the sash link's frame: the middle of the stile far from the hinges."""
        return -self.hinge_side * (GAP + self.width - self.stile / 2), self.handle_v

    @property
    def bottom(self) -> float:
        """Height of the opening's lower edge above the floor."""
        return self.wall_below + self.casing

    def opening(self) -> tuple[float, float, float]:
        """Returns left and right (y) and top (z) of the opening, including any fixed light."""
        half = self.width / 2 + GAP
        middle, top = self.hinge_side * self.shift, self.bottom + self.height + 2 * GAP
        left, right = middle - half, middle + half
        if self.layout == "transom":
            top += self.mullion + self.light
        elif self.layout == "side light":
            # On the hinge side, so that the handle stays near the wall's middle.
            extra = self.hinge_side * (self.mullion + self.light)
            left, right = left + min(extra, 0.0), right + max(extra, 0.0)
        return left, right, top


def draw_novel_design(rng: np.random.Generator) -> WindowDesign:
    """Samples a novel window: narrower and taller, or wider and lower, than every seen one; new bars and handles."""
    base = draw(WindowDesign, rng)
    tall = rng.random() < 0.5
    height = rng.uniform(0.54, 0.62) if tall else rng.uniform(0.29, 0.34)
    color = np.asarray(NOVEL_COLORS[rng.integers(len(NOVEL_COLORS))]) * rng.uniform(0.9, 1.1)
    return replace(
        base,
        width=rng.uniform(0.25, 0.285) if tall else rng.uniform(0.39, 0.42),
        height=height,
        bars=NOVEL_BARS[rng.integers(len(NOVEL_BARS))],
        handle=draw_handle(rng, NOVEL_HANDLE_STYLES, 0.0, METALS),
        handle_v=height * rng.uniform(0.46, 0.54),
        frame=Material(tuple(np.clip(color, 0.02, 0.86)), rng.uniform(0.35, 0.65)),
    )


def build_window(object_id: str, design: WindowDesign) -> ArticulatedObject:
    """Builds links and annotation of a design: joints ``sash`` and ``handle``, part ``handle``."""
    side = design.hinge_side
    surround = _surround(design)
    hinge = np.array([0.0, side * (design.shift + design.width / 2 + GAP), design.bottom + GAP])
    pivot = np.array([0.0, *design.pivot])
    y, z = design.pivot
    plate = plate_shapes(design.handle, y, z, half_width=0.016, half_length=0.060, keyhole=False)
    links = (
        Link("frame", _frame_shapes(design, surround, float(hinge[1])), mass=30.0),
        Link(
            "sash", _sash_shapes(design) + plate, mass=4.0, parent="frame",
            joint=Joint("sash", "revolute", (0.0, 0.0, float(side)), tuple(hinge), (0.0, SASH_UPPER), damping=1.0),
        ),
        handle_link(design.handle, ("handle", "sash", "handle"), pivot, HANDLE_RANGE, damping=0.03),
    )  # fmt: skip
    grip = facing(hinge + pivot + design.handle.grip_offset(), design.handle.rest)
    name, (up, level) = ("left" if side < 0 else "right"), design.bars
    description = f"{design.layout}, {design.handle.style}, bars {up}x{level}, {design.finish}, hinge {name}"
    parts = (annotate(links, "handle", "handle", grip, design.handle.rolls),)
    size = (surround.width, design.depth + 0.004, surround.height)
    return ArticulatedObject(object_id, "window", links, parts, size, description)


def _surround(design: WindowDesign) -> Surround:
    left, right, top = design.opening()
    edge = max(-left, right) + design.casing + design.wall_side
    return Surround(
        width=2 * edge,
        height=top + design.casing + design.wall_above,
        depth=design.depth,
        left=left,
        right=right,
        bottom=design.bottom,
        top=top,
        casing=design.casing,
        proud=0.010,
        finish=design.finish,
        wall=design.wall,
        trim=design.frame,
    )


def _frame_shapes(design: WindowDesign, surround: Surround, hinge_y: float) -> tuple[Shape, ...]:
    """Returns wall, frame, sill board, hinges, and the fixed light, if there is one."""
    middle, half = (surround.left + surround.right) / 2, (surround.right - surround.left) / 2
    shapes = surround.shapes()
    depth = (design.sill + 0.05) / 2
    at = (design.sill - depth, middle, design.wall_below - 0.5 * SILL_HEIGHT - 0.001)
    sill = (depth, half + design.casing + 0.022, SILL_HEIGHT / 2)
    shapes.append(chamfered_box(at, sill, 0.005, design.board))
    heights = tuple(design.bottom + GAP + share * design.height for share in (0.16, 0.84))
    shapes += knuckles(hinge_y + design.hinge_side * 0.008, heights, 0.026, design.handle.metal)
    if design.layout == "single":
        return tuple(shapes)
    return tuple(shapes + _fixed_light(design, surround, hinge_y))


def _fixed_light(design: WindowDesign, surround: Surround, hinge_y: float) -> list[Shape]:
    """Returns the fixed pane, and the mullion or transom in front of it."""
    x, half = -THICKNESS / 2 + 0.004, THICKNESS / 2 + 0.004
    low, high, bar = surround.bottom, surround.top, design.mullion / 2
    if design.layout == "transom":
        middle, z = (surround.left + surround.right) / 2, high - design.light - bar
        span = (surround.right - surround.left) / 2
        shapes = [chamfered_box((x, middle, z), (half, span, bar), 0.003, design.frame)]
        return shapes + _pane((surround.left, surround.right, z + bar, high), design, (design.bars[0], 0))
    y = hinge_y + design.hinge_side * bar
    shapes = [chamfered_box((x, y, (low + high) / 2), (half, bar, (high - low) / 2), 0.003, design.frame)]
    edges = sorted((hinge_y + design.hinge_side * 2 * bar, surround.right if design.hinge_side > 0 else surround.left))
    return shapes + _pane((edges[0], edges[1], low, high), design, (0, design.bars[1]))


def _pane(area: Field, design: WindowDesign, bars: tuple[int, int]) -> list[Shape]:
    y0, y1, v0, v1 = area
    return glazing((-y1 - GAP, -y0 - GAP, v0, v1), 1, THICKNESS, design.frame, bars=bars)


def _sash_shapes(design: WindowDesign) -> tuple[Shape, ...]:
    """Returns two stiles, two rails, and the pane between them."""
    w, h, s, half = design.width, design.height, design.stile, THICKNESS / 2
    members: tuple[Field, ...] = ((0, s, 0, h), (w - s, w, 0, h), (s, w - s, 0, s), (s, w - s, h - s, h))
    shapes = []
    for member in members:
        y, z, a, b = at_field(member, design.hinge_side)
        shapes.append(chamfered_box((-half, y, z), (half, a, b), 0.004, design.frame))
    glass = (s, w - s, s, h - s)
    return tuple(shapes + glazing(glass, design.hinge_side, THICKNESS, design.frame, bars=design.bars))


make_window, make_novel_window = makers("window", 0x51D0, WindowDesign, draw_novel_design, build_window)
