"""Lamps for desk and bedside: a base, a stem behind or beside the switch, a head; the switch is a button or a knob.

The type is hidden: the mechanism samples it per episode, and the geometry is the same. The switch stands apart from
stem and head, because a hand that turns it from above sweeps a circle of 21 cm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.objects.base import (
    ArticulatedObject,
    Joint,
    Link,
    Material,
    Shape,
    annotate,
    any_roll,
    from_above,
)
from lerobot_adamanip.objects.drawing import chosen, computed, uniform
from lerobot_adamanip.objects.geometry.rounded import revolved, slab
from lerobot_adamanip.objects.geometry.shapes import box, mark, rod, without_collision
from lerobot_adamanip.objects.lamp.heads import BRASS, HAND_CLEARANCE, HEADS, METALS, PAINTS, WIDE, WOODS, Head, Place

BASE_STYLES = ("plate", "block", "stadium", "discs")
KNOB_STYLES = ("smooth", "knurled", "faceted")
CAP_HEIGHT = 0.034
"""Height of the graspable part of the switch [m]."""
GRIP_DEPTH = 0.013
"""Depth of the tool centre point below the top of the switch [m]."""
SPRING, SPRING_REST = 150.0, -0.012
"""Spring of the button [N/m], and its slack position above rest [m]: it supports the cap with 1.8 N and returns it."""


@dataclass(frozen=True, kw_only=True)
class LampDesign:
    """Parameters of one lamp [m, rad].

    Attributes:
        bearing: direction from the switch to the stem, relative to straight backwards [rad].
        distance: distance of the stem's foot from the switch.
        head: style, size and colours of everything above the base.
        thickness: thickness of the base.
        travel: travel of the switch as a button.
        turn_range: range of the switch as a knob, to either side.
    """

    drawn: tuple[float, Head] = computed(
        lambda rng, _: _draw_bearing(rng, Head.drawn(rng, str(rng.choice(list(HEADS)))))
    )
    bearing: float = computed(lambda rng, d: d.drawn[0])
    head: Head = computed(lambda rng, d: d.drawn[1])
    base_style: str = chosen(BASE_STYLES)
    base: Material = computed(lambda rng, d: _draw_base(rng, d.base_style, d.head.metal))
    distance: float = computed(lambda rng, d: d.head.clear_distance(HAND_CLEARANCE) + rng.uniform(0.0, 0.012))
    thickness: float = computed(
        lambda rng, d: rng.uniform(*((0.026, 0.036) if d.base_style == "block" else (0.013, 0.020)))
    )
    knob_style: str = chosen(KNOB_STYLES)
    knob_radius: float = uniform(0.011, 0.020)
    knob: Material = computed(lambda rng, d: (*METALS, BRASS, d.head.metal, PAINTS[0], WOODS[0])[rng.integers(8)])
    travel: float = uniform(0.020, 0.024)
    turn_range: float = uniform(1.25, 1.57)

    @property
    def knob_margin(self) -> float:
        """Distance from the switch's axis to the edge of the base [m]."""
        return self.knob_radius + 0.022

    def place(self) -> Place:
        """Returns the positions of stem and switch on the base, with front x = 0 and middle y = 0."""
        away = np.array([-np.cos(self.bearing), np.sin(self.bearing)])
        foot, foot_margin = self.distance * away, self.head.foot_margin
        lower = np.minimum(-self.knob_margin, foot - foot_margin)
        upper = np.maximum(self.knob_margin, foot + foot_margin)
        shift = np.array([-upper[0], -(lower[1] + upper[1]) / 2])
        return Place(shift, shift + foot, away, (upper - lower) / 2, self.thickness)


def _draw_bearing(rng: np.random.Generator, head: Head) -> tuple[float, Head]:
    bearing = rng.uniform(-0.4, 0.4)
    if rng.random() < 0.4 and head.style not in WIDE:
        bearing = rng.choice([-1, 1]) * rng.uniform(1.15, 1.5)
        # An arm beside the switch points backwards: the robot's arm is in front of it.
        head = replace(head, side=int(np.sign(bearing)))
    return float(bearing), head


def _draw_base(rng: np.random.Generator, style: str, metal: Material) -> Material:
    wooden = style in ("plate", "block") and rng.random() < 0.35
    looks = WOODS if wooden else (metal, metal, *PAINTS)
    return looks[rng.integers(len(looks))]


def build_lamp(object_id: str, design: LampDesign) -> ArticulatedObject:
    """Builds links and annotation of a design: joints ``button`` and ``knob``, both carrying the part ``knob``."""
    place = design.place()
    body = _base_shapes(design, place) + design.head.shapes(place)
    switch = (float(place.switch[0]), float(place.switch[1]), design.thickness)
    top = design.travel + 0.006 + CAP_HEIGHT
    travel, down = (0.0, design.travel), (0.0, 0.0, -1.0)
    push = Joint("button", "prismatic", down, switch, travel, damping=4.0, stiffness=SPRING, rest=SPRING_REST)
    turn = Joint("knob", "revolute", limits=(-design.turn_range, design.turn_range), damping=0.01)
    links = (
        Link("base", body, mass=2.5),
        Link("plunger", _plunger_shapes(design, top), 0.03, "base", push),
        Link("knob", _knob_shapes(design, top), 0.05, "plunger", turn),
    )
    grip = (switch[0], switch[1], switch[2] + top - GRIP_DEPTH)
    parts = (annotate(links, "knob", "knob", from_above(grip), any_roll()),)
    lower, upper = _bounds(body)
    size = (2 * float(np.abs([lower[1], upper[1]]).max()), -float(lower[0]), float(upper[2]))
    words = f"{design.head.style}, {design.base_style} base, {design.knob_style} switch"
    return ArticulatedObject(object_id, "lamp", links, parts, size, words)


def _base_shapes(design: LampDesign, place: Place) -> tuple[Shape, ...]:
    half_x, half_y = place.half
    t, material = design.thickness, design.base
    center = (-half_x, 0.0, t / 2)
    rubber = Material((0.02, 0.02, 0.022), 0.9)
    rosette = revolved(
        (*place.switch, t - 0.0005),
        ((design.knob_radius + 0.006, 0.0), (design.knob_radius + 0.005, 0.0015)),
        design.knob,
        collides=False,
    )
    if design.base_style == "discs":
        margin = design.head.foot_margin
        angle = np.arctan2(place.away[1], place.away[0])
        middle = (place.switch + place.foot) / 2
        bridge = box((0, 0, 0), (design.distance / 2, 0.016, t / 2), material)
        bridge.pose_in_link[:3, :3] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        bridge.pose_in_link[:3, 3] = (*middle, t / 2)
        rounds = [
            revolved((*at, 0.0), ((r, 0.0), (r, t - 0.003), (r - 0.003, t)), material, sides=48)
            for at, r in ((place.switch, design.knob_margin), (place.foot, margin))
        ]
        return (*rounds, bridge, rosette)
    if design.base_style == "stepped":
        low = slab((-half_x, 0.0, 0.2 * t), (half_x, half_y, 0.2 * t), 0.006, material, bevel=0.002)
        high = slab((-half_x, 0.0, 0.7 * t), (half_x - 0.012, half_y - 0.012, 0.3 * t), 0.006, material, bevel=0.003)
        return (low, high, rosette)
    radius = {"plate": 0.010, "block": 0.016, "stadium": 0.95 * min(half_x, half_y)}[design.base_style]
    top = slab(
        center, (half_x, half_y, t / 2), radius, material, bevel=0.004 if design.base_style == "block" else 0.002
    )
    feet = slab((-half_x, 0.0, 0.0004), (half_x - 0.006, half_y - 0.006, 0.0006), radius, rubber, collides=False)
    return (top, feet, rosette)


def _plunger_shapes(design: LampDesign, top: float) -> tuple[Shape, ...]:
    """Returns the shaft under the cap, which sinks into the base; decoration, because the cap is gripped."""
    end, radius = (0, 0, top - CAP_HEIGHT), design.knob_radius
    shaft = rod((0, 0, 0.0), end, 0.62 * radius, METALS[0], round_ends=False)
    collar = rod((0, 0, top - CAP_HEIGHT - 0.004), end, 0.85 * radius, METALS[1], round_ends=False)
    return without_collision((shaft, collar))


def _knob_shapes(design: LampDesign, top: float) -> tuple[Shape, ...]:
    """Returns the cap: equal from every grasp side, and symmetric for both turning directions."""
    radius, low = design.knob_radius, top - CAP_HEIGHT
    sides = {"faceted": 8, "fluted": 16}.get(design.knob_style, 32)
    profile = ((radius, low), (radius, top - 0.004), (radius - 0.003, top))
    shapes = [revolved((0, 0, 0), profile, design.knob, sides=sides)]
    if design.knob_style == "knurled":
        dark = Material((0.05, 0.05, 0.052), 0.6)
        for angle in np.arange(20) * 2 * np.pi / 20:
            x, y = radius * np.cos(angle), radius * np.sin(angle)
            groove = rod((x, y, low + 0.004), (x, y, top - 0.007), 0.0008, dark, round_ends=False)
            shapes += without_collision([groove])
    pale = sum(design.knob.color) > 1.5
    ink = Material((0.05, 0.05, 0.05), 0.5) if pale else Material((0.85, 0.84, 0.80), 0.5)
    shapes.append(mark((0.45 * radius, 0, top), (0.28 * radius, 0.0011, 0.0004), ink))
    return tuple(shapes)


def _bounds(shapes: tuple[Shape, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the lower and upper corner (3,) of the box around shapes [m]."""
    corners = []
    for shape in shapes:
        if shape.vertices is not None:
            local = shape.vertices.astype(np.float64)
        else:
            half = shape.size
            if shape.kind != "box":
                radius, along = shape.size
                half = (along + (radius if shape.kind == "capsule" else 0.0), radius, radius)
            local = np.array(np.meshgrid(*[(-h, h) for h in half])).reshape(3, -1).T
        corners.append(local @ shape.pose_in_link[:3, :3].T + shape.pose_in_link[:3, 3])
    stacked = np.concatenate(corners)
    return stacked.min(axis=0), stacked.max(axis=0)
