"""Door leaves: flush, panelled, glazed, planked and louvred. The leaf hangs at y = 0, its lower edge at z = 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.fittings.framing import GAP
from lerobot_adamanip.objects.geometry.shapes import box, chamfered_box, mark

GLASS = Material((0.50, 0.66, 0.74), 0.06)
GLINT = Material((0.74, 0.85, 0.90), 0.06)
RECESS = 0.011
"""Depth of panels behind the front of stiles and rails [m]."""

Field = tuple[float, float, float, float]
"""A rectangle on the leaf: u from, u to, v from, v to [m]."""


@dataclass(frozen=True)
class LeafPlan:
    """Parameters of one leaf [m]; ``stile`` is the width of its vertical members, ``seed`` selects small details."""

    width: float
    height: float
    thickness: float
    style: str
    stile: float
    paint: Material
    seed: int


def leaf_shapes(plan: LeafPlan, hinge_side: int) -> tuple[Shape, ...]:
    """Returns a leaf with hinge at y = 0; it extends to -y if ``hinge_side`` is +1, and to +y if it is -1."""
    if plan.style in ("flush", "planks"):
        return _slab(plan, hinge_side)
    fields = _fields(plan)
    shapes = [_member(plan, hinge_side, member) for member in _members(plan, fields)]
    for number, field in enumerate(fields):
        if plan.style in ("half glazed", "high window") and number == len(fields) - 1:
            shapes += glazing(field, hinge_side, plan.thickness, plan.paint, bars=_bars(plan))
        elif plan.style == "louvres":
            shapes += _slats(plan, hinge_side, field)
        else:
            shapes += _panel(plan, hinge_side, field)
    return tuple(shapes)


def at_field(field: Field, hinge_side: int) -> tuple[float, float, float, float]:
    """Returns centre y, z and half extents of a rectangle, in the leaf link's frame."""
    u0, u1, v0, v1 = field
    return -hinge_side * (GAP + (u0 + u1) / 2), (v0 + v1) / 2, (u1 - u0) / 2, (v1 - v0) / 2


def _fields(plan: LeafPlan) -> list[Field]:
    """Returns the openings between stiles and rails, from bottom to top."""
    left, right, h, s = plan.stile, plan.width - plan.stile, plan.height, plan.stile
    middle, rail = plan.width / 2, 0.9 * plan.stile
    columns = [(left, right)]
    if plan.style in ("four panels", "six panels", "eight panels"):
        columns = [(left, middle - 0.022), (middle + 0.022, right)]
    low, mid, high = 1.3 * s, 0.48 * h, h - s
    special = {
        "one panel": [(low, high)],
        "six panels": [(low, mid - rail), (mid + rail, 0.79 * h), (0.79 * h + 0.045, high)],
        "ladder": [(low, 0.24 * h), (0.24 * h + 0.05, mid - rail), (mid + rail, 0.75 * h), (0.75 * h + 0.05, high)],
        "eight panels": [
            (low, 0.24 * h), (0.24 * h + 0.04, mid - rail), (mid + rail, 0.75 * h), (0.75 * h + 0.04, high),
        ],
        "high window": [(low, mid - rail), (0.70 * h, high)],
    }  # fmt: skip
    rows = special.get(plan.style, [(low, mid - rail), (mid + rail, high)])
    return [(u0, u1, v0, v1) for v0, v1 in rows for u0, u1 in columns]


def _members(plan: LeafPlan, fields: Sequence[Field]) -> list[Field]:
    """Returns full-height stiles, and the rails (and a muntin) between the fields."""
    left, right = min(f[0] for f in fields), max(f[1] for f in fields)
    members: list[Field] = [(0.0, left, 0.0, plan.height), (right, plan.width, 0.0, plan.height)]
    rows = sorted({(f[2], f[3]) for f in fields})
    edges = [0.0, *(edge for row in rows for edge in row), plan.height]
    members += [(left, right, edges[i], edges[i + 1]) for i in range(0, len(edges), 2)]
    columns = sorted({(f[0], f[1]) for f in fields})
    if len(columns) == 2:
        members += [(columns[0][1], columns[1][0], v0, v1) for v0, v1 in rows]
    return members


def _member(plan: LeafPlan, hinge_side: int, field: Field) -> Shape:
    y, z, a, b = at_field(field, hinge_side)
    half = plan.thickness / 2
    return chamfered_box((-half, y, z), (half, a, b), 0.0025, plan.paint)


def _panel(plan: LeafPlan, hinge_side: int, field: Field) -> list[Shape]:
    """Returns a recessed panel; some leaves have a raised middle, as on a classical door."""
    y, z, a, b = at_field(field, hinge_side)
    back = (plan.thickness - RECESS) / 2
    shapes = [box((-RECESS - back, y, z), (back, a, b), plan.paint)]
    if plan.seed % 2 and min(a, b) > 0.04:
        margin = 0.024
        half = (RECESS / 2, a - margin, b - margin)
        shapes.append(chamfered_box((-RECESS, y, z), half, 0.006, plan.paint, collides=False))
    return shapes


def _bars(plan: LeafPlan) -> tuple[int, int]:
    return ((0, 0), (1, 1), (1, 0), (2, 1))[plan.seed % 4]


def glazing(field: Field, hinge_side: int, thickness: float, paint: Material, *, bars: tuple[int, int]) -> list[Shape]:
    """Returns a pane with a glint in a bead, with ``bars`` (vertical, horizontal) glazing bars."""
    y, z, a, b = at_field(field, hinge_side)
    x = -0.5 * thickness
    shapes = [box((x, y, z), (0.004, a, b), GLASS)]
    shapes += _glints(x + 0.0045, y, z, a, b)
    bar = 0.0075
    for i in range(bars[0]):
        at = (x + 0.006, y + (2 * (i + 1) / (bars[0] + 1) - 1) * a, z)
        shapes.append(chamfered_box(at, (0.008, bar, b), 0.002, paint, collides=False))
    for i in range(bars[1]):
        at = (x + 0.006, y, z + (2 * (i + 1) / (bars[1] + 1) - 1) * b)
        shapes.append(chamfered_box(at, (0.008, a, bar), 0.002, paint, collides=False))
    return shapes


def _glints(x: float, y: float, z: float, a: float, b: float) -> list[Shape]:
    """Returns two diagonal reflections, which mark glass in images without transparency."""
    tilt, reach = np.deg2rad(35.0), 0.62 * min(a, b)
    shapes = []
    for offset, half in ((-0.10, 0.16), (0.22, 0.06)):
        rotation = rotation_about((1.0, 0.0, 0.0), -tilt)
        pose = transform((x, y + offset * a, z + 0.30 * b), rotation)
        shapes.append(Shape("box", (0.0006, half * min(a, b), reach * 0.8), pose, GLINT, collides=False))
    return shapes


def _slab(plan: LeafPlan, hinge_side: int) -> tuple[Shape, ...]:
    """Returns one board; a planked one has dark joints and two ledges."""
    y, z, a, b = at_field((0.0, plan.width, 0.0, plan.height), hinge_side)
    half = plan.thickness / 2
    shapes = [chamfered_box((-half, y, z), (half, a, b), 0.003, plan.paint)]
    dark = Material(tuple(0.35 * np.asarray(plan.paint.color)), 0.9)
    if plan.style == "planks":
        count = 4 + plan.seed % 2
        for i in range(1, count):
            at = (0.0, y + (2 * i / count - 1) * a, z)
            shapes.append(mark(at, (0.0012, 0.0018, b - 0.002), dark))
        for share in (0.12, 0.86):
            at = (0.004, y, share * plan.height)
            shapes.append(chamfered_box(at, (0.006, a - 0.016, 0.036), 0.003, plan.paint, collides=False))
    elif plan.seed % 3 == 0:
        # Vision panel: a narrow vertical pane on the hinge side of the handle.
        u0, v0 = 0.36 * plan.width, 0.60 * plan.height
        pane = (u0, u0 + 0.085, v0, 0.90 * plan.height)
        y, z, a, b = at_field(pane, hinge_side)
        rim = chamfered_box((0.001, y, z), (0.004, a + 0.010, b + 0.010), 0.002, dark, collides=False)
        shapes += [rim, mark((0.0048, y, z), (0.0008, a, b), GLASS)]
        shapes += _glints(0.0056, y, z, a, b)
    return tuple(shapes)


def _slats(plan: LeafPlan, hinge_side: int, field: Field) -> list[Shape]:
    """Returns louvres in front of a dark backing."""
    y, z, a, b = at_field(field, hinge_side)
    shade = Material(tuple(0.25 * np.asarray(plan.paint.color)), 0.9)
    shapes = [box((-plan.thickness + 0.004, y, z), (0.004, a, b), shade)]
    pitch = 0.034
    count = int(2 * b / pitch)
    tilt = rotation_about((0.0, 1.0, 0.0), np.deg2rad(38.0))
    for i in range(count):
        pose = transform((-0.014, y, z + (i + 0.5 - count / 2) * 2 * b / count), tilt)
        shapes.append(Shape("box", (0.0165, a, 0.003), pose, plan.paint, collides=False))
    return shapes
