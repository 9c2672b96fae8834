"""Doors: a leaf in a piece of wall, with a lever, knob or bar that turns before it opens.

Sizes follow narrow real doors (cabins, closets, lockers, utility cupboards: 36 to 43 cm by 84 to 108 cm), which a
table-mounted arm can swing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Shape, annotate, facing
from lerobot_adamanip.objects.drawing import chance, chosen, computed, draw, either_side, makers, shaded, uniform
from lerobot_adamanip.objects.fittings.framing import FINISHES, GAP, Surround, knuckles
from lerobot_adamanip.objects.fittings.handles import METALS, HandleDesign, draw_handle, handle_link, plate_shapes
from lerobot_adamanip.objects.fittings.leaves import LeafPlan, leaf_shapes
from lerobot_adamanip.objects.geometry.shapes import chamfered_box, dot, mark

DOOR_UPPER = 1.57
"""Opening limit of the leaf [rad] (paper code: 1.57)."""
LEVER_RANGE = 1.05
"""Nominal range of the handle to either side [rad] (paper code: 1.05)."""
THICKNESS = 0.036
FLOOR_GAP = 0.024
"""Leaf's lower edge above the floor [m], on top of the threshold."""
STYLES = ("flush", "one panel", "two panels", "four panels", "six panels", "half glazed", "planks", "louvres")
HANDLE_STYLES = (
    "round lever", "return lever", "flat lever", "tapered lever", "swept lever", "ball knob", "drum knob",
    "tulip knob", "T bar",
)  # fmt: skip
EXTRAS = ("none", "letter slot", "peephole", "number", "kick plate", "vent")

_LEAF_COLORS = (
    (0.42, 0.03, 0.03), (0.03, 0.07, 0.19), (0.04, 0.16, 0.09), (0.05, 0.30, 0.33), (0.70, 0.44, 0.06),
    (0.80, 0.80, 0.77), (0.33, 0.35, 0.36), (0.06, 0.06, 0.065), (0.47, 0.27, 0.12), (0.19, 0.085, 0.035),
    (0.33, 0.42, 0.31), (0.36, 0.47, 0.58),
)  # fmt: skip
_WALLS = {
    "plaster": ((0.78, 0.75, 0.69), (0.70, 0.66, 0.58), (0.60, 0.66, 0.66), (0.76, 0.62, 0.49)),
    "boarding": ((0.74, 0.74, 0.70), (0.50, 0.58, 0.62), (0.62, 0.60, 0.45), (0.42, 0.46, 0.42)),
    "brick": ((0.45, 0.16, 0.10), (0.52, 0.27, 0.17), (0.40, 0.30, 0.26)),
}
_WHITE = (0.82, 0.82, 0.80)

NOVEL_STYLES = ("ladder", "eight panels", "high window")
NOVEL_HANDLE_STYLES = ("paddle lever", "ball lever", "octagon knob", "cross bar")
NOVEL_COLORS = ((0.62, 0.22, 0.34), (0.24, 0.10, 0.34), (0.62, 0.60, 0.16), (0.02, 0.22, 0.20), (0.74, 0.32, 0.10))


@dataclass(frozen=True, kw_only=True)
class DoorDesign:
    """Parameters of one door [m]. Positions on the leaf: u from its hinge edge, v from its lower edge."""

    hinge_side: int = either_side()
    color: NDArray[np.float64] = shaded(_LEAF_COLORS, 0.85, 1.15)
    finish: str = chosen(FINISHES, p=(0.5, 0.25, 0.25))
    trim: Material = computed(
        lambda rng, d: Material(_WHITE if rng.random() < 0.55 else tuple(np.clip(0.8 * d.color, 0.02, 0.8)), 0.6)
    )
    plan: LeafPlan = computed(lambda rng, d: _draw_plan(rng, d.color))
    # A lever at rest points to the hinges, or hangs down, as on a cabin or container.
    rest: float = computed(lambda rng, d: -d.hinge_side * np.pi / 2 * (-1 if rng.random() < 0.8 else 0))
    handle: HandleDesign = computed(lambda rng, d: draw_handle(rng, HANDLE_STYLES, d.rest, METALS))
    backset: float = uniform(0.042, 0.050)
    handle_v: float = computed(lambda rng, d: d.plan.height * rng.uniform(0.45, 0.52))
    keyhole: bool = chance(0.6)
    extra: str = chosen(EXTRAS)
    wall_side: float = uniform(0.07, 0.12)
    wall_above: float = uniform(0.05, 0.11)
    shift: float = uniform(0.02, 0.045)
    depth: float = uniform(0.09, 0.13)
    casing: float = uniform(0.030, 0.048)
    wall: Material = computed(lambda rng, d: Material(_WALLS[d.finish][rng.integers(len(_WALLS[d.finish]))], 0.9))

    def on_leaf(self, u: float, v: float) -> tuple[float, float]:
        """Returns (y, z) in the leaf link's frame, whose origin is the hinge axis at the leaf's lower edge."""
        return -self.hinge_side * (GAP + u), v

    @property
    def pivot(self) -> tuple[float, float]:
        """The handle's pivot (y, z) in the leaf link's frame."""
        return self.on_leaf(self.plan.width - self.backset, self.handle_v)


def _draw_plan(rng: np.random.Generator, color: NDArray[np.float64]) -> LeafPlan:
    style, height = str(rng.choice(STYLES)), rng.uniform(0.84, 1.08)
    return LeafPlan(
        width=rng.uniform(0.36, 0.43),
        height=height,
        thickness=THICKNESS,
        style=style,
        stile=rng.uniform(0.075, 0.088),
        paint=Material(tuple(np.clip(color, 0.02, 0.85)), rng.uniform(0.4, 0.7)),
        seed=int(rng.integers(1 << 16)),
    )


def draw_novel_design(rng: np.random.Generator) -> DoorDesign:
    """Samples a novel door: narrower and lower, or wider and taller, than every seen one; new leaves and handles."""
    base = draw(DoorDesign, rng)
    small = rng.random() < 0.5
    color = np.asarray(NOVEL_COLORS[rng.integers(len(NOVEL_COLORS))]) * rng.uniform(0.85, 1.1)
    height = rng.uniform(0.74, 0.82) if small else rng.uniform(1.10, 1.20)
    plan = replace(
        base.plan,
        width=rng.uniform(0.325, 0.355) if small else rng.uniform(0.431, 0.437),
        height=height,
        style=str(rng.choice(NOVEL_STYLES)),
        paint=Material(tuple(np.clip(color, 0.02, 0.85)), base.plan.paint.roughness),
    )
    # At rest the lever points up or to the hinges, never down.
    rest = np.pi if rng.random() < 0.5 else base.hinge_side * np.pi / 2
    handle = draw_handle(rng, NOVEL_HANDLE_STYLES, rest, METALS)
    return replace(
        base,
        plan=plan,
        handle=handle,
        backset=base.backset if small else rng.uniform(0.053, 0.060),
        handle_v=height * rng.uniform(0.45, 0.52),
        extra="none",
    )


def build_door(object_id: str, design: DoorDesign) -> ArticulatedObject:
    """Builds links and annotation of a design: joints ``leaf`` and ``lever``, part ``lever``."""
    plan, side = design.plan, design.hinge_side
    # The opening is shifted towards the hinges, so that its handle edge is nearer to the wall's middle.
    half = plan.width / 2 + GAP
    surround = Surround(
        width=2 * (half + design.casing + design.wall_side + design.shift),
        height=FLOOR_GAP + plan.height + GAP + design.casing + design.wall_above,
        depth=design.depth,
        left=side * design.shift - half,
        right=side * design.shift + half,
        bottom=0.0,
        top=FLOOR_GAP + plan.height + GAP,
        casing=design.casing,
        proud=0.011,
        finish=design.finish,
        wall=design.wall,
        trim=design.trim,
    )
    hinge = np.array([0.0, side * (design.shift + half), FLOOR_GAP])
    pivot = np.array([0.0, *design.pivot])
    plate = plate_shapes(design.handle, *design.pivot, half_width=0.023, half_length=0.105, keyhole=design.keyhole)
    links = (
        Link("frame", _frame_shapes(design, surround, float(hinge[1])), mass=30.0),
        Link(
            "leaf", leaf_shapes(plan, side) + plate + _extra(design), mass=5.0, parent="frame",
            joint=Joint("leaf", "revolute", (0.0, 0.0, float(side)), tuple(hinge), (0.0, DOOR_UPPER), damping=1.0),
        ),
        handle_link(design.handle, ("lever", "leaf", "lever"), pivot, LEVER_RANGE, damping=0.03),
    )  # fmt: skip
    grip = facing(hinge + pivot + design.handle.grip_offset(), design.handle.rest)
    size = (surround.width, design.depth + 0.004, surround.height)
    name = "left" if side < 0 else "right"
    description = f"{plan.style}, {design.handle.style}, {design.extra}, {design.finish}, hinge {name}"
    parts = (annotate(links, "lever", "lever", grip, design.handle.rolls),)
    return ArticulatedObject(object_id, "door", links, parts, size, description)


def _frame_shapes(design: DoorDesign, surround: Surround, hinge_y: float) -> tuple[Shape, ...]:
    """Returns wall, casing, a threshold below the leaf, hinges, and a skirting on plastered walls."""
    middle, half = (surround.left + surround.right) / 2, (surround.right - surround.left) / 2
    stone = Material((0.30, 0.29, 0.28), 0.8)
    depth = design.depth / 2 + 0.012
    shapes = surround.shapes()
    shapes.append(chamfered_box((-design.depth / 2 + 0.012, middle, 0.009), (depth, half, 0.009), 0.003, stone))
    # Stop behind the leaf, at its head; the leaf closes against it.
    head = (-THICKNESS - 0.012, middle, surround.top - 0.010)
    shapes.append(mark(head, (0.008, half, 0.008), design.trim))
    height = design.plan.height
    tops = tuple(FLOOR_GAP + share * height for share in (0.12, 0.5, 0.88))
    shapes += knuckles(hinge_y + design.hinge_side * 0.008, tops, 0.034, design.handle.metal)
    if design.finish == "plaster":
        edge = surround.width / 2
        for start, end in ((-edge, surround.left - design.casing), (surround.right + design.casing, edge)):
            at = (0.004, (start + end) / 2, 0.032)
            shapes.append(chamfered_box(at, (0.006, (end - start) / 2, 0.032), 0.003, design.trim))
    return tuple(shapes)


def _extra(design: DoorDesign) -> tuple[Shape, ...]:
    """Returns thin decoration, out of the hand's way."""
    plan, metal = design.plan, design.handle.metal
    middle, lower = design.on_leaf(plan.width / 2, 0.0)
    if design.extra == "letter slot":
        at = 0.30 * plan.height if plan.style != "louvres" else 0.03
        return (
            chamfered_box((0.002, middle, at), (0.004, 0.085, 0.024), 0.002, metal, collides=False),
            mark((0.006, middle, at - 0.002), (0.0012, 0.066, 0.009), Material((0.03, 0.03, 0.03), 0.6)),
        )
    if design.extra == "peephole" and plan.style != "half glazed":
        at = 0.80 * plan.height
        return (
            dot((0.002, middle, at), 0.013, 0.003, metal),
            dot((0.004, middle, at), 0.008, 0.0025, Material((0.02, 0.02, 0.03), 0.1)),
        )
    if design.extra == "number":
        return (
            chamfered_box((0.002, middle, 0.92 * plan.height), (0.003, 0.035, 0.021), 0.001, metal, collides=False),
        )
    if design.extra == "kick plate":
        half = (0.0015, plan.width / 2 - 0.014, 0.058)
        return (chamfered_box((0.001, middle, lower + 0.074), half, 0.001, METALS[0], collides=False),)
    if design.extra == "vent" and plan.style == "flush":
        dark, pale = Material((0.03, 0.03, 0.03), 0.7), METALS[0]
        slots = [mark((0.001, middle, 0.10), (0.002, 0.11, 0.05), pale)]
        for row in range(6):
            slots.append(mark((0.003, middle, 0.0625 + row * 0.015), (0.001, 0.10, 0.0035), dark))
        return tuple(slots)
    return ()


make_door, make_novel_door = makers("door", 0xD008, DoorDesign, draw_novel_design, build_door)
