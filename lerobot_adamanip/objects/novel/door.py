"""Novel doors: ladders, eight panels and high windows, levers that stand up, crosses and octagons, new proportions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Material
from lerobot_adamanip.objects.door import DoorDesign, build_door, draw_design
from lerobot_adamanip.objects.fittings.handles import METALS, draw_handle

STYLES = ("ladder", "eight panels", "high window")
HANDLE_STYLES = ("paddle lever", "ball lever", "octagon knob", "cross bar")
_COLORS = ((0.62, 0.22, 0.34), (0.24, 0.10, 0.34), (0.62, 0.60, 0.16), (0.02, 0.22, 0.20), (0.74, 0.32, 0.10))


def draw_novel_design(rng: np.random.Generator) -> DoorDesign:
    """Draws a door narrower and lower, or wider and taller, than any seen one, leaf and handle in new styles."""
    base = draw_design(rng)
    small = rng.random() < 0.5
    color = np.asarray(_COLORS[rng.integers(len(_COLORS))]) * rng.uniform(0.85, 1.1)
    height = rng.uniform(0.74, 0.82) if small else rng.uniform(1.10, 1.20)
    plan = replace(
        base.plan,
        width=rng.uniform(0.325, 0.355) if small else rng.uniform(0.431, 0.437),
        height=height,
        style=str(rng.choice(STYLES)),
        paint=Material(tuple(np.clip(color, 0.02, 0.85)), base.plan.paint.roughness),
    )
    # A lever that stands up at rest, or points to the hinges: never down.
    rest = np.pi if rng.random() < 0.5 else base.hinge_side * np.pi / 2
    handle = draw_handle(rng, HANDLE_STYLES, rest, METALS)
    return replace(
        base,
        plan=plan,
        handle=handle,
        backset=base.backset if small else rng.uniform(0.053, 0.060),
        handle_v=height * rng.uniform(0.45, 0.52),
        extra="none",
    )


def make_novel_door(number: int) -> ArticulatedObject:
    """Builds novel door ``number``."""
    return build_door(f"door_n{number:03d}", draw_novel_design(np.random.default_rng([number, 0xD008, 1])))
