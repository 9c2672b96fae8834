"""Novel pens: stouter, flatter or three-sided, without a clip or with another kind's, in stands no seen pen has."""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, kind_of
from lerobot_adamanip.objects.pen.generator import build_pen, draw_design
from lerobot_adamanip.objects.pen.recipes import Recipe

RECIPES: dict[str, Recipe] = {
    "glue stick": Recipe(
        (0.0118, 0.0132), (0.034, 0.039), (0.98, 1.03), (0.040, 0.052), ("flat",), ("none",), "felt",
        ("white", "yellow", "orange"), ("blue", "red", "purple"), (), print="stripe",
    ),
    "lip gloss": Recipe(
        (0.0084, 0.0096), (0.034, 0.040), (0.90, 0.98), (0.042, 0.052), ("finial", "dome"), ("none",), "brush",
        ("pink", "burgundy", "clear"), ("gold", "rose gold", "black"), ("silver", "gold"),
    ),
    "three-sided pen": Recipe(
        (0.0076, 0.0088), (0.046, 0.054), (0.76, 0.84), (0.056, 0.068), ("cone", "dome"), ("none", "bar"), "ball",
        ("sky", "green", "orange", "purple"), ("white", "grey", "yellow"), ("silver",), sides=3,
    ),
    "paint marker": Recipe(
        (0.0112, 0.0124), (0.048, 0.056), (0.99, 1.04), (0.046, 0.058), ("cone", "finial"), ("arrow", "ball"),
        "chisel", ("steel", "gunmetal"), ("teal", "brown", "orange", "pink"), ("gunmetal",), print="rings",
    ),
    "flat pen": Recipe(
        (0.0100, 0.0112), (0.052, 0.060), (0.94, 0.99), (0.050, 0.062), ("flat",), ("none",), "nib",
        ("tortoise", "teal", "forest"), ("silver", "gold"), (), depth=(0.54, 0.60), squareness=(0.6, 1.0),
        print="column",
    ),
}  # fmt: skip
STANDS = ("steps", "cone")
_STREAM = 0x9E17


def make_novel_pen(number: int) -> ArticulatedObject:
    """Builds novel pen ``number``."""
    kind = kind_of(number, tuple(RECIPES), _STREAM + 1)
    design = draw_design(np.random.default_rng([number, _STREAM, 1]), kind, RECIPES, STANDS)
    return build_pen(f"pen_n{number:03d}", design)
