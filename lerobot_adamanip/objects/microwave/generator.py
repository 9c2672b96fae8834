"""Microwave ovens: a door with window and bar handle, and a control panel with a button that may release the door.

Sizes follow countertop ovens of 17 to 28 litres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Shape, annotate, facing
from lerobot_adamanip.objects.drawing import chosen, computed, draw, uniform
from lerobot_adamanip.objects.geometry.rounded import plate
from lerobot_adamanip.objects.geometry.shapes import box, chamfered_box, disk, dot, mark, prism, rod
from lerobot_adamanip.objects.microwave.looks import (
    BLACK,
    CHROME,
    LOOKS,
    STEEL,
    Face,
    Look,
    door_front,
    handle_shapes,
    panel_shapes,
)

WALL = 0.018
DOOR_THICKNESS = 0.030
GAP = 0.003
DOOR_UPPER = 1.578
"""Opening limit of the door [rad] (paper code: 1.578)."""
GRASP_REACH = 0.052
"""Distance of the handle's grip from the door [m]; leaves space for the hand in front of the panel."""
FINGER_TIP = 0.010
"""Length of the fingers beyond the tool centre point [m]; closed fingers push with their tips."""
POCKET = 0.045
"""Depth of the well behind the button [m]."""
SPRING, SPRING_REST = 250.0, -0.01
"""Stiffness of the button's spring [N/m] and its slack position [m]; presses the button outwards with 2.5 N."""
HANDLE_STYLES = ("round bar", "flat bar", "bow", "pull")
BUTTON_STYLES = ("bar", "round", "square")
NOVEL_HANDLE_STYLES = ("fin", "ball bar")


def _porthole(name: str, color: tuple[float, float, float], panel: Material, controls: str) -> Look:
    paint = Material(color, 0.35)
    return Look(name, paint, paint, panel, CHROME, STEEL, CHROME, "porthole", controls)


NOVEL_LOOKS = (
    _porthole("orange", (0.70, 0.24, 0.03), Material((0.70, 0.24, 0.03), 0.35), "dials"),
    _porthole("navy and steel", (0.02, 0.05, 0.16), STEEL, "keypad"),
    _porthole("pink", (0.74, 0.34, 0.40), Material((0.80, 0.80, 0.79), 0.4), "retro"),
    _porthole("olive and black", (0.20, 0.24, 0.06), BLACK, "touch"),
)


@dataclass(frozen=True, kw_only=True)
class MicrowaveDesign:
    """The parameters of one microwave [m].

    Attributes:
        hinge_side: -1 hinges on the left as seen from the front (y < 0), +1 on the right.
        panel: width of the control panel.
        handle_inset: distance of the grip from the door's free edge.
        handle_z, button_z: heights above the oven's underside.
        button_half: half extents (y, z) of the button's face.
        button_out: protrusion of the face from the panel; about a millimetre less than `button_travel`.
    """

    width: float = computed(lambda rng, d: rng.uniform(*((0.38, 0.43) if rng.random() < 0.35 else (0.43, 0.49))))
    height: float = computed(lambda rng, d: float(np.clip(d.width * rng.uniform(0.53, 0.62), 0.225, 0.295)))
    button_travel: float = uniform(0.012, 0.016)
    button_style: str = chosen(BUTTON_STYLES, p=(0.5, 0.25, 0.25))
    panel: float = computed(lambda rng, d: float(np.clip(d.width * rng.uniform(0.23, 0.27), 0.098, 0.122)))
    button_half: tuple[float, float] = computed(lambda rng, d: _draw_button_half(rng, d.button_style, d.panel))
    handle_length: float = computed(lambda rng, d: rng.uniform(0.13, 0.70 * d.height))
    depth: float = computed(lambda rng, d: d.width * rng.uniform(0.70, 0.80))
    foot: float = uniform(0.010, 0.018)
    hinge_side: int = computed(lambda rng, d: 1 if rng.random() < 0.14 else -1)
    handle_style: str = chosen(HANDLE_STYLES)
    handle_inset: float = uniform(0.026, 0.036)
    handle_z: float = computed(
        lambda rng, d: d.height / 2 + rng.uniform(0.0, min(0.02, (d.height - d.handle_length) / 2 - 0.02))
    )
    handle_radius: float = uniform(0.008, 0.011)
    button_z: float = computed(lambda rng, d: d.button_half[1] + rng.uniform(0.022, 0.030))
    button_out: float = computed(lambda rng, d: d.button_travel - rng.uniform(0.0, 0.002))
    look: Look = computed(lambda rng, d: LOOKS[rng.integers(len(LOOKS))].varied(rng))

    @property
    def door_width(self) -> float:
        """Width of the door [m]."""
        return self.width - self.panel - GAP

    def y(self, u: float) -> float:
        """Returns the y of a point ``u`` [m] from the hinge side of the front."""
        return self.hinge_side * (self.width / 2 - u)

    @property
    def handle_u(self) -> float:
        """Distance of the grip from the hinge, along the door [m]."""
        return self.door_width - self.handle_inset

    @property
    def panel_y(self) -> float:
        """Centre y of the panel [m]."""
        return self.y(self.width - self.panel / 2)


def draw_novel_design(rng: np.random.Generator) -> MicrowaveDesign:
    """Samples a small or large oven with new proportions, handle, button and window."""
    base = draw(MicrowaveDesign, rng)
    width = rng.uniform(0.35, 0.375) if rng.random() < 0.5 else rng.uniform(0.495, 0.52)
    height = rng.uniform(0.30, 0.335)
    panel = float(np.clip(width * rng.uniform(0.24, 0.27), 0.094, 0.130))
    half, length = rng.uniform(0.019, 0.023), rng.uniform(0.12, 0.19)
    return replace(
        base,
        width=width,
        height=height,
        depth=width * rng.uniform(0.66, 0.76),
        panel=panel,
        hinge_side=int(rng.choice([-1, 1])),
        handle_style=str(rng.choice(NOVEL_HANDLE_STYLES)),
        handle_length=length,
        handle_z=height / 2 + rng.uniform(0.0, 0.02),
        button_style="octagon",
        button_half=(half, half),
        button_z=half + rng.uniform(0.024, 0.034),
        look=NOVEL_LOOKS[rng.integers(len(NOVEL_LOOKS))].varied(rng),
    )


def _draw_button_half(rng: np.random.Generator, style: str, panel: float) -> tuple[float, float]:
    wide, round_, square = rng.uniform(0.028, 0.036), rng.uniform(0.018, 0.023), rng.uniform(0.017, 0.021)
    half_y, half_z = {"bar": (wide, rng.uniform(0.014, 0.018)), "round": (round_,) * 2, "square": (square,) * 2}[style]
    return min(half_y, panel / 2 - 0.014), half_z


def build_microwave(object_id: str, design: MicrowaveDesign) -> ArticulatedObject:
    """Builds links and annotations of a design: joints ``door`` and ``button``, parts ``handle`` and ``button``."""
    links = (Link("body", _body_shapes(design), mass=12.0), _leaf(design), _button(design))
    grip = (GRASP_REACH, design.y(design.handle_u), design.foot + design.handle_z)
    face = (design.button_out + FINGER_TIP, design.panel_y, design.foot + design.button_z)
    parts = (
        annotate(links, "leaf", "handle", facing(grip)),
        # Fingers one above the other: the hand is 20 cm long in this direction, and would otherwise hit the handle.
        annotate(links, "button", "button", facing(face, np.pi / 2)),
    )
    look, side = design.look, "left" if design.hinge_side < 0 else "right"
    words = (look.name, look.controls, design.handle_style, f"{design.button_style} button", f"hinge {side}")
    size = (design.width, design.depth, design.height + design.foot)
    return ArticulatedObject(object_id, "microwave", links, parts, size, ", ".join(words))


def _leaf(design: MicrowaveDesign) -> Link:
    grip = (GRASP_REACH, -design.hinge_side * design.handle_u, design.handle_z - design.height / 2)
    shapes = _door_shapes(design) + handle_shapes(
        design.handle_style, grip, design.handle_length, design.handle_radius, design.look.handle
    )
    origin = (0.0, design.y(0.0), design.foot + design.height / 2)
    axis = (0.0, 0.0, float(design.hinge_side))
    joint = Joint("door", "revolute", axis, origin, (0.0, DOOR_UPPER), damping=0.6)
    return Link("leaf", shapes, 1.8, "body", joint)


def _button(design: MicrowaveDesign) -> Link:
    origin = (0.0, design.panel_y, design.foot + design.button_z)
    inward, travel = (-1.0, 0.0, 0.0), (0.0, design.button_travel)
    joint = Joint("button", "prismatic", inward, origin, travel, damping=4.0, stiffness=SPRING, rest=SPRING_REST)
    return Link("button", _button_shapes(design), 0.05, "body", joint)


def _body_shapes(design: MicrowaveDesign) -> tuple[Shape, ...]:
    """Returns cabinet, cavity, control panel around the button's well, vents and feet."""
    w, h, d, t = design.width, design.height, design.depth, WALL / 2
    z, body = design.foot + h / 2, design.look.body
    # The door covers the cabinet; the panel is beside it.
    front, back = -DOOR_THICKNESS - 0.002, -d
    middle, half = (front + back) / 2, (front - back) / 2
    cavity = w - design.panel - WALL
    shapes = [
        chamfered_box((middle, 0, design.foot + t), (half, w / 2, t), 0.004, body),
        chamfered_box((middle, 0, design.foot + h - t), (half, w / 2, t), 0.004, body),
        chamfered_box((middle, design.y(t), z), (half, t, h / 2), 0.004, body),
        box((back + t, 0, z), (t, w / 2 - t, h / 2 - t), body),
        # Compartment of the electronics, behind the panel.
        box(
            ((back - POCKET) / 2, design.y(w - design.panel / 2), z),
            ((-POCKET - back) / 2, design.panel / 2, h / 2 - 0.001),
            body,
        ),
    ]
    liner = Material((0.60, 0.60, 0.58), 0.5)
    u = WALL + cavity / 2
    top, bottom = z + h / 2 - WALL, z - h / 2 + WALL
    shapes += [
        mark((middle, design.y(u), bottom), (half, cavity / 2, 0.001), liner),
        mark((middle, design.y(u), top), (half, cavity / 2, 0.001), liner),
        mark((middle, design.y(WALL), z), (half, 0.001, h / 2 - WALL), liner),
        mark((middle, design.y(WALL + cavity), z), (half, 0.0015, h / 2 - WALL), liner),
        mark((back + 2 * t, design.y(u), z), (0.001, cavity / 2, h / 2 - WALL), liner),
    ]
    return tuple(shapes) + _turntable(design, middle, u, bottom) + _panel_block(design) + _trimmings(design)


def _turntable(design: MicrowaveDesign, x: float, u: float, bottom: float) -> tuple[Shape, ...]:
    radius = min(0.135, 0.42 * (design.width - design.panel - 2 * WALL), 0.42 * design.depth)
    glass, mica = Material((0.62, 0.70, 0.72), 0.15), Material((0.45, 0.38, 0.28), 0.8)
    y = design.y(u)
    disc = [
        rod((x, y, bottom + low), (x, y, bottom + high), r, glass, round_ends=False)
        for low, high, r in ((0.0, 0.008, 0.02), (0.008, 0.012, radius), (0.012, 0.016, 0.9 * radius))
    ]
    guide = box((x, design.y(design.width - design.panel - 0.002), bottom + 0.09), (0.05, 0.0015, 0.03), mica)
    return (*disc, guide)


def _panel_block(design: MicrowaveDesign) -> tuple[Shape, ...]:
    """Returns four blocks around the button's well, with the printed controls."""
    face, w, h = design.look.panel, design.panel, design.height
    y, low, high = design.panel_y, design.foot, design.foot + h
    bz, (by, bh) = design.foot + design.button_z, design.button_half
    clear = 0.002
    below, above = bz - bh - clear, bz + bh + clear
    side = (w / 2 - by - clear) / 2
    x = POCKET / 2
    shapes = [
        box((-x, y, (low + below) / 2), (x, w / 2, (below - low) / 2), face),
        box((-x, y, (above + high) / 2), (x, w / 2, (high - above) / 2), face),
        *(box((-x, y + s * (w / 2 - side), bz), (x, side, bh + clear), face) for s in (-1, 1)),
    ]
    return tuple(shapes) + panel_shapes(design.look, Face(y, above + 0.012, high, w))


def _trimmings(design: MicrowaveDesign) -> tuple[Shape, ...]:
    """Vents in the sides, feet."""
    dark = Material((0.02, 0.02, 0.022), 0.9)
    w, d, h = design.width, design.depth, design.height
    shapes = []
    for side in (-1, 1):
        for row in range(6):
            at = (-0.72 * d, side * w / 2, design.foot + (0.62 + 0.045 * row) * h)
            shapes.append(mark(at, (0.028, 0.0008, 0.0022), dark))
    for column in range(7):
        at = (-0.78 * d + 0.014 * column, 0.28 * w, design.foot + h)
        shapes.append(mark(at, (0.0028, 0.04, 0.0008), dark))
    for x in (-0.05, -d + 0.04):
        for y in (-w / 2 + 0.045, w / 2 - 0.045):
            shapes.append(rod((x, y, 0), (x, y, design.foot), 0.014, dark, round_ends=False))
    return tuple(shapes)


def _door_shapes(design: MicrowaveDesign) -> tuple[Shape, ...]:
    """Returns the door in its own frame: hinge at the origin, front at x = 0."""
    half_w, half_h, half_t = design.door_width / 2, design.height / 2 - 0.0015, DOOR_THICKNESS / 2
    middle = -design.hinge_side * half_w
    look = design.look
    slab_ = chamfered_box((-half_t, middle, 0), (half_t, half_w, half_h), 0.003, look.door)
    choke = plate((-DOOR_THICKNESS, middle, 0), (0.001, half_w - 0.02, half_h - 0.02), 0.008, BLACK, collides=False)
    free = design.handle_inset + 0.024
    return (slab_, choke, *door_front(look, middle, (half_w, half_h), free, -design.hinge_side))


def _button_shapes(design: MicrowaveDesign) -> tuple[Shape, ...]:
    """Returns the button in its own frame: x out of the panel, zero at the panel's face."""
    half_y, half_z = design.button_half
    back, out = -0.024, design.button_out
    center, half = (back + out) / 2, (out - back) / 2
    material = design.look.button
    if design.button_style == "round":
        rim = dot((out - 0.0035, 0, 0), half_z + 0.0015, 0.0008, design.look.trim)
        return (disk((center, 0, 0), half_z, half, material), rim)
    if design.button_style == "octagon":
        rim = dot((out - 0.001, 0, 0), 0.45 * half_z, 0.0013, design.look.trim)
        return (prism((center, 0, 0), half_z, half, 8, material), rim)
    radius = 0.004 if design.button_style == "square" else 0.45 * half_z
    line = mark((out, 0, 0), (0.0003, 0.35 * half_y, 0.0012), design.look.trim)
    return (plate((center, 0, 0), (half, half_y, half_z), radius, material, bevel=0.002), line)
