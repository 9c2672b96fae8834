"""Novel bottles: trades, shoulders and caps that no seen bottle has."""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, kind_of
from lerobot_adamanip.objects.bottle.generator import build_bottle, draw_design
from lerobot_adamanip.objects.bottle.recipes import Recipe

RECIPES: dict[str, Recipe] = {
    "laboratory flask": Recipe(
        (0.15, 0.18), (0.046, 0.052), (0.08, 0.14), (0.74, 0.80), "cone", (0.86, 0.92), (0.0160, 0.0185),
        (0.026, 0.032), ("smooth", "dome"), ("frosted glass", "green sauce", "blue water"), ("blue", "red", "orange"),
        ("pharmacy", "minimal"),
    ),
    "decanter": Recipe(
        (0.19, 0.22), (0.044, 0.049), (0.30, 0.38), (0.78, 0.84), "cone", (0.84, 0.90), (0.0150, 0.0165),
        (0.024, 0.030), ("ball",), ("amber glass", "cola", "olive oil"), ("silver", "gold", "steel"), ("diamond",),
        squareness=(0.3, 0.9),
    ),
    "perfume": Recipe(
        (0.105, 0.125), (0.030, 0.036), (0.74, 0.82), (0.92, 0.95), "round", (0.82, 0.90), (0.0150, 0.0180),
        (0.022, 0.026), ("ball", "dome"), ("frosted glass", "blue glass", "berry drink", "straw glass"),
        ("gold", "copper", "black"), ("minimal",), depth=(0.46, 0.54), squareness=(0.6, 1.0),
    ),
    "preserve jar": Recipe(
        (0.105, 0.120), (0.036, 0.041), (0.78, 0.84), (0.93, 0.96), "round", (0.92, 0.97), (0.0246, 0.0256),
        (0.020, 0.024), ("fluted", "beaker"), ("chilli", "orange drink", "green sauce", "berry drink"),
        ("gold", "red", "white"), ("dairy", "oval"), ribs=(3, 4),
    ),
    "canteen": Recipe(
        (0.19, 0.22), (0.050, 0.056), (0.62, 0.68), (0.88, 0.92), "round", (0.84, 0.90), (0.0195, 0.0225),
        (0.024, 0.030), ("ball", "fluted"), ("green steel", "steel", "brown plastic"), ("black", "steel"),
        ("badge",), depth=(0.42, 0.5),
    ),
    "dumbbell": Recipe(
        (0.20, 0.235), (0.038, 0.043), (0.74, 0.80), (0.93, 0.95), "round", (0.84, 0.92), (0.0165, 0.019),
        (0.028, 0.034), ("dome", "smooth"), ("lime plastic", "coral plastic", "smoke plastic", "lilac plastic"),
        ("orange", "navy", "pink"), ("wave",), waist=(0.24, 0.30), foot=(0.008, 0.012),
    ),
    "bell": Recipe(
        (0.16, 0.19), (0.036, 0.041), (0.60, 0.68), (0.86, 0.90), "ogee", (0.84, 0.92), (0.0165, 0.0195),
        (0.026, 0.032), ("ball", "smooth"), ("teal plastic", "mint plastic", "blush plastic", "black plastic"),
        ("copper", "silver", "white"), ("oval", "minimal"), taper=(1.05, 1.07),
    ),
}  # fmt: skip
_STREAM = 0xB0771E


def make_novel_bottle(number: int) -> ArticulatedObject:
    """Builds novel bottle ``number``."""
    kind = kind_of(number, tuple(RECIPES), _STREAM + 1)
    return build_bottle(
        f"bottle_n{number:03d}", draw_design(np.random.default_rng([number, _STREAM, 1]), kind, RECIPES)
    )
