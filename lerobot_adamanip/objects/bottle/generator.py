"""Bottles: turned bodies of many kinds, with a cap to unscrew and lift off."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.objects.base import (
    ArticulatedObject,
    Joint,
    Link,
    Material,
    Pose,
    Shape,
    annotate,
    any_roll,
    from_above,
    kind_of,
)
from lerobot_adamanip.objects.bottle.caps import Cap, cap_shapes
from lerobot_adamanip.objects.bottle.labels import Label, draw_label, label_shapes
from lerobot_adamanip.objects.bottle.recipes import CAP_LOOKS, FINISHES, NOVEL_RECIPES, RECIPES, Finish, Recipe
from lerobot_adamanip.objects.geometry.lathe import Ring, ring_at, turned
from lerobot_adamanip.objects.geometry.shapes import rod

LIFT_UPPER = 0.05
"""Lift travel of a loose cap [m] (paper code: 0.05)."""
CAP_RANGE = 2.35
"""Nominal turn of a cap to either side [rad] (paper code: 2.35)."""
CAP_GAP = 0.0008
"""Gap between the neck and the cap [m]."""
FINGER_TIP = 0.0125
"""Distance of a grip from the parts below the cap [m]: fingers reach 9 mm below the point between their pads."""
GRIP_BELOW_TOP = 0.02
"""Distance of a grip from the upper edge of a tall cap [m]: the pads fit on the cap without contact of the palm."""
_STREAM = 0xB0771E


@dataclass(frozen=True)
class BottleDesign:
    """Parameters of one bottle [m].

    Attributes:
        kind: a name of `RECIPES`.
        rings: profile of the body, from the foot to the end of the neck below the cap.
        shoulder: height at which the body ends and the shoulder begins.
        cap: the cap.
        finish: look of the body.
        fill: height of the visible content.
        label: the label.
        handle: side of a jug's handle (-1 or 1), or 0.
    """

    kind: str
    rings: tuple[Ring, ...]
    shoulder: float
    cap: Cap
    finish: Finish
    fill: float
    label: Label
    handle: int

    @property
    def neck_top(self) -> float:
        """Height of the cap's lower edge [m]."""
        return self.rings[-1].height + CAP_GAP


def draw_design(rng: np.random.Generator, kind: str, recipes: Mapping[str, Recipe] = RECIPES) -> BottleDesign:
    """Samples the parameters of one bottle; ``kind`` is a name of ``recipes``."""
    recipe = recipes[kind]
    cap = Cap(
        kind=str(rng.choice(recipe.caps)),
        radius=rng.uniform(*recipe.cap_radius),
        height=rng.uniform(*recipe.cap_height),
        look=CAP_LOOKS[str(rng.choice(recipe.cap_colors))],
        ribs=int(rng.integers(24, 40)),
    )
    below = rng.uniform(*recipe.height) - cap.height
    shoulder, neck = rng.uniform(*recipe.shoulder) * below, rng.uniform(*recipe.neck) * below
    rings = _profile(rng, recipe, cap, (below, shoulder, neck))
    return BottleDesign(
        kind=kind,
        rings=rings,
        shoulder=shoulder,
        cap=cap,
        finish=FINISHES[str(rng.choice(recipe.finishes))],
        fill=shoulder + rng.uniform(-0.15, 0.6) * (neck - shoulder),
        label=draw_label(rng, str(rng.choice(recipe.labels))),
        handle=int(rng.choice([-1, 1])) if recipe.handle and rng.random() < 0.6 else 0,
    )


def _profile(
    rng: np.random.Generator, recipe: Recipe, cap: Cap, heights: tuple[float, float, float]
) -> tuple[Ring, ...]:
    """Returns foot, wall, shoulder and neck, from bottom to top."""
    below, shoulder, neck = heights
    radius, depth, square, taper, waist, foot = (
        rng.uniform(*values)
        for values in (recipe.radius, recipe.depth, recipe.squareness, recipe.taper, recipe.waist, recipe.foot)
    )
    ribs = int(rng.choice(recipe.ribs))
    neck_radius = cap.radius * rng.uniform(*recipe.neck_radius)
    rings = []
    for turn in np.linspace(0.0, np.pi / 2, 4):
        inset = foot * (1 - np.sin(turn))
        rings.append(Ring(foot * (1 - np.cos(turn)), radius * taper - inset, depth, square))
    for part in np.linspace(0.0, 1.0, 2 + (8 if waist else 0) + 4 * ribs)[1:]:
        drawn_in = 1 - waist * np.sin(np.pi * part) ** 2 - (0.022 if ribs else 0) * np.sin(np.pi * ribs * part) ** 2
        width = radius * (taper + (1 - taper) * part) * drawn_in
        rings.append(Ring(foot + part * (shoulder - foot), width, depth, square))
    for part in np.linspace(0.0, 1.0, 9)[1:]:
        share = _rise(recipe.rise, part)
        shape = depth + (1 - depth) * (1 - share), square * share
        rings.append(Ring(shoulder + part * (neck - shoulder), neck_radius + (radius - neck_radius) * share, *shape))
    bead = min(0.003, 0.4 * (below - neck))
    if below - neck > 0.006:
        rings.append(Ring(below - bead, neck_radius))
        rings.append(Ring(below - bead + 1e-5, max(neck_radius, 1.03 * cap.radius)))
    rings.append(Ring(below, rings[-1].radius))
    return tuple(rings)


def _rise(kind: str, part: float) -> float:
    """Returns the remaining fraction of the body's width at the fraction ``part`` of the shoulder's height."""
    if kind == "cone":
        return float(1 - part)
    if kind == "round":
        return float(np.sqrt(max(0.0, 1 - part**1.8)))
    return float(0.5 * (1 + np.cos(np.pi * part**1.15)))


def make_bottle(number: int) -> ArticulatedObject:
    """Builds bottle ``number`` (32 in the paper's set; any number is an object)."""
    design = draw_design(np.random.default_rng([number, _STREAM]), kind_of(number, tuple(RECIPES), _STREAM))
    return build_bottle(f"bottle_{number:03d}", design)


def make_novel_bottle(number: int) -> ArticulatedObject:
    """Builds novel bottle ``number``."""
    kind = kind_of(number, tuple(NOVEL_RECIPES), _STREAM + 1)
    return build_bottle(
        f"bottle_n{number:03d}", draw_design(np.random.default_rng([number, _STREAM, 1]), kind, NOVEL_RECIPES)
    )


def build_bottle(object_id: str, design: BottleDesign) -> ArticulatedObject:
    """Builds links and annotation of a design: joints ``lift`` and ``cap``, part ``cap``."""
    front = max(design.cap.radius, *(ring.radius * ring.depth for ring in design.rings))
    half_width = max(ring.radius for ring in design.rings) + (HANDLE_REACH if design.handle else 0.0)
    at = (-front, 0.0)
    origin = (*at, design.neck_top)
    plug = Shape("cylinder", (0.6 * design.cap.radius, 0.002), _upright(0.006), design.cap.look, collides=False)
    lift = Joint("lift", "prismatic", (0, 0, 1), origin, (0.0, LIFT_UPPER), damping=4.0)
    links = (
        Link("body", _body_shapes(design, at), mass=1.5),
        Link("plug", (plug,), 0.01, "body", lift),
        Link(
            "cap", cap_shapes(design.cap), 0.03, "plug",
            Joint("cap", "revolute", (0, 0, 1), (0, 0, 0), (-CAP_RANGE, CAP_RANGE), damping=0.01),
        ),
    )  # fmt: skip
    grip = max(FINGER_TIP, design.cap.height - GRIP_BELOW_TOP, 0.5 * design.cap.height)
    grasp = from_above((*at, design.neck_top + grip))
    parts = (annotate(links, "cap", "cap", grasp, any_roll()),)
    size = (float(2 * half_width), float(2 * front), float(design.neck_top + design.cap.whole_height))
    return ArticulatedObject(object_id, "bottle", links, parts, size, f"{design.kind} bottle, {design.cap.kind} cap")


HANDLE_REACH = 0.034
"""Protrusion of a jug's handle from its body [m]."""


def _upright(height: float) -> Pose:
    """Returns the pose of a cylinder about z at ``height`` [m]."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
    pose[2, 3] = height
    return pose


def _body_shapes(design: BottleDesign, at: tuple[float, float]) -> tuple[Shape, ...]:
    finish = design.finish
    wall = Material(finish.wall, finish.roughness, finish.metallic)
    inside = wall if finish.content is None else Material(finish.content, finish.roughness)
    below = tuple(ring for ring in design.rings if ring.height < design.fill)
    above = tuple(ring for ring in design.rings if ring.height > design.fill)
    surface = ring_at(design.rings, design.fill)
    rings = (*below, surface, *above)
    shapes = turned(rings, lambda height: inside if height < design.fill else wall, axis=at)
    shapes += _finish_shapes(design, at, wall)
    shapes += label_shapes(design.label, design.rings, design.shoulder, at)
    if design.handle:
        shapes += _handle_shapes(design, at, wall)
    return shapes


def _finish_shapes(design: BottleDesign, at: tuple[float, float], wall: Material) -> tuple[Shape, ...]:
    """Returns thread and mouth, visible once the cap is off; they do not collide, because the cap is solid."""
    base, radius, height = design.neck_top, 0.86 * design.cap.radius, min(0.016, design.cap.height - 0.003)
    low = base - CAP_GAP
    shapes = turned((Ring(low, radius), Ring(low + height, radius)), wall, axis=at, collides=False)
    for thread in (0.35, 0.65):
        middle = low + thread * height
        ring = (Ring(middle - 0.0008, 1.06 * radius), Ring(middle + 0.0008, 1.06 * radius))
        shapes += turned(ring, wall, axis=at, collides=False)
    mouth = (Ring(low + height, 0.78 * radius), Ring(low + height + 0.0002, 0.78 * radius))
    return shapes + turned(mouth, Material((0.02, 0.02, 0.02), 0.9), axis=at, collides=False)


def _handle_shapes(design: BottleDesign, at: tuple[float, float], wall: Material) -> tuple[Shape, ...]:
    """Returns a jug's handle at its side, well below the hand."""
    top, bottom = 0.98 * design.shoulder, 0.42 * design.shoulder
    inner = ring_at(design.rings, bottom).radius - 0.004
    outer = inner + HANDLE_REACH - 0.004
    corners = [(inner, top), (outer - 0.006, top), (outer, top - 0.012), (outer, bottom + 0.02), (inner, bottom)]
    points = [(at[0], design.handle * y, z) for y, z in corners]
    return tuple(rod(first, last, 0.007, wall) for first, last in itertools.pairwise(points))
