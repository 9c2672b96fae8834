"""Pens, upright in a desk stand with the cap on top: it is turned loose and pulled off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.contract.rotations import rotation_with_x_along, transform
from lerobot_adamanip.objects.base import (
    TWO_FINGERS,
    ArticulatedObject,
    Joint,
    Link,
    Material,
    Shape,
    annotate,
    from_above,
    kind_of,
)
from lerobot_adamanip.objects.geometry.shapes import moved, rotated
from lerobot_adamanip.objects.pen.parts import Pen, barrel_shapes, cap_shapes, tip_shapes
from lerobot_adamanip.objects.pen.recipes import (
    LOOKS,
    NOVEL_RECIPES,
    NOVEL_STANDS,
    PLAINS,
    RECIPES,
    SOCKETS,
    STANDS,
    STONES,
    WOODS,
    Recipe,
)
from lerobot_adamanip.objects.pen.stands import Stand, draw_stand, stand_shapes

LIFT_UPPER = 0.05
"""Pull-off travel of a loose cap [m] (paper code: 0.05)."""
CAP_RANGE = 2.35
"""Nominal turn of a cap to either side [rad] (paper code: 2.35)."""
GRIP_BELOW_END = 0.016
"""Distance of a grip from the cap's narrowing end [m]: the pads extend one centimetre to either side."""
CLIP_ROLLS = (0.0, np.pi, 0.2, np.pi + 0.2, -0.2, np.pi - 0.2)
"""Rolls at which fingers avoid the clip [rad]."""
CLIP_TURN, CLIP_SPREAD = np.pi / 4, 0.38
"""Middle and half width of the clip's azimuth from +x [rad], such that a hand that avoids the clip can turn equally far
in both directions."""
SUNK = 0.7
"""Fraction of the stand's height that the barrel fills."""
_STREAM = 0x9E17


@dataclass(frozen=True)
class PenDesign:
    """Parameters of one pen and its stand; ``clip_turn`` is the azimuth of the clip from +x [rad]."""

    pen: Pen
    stand: Stand
    clip_turn: float


def draw_design(
    rng: np.random.Generator, kind: str, recipes: Mapping[str, Recipe] = RECIPES, stands: Sequence[str] = STANDS
) -> PenDesign:
    """Samples a pen and its stand; the kinds are names of ``recipes`` and of ``stands``."""
    recipe = recipes[kind]
    barrel = LOOKS[str(rng.choice(recipe.barrels))]
    cap = LOOKS[str(rng.choice(recipe.caps))] if recipe.caps else barrel
    trim = str(rng.choice(recipe.trims)) if recipe.trims else ""
    radius = rng.uniform(*recipe.cap_radius)
    pen = Pen(
        kind=kind,
        radius=radius,
        length=rng.uniform(*recipe.cap_length),
        end=str(rng.choice(recipe.ends)),
        clip=str(rng.choice(recipe.clips)),
        tip=recipe.tip,
        barrel_radius=radius * rng.uniform(*recipe.barrel_ratio),
        exposed=rng.uniform(*recipe.exposed),
        sides=recipe.sides,
        depth=rng.uniform(*recipe.depth),
        squareness=rng.uniform(*recipe.squareness),
        ribbed=recipe.ribbed,
        print=recipe.print,
        cap=cap,
        barrel=barrel,
        trim=LOOKS[trim] if trim else cap,
    )
    turn = CLIP_TURN + rng.uniform(-1, 1) * CLIP_SPREAD
    return PenDesign(pen, draw_stand(rng, str(rng.choice(stands)), _stand_materials(rng)), turn)


def _stand_materials(rng: np.random.Generator) -> tuple[Material, Material, Material]:
    family = (WOODS, STONES, PLAINS)[rng.integers(3)]
    extra = PLAINS[rng.integers(len(PLAINS))]
    return family[rng.integers(len(family))], LOOKS[str(rng.choice(SOCKETS))], extra


def make_pen(number: int) -> ArticulatedObject:
    """Builds pen ``number`` (36 in the paper's set; any number is an object)."""
    design = draw_design(np.random.default_rng([number, _STREAM]), kind_of(number, tuple(RECIPES), _STREAM))
    return build_pen(f"pen_{number:03d}", design)


def make_novel_pen(number: int) -> ArticulatedObject:
    """Builds novel pen ``number``."""
    kind = kind_of(number, tuple(NOVEL_RECIPES), _STREAM + 1)
    design = draw_design(np.random.default_rng([number, _STREAM, 1]), kind, NOVEL_RECIPES, NOVEL_STANDS)
    return build_pen(f"pen_n{number:03d}", design)


def build_pen(object_id: str, design: PenDesign) -> ArticulatedObject:
    """Builds links and annotation of a design: joints ``lift`` and ``cap``, part ``cap``."""
    pen, stand = design.pen, design.stand
    lip = stand.top + pen.exposed
    origin = (*stand.axis, lip)
    upright = transform((0, 0, 0.005), rotation_with_x_along((0.0, 0.0, 1.0)))
    plug = Shape("cylinder", (0.5 * pen.radius * pen.depth, 0.002), upright, pen.cap, collides=False)
    lift = Joint("lift", "prismatic", (0, 0, 1), origin, (0.0, LIFT_UPPER), damping=4.0)
    links = (
        Link("body", _body_shapes(design, lip), mass=0.8),
        Link("plug", (plug,), 0.005, "body", lift),
        Link(
            "cap", rotated(cap_shapes(pen), (0.0, 0.0, 1.0), design.clip_turn), 0.012, "plug",
            Joint("cap", "revolute", (0, 0, 1), (0, 0, 0), (-CAP_RANGE, CAP_RANGE), damping=0.006),
        ),
    )  # fmt: skip
    # The hand looks down, so roll and azimuth have opposite signs.
    grasp = from_above((*stand.axis, lip + pen.length - GRIP_BELOW_END), roll=-design.clip_turn)
    # Almost rectangular caps are gripped at their sides, not at their corners.
    rolls = TWO_FINGERS if pen.squareness else CLIP_ROLLS
    parts = (annotate(links, "cap", "cap", grasp, rolls),)
    size = (float(stand.width), float(stand.depth), float(lip + pen.cap_height))
    description = f"{pen.kind}, {'no' if pen.clip == 'none' else pen.clip} clip, {stand.kind}"
    return ArticulatedObject(object_id, "pen", links, parts, size, description)


def _body_shapes(design: PenDesign, lip: float) -> tuple[Shape, ...]:
    """Returns stand and barrel; the barrel's print faces the same way as the clip."""
    pen, stand = design.pen, design.stand
    bottom = (1 - SUNK) * stand.height
    hole = pen.barrel_radius * (1.0 if pen.sides else 0.97)
    standing = barrel_shapes(pen, bottom, lip, (0.0, 0.0)) + tip_shapes(pen, lip, (0.0, 0.0))
    turned_pen = rotated(standing, (0.0, 0.0, 1.0), design.clip_turn)
    return stand_shapes(stand, hole) + moved(turned_pen, transform((*stand.axis, 0.0)))
