"""Novel safes: tall wall safes and low drawer safes, with fins and ball-ended bars, hexagons and crosses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Material
from lerobot_adamanip.objects.safe import MIN_PART_DISTANCE, WALL, SafeDesign, build_safe, draw_design

HANDLE_STYLES = ("fin", "ball bar")
KNOB_STYLES = ("hexagon", "cross")
_COLORS = ((0.62, 0.30, 0.05), (0.02, 0.28, 0.30), (0.44, 0.20, 0.34), (0.70, 0.58, 0.16), (0.34, 0.46, 0.24))


def draw_novel_design(rng: np.random.Generator) -> SafeDesign:
    """Draws a safe narrower and taller, or wider and lower, than any seen one, handle and knob in new styles."""
    base = draw_design(rng)
    tall = rng.random() < 0.5
    width = rng.uniform(0.29, 0.33) if tall else rng.uniform(0.47, 0.50)
    height = rng.uniform(0.49, 0.56) if tall else rng.uniform(0.27, 0.31)
    color = np.asarray(_COLORS[rng.integers(len(_COLORS))])
    door = np.clip(color * rng.uniform(0.75, 1.4), 0.02, 0.8)
    handle_uv, knob_uv = _draw_layout(rng, width - 2 * WALL, height - 2 * WALL)
    return replace(
        base,
        width=width,
        height=height,
        handle_style=str(rng.choice(HANDLE_STYLES)),
        knob_style=str(rng.choice(KNOB_STYLES)),
        handle_length=rng.uniform(0.11, 0.14) if tall else rng.uniform(0.09, 0.11),
        handle_uv=handle_uv,
        knob_uv=knob_uv,
        body=Material(tuple(color), base.body.roughness, 0.2),
        door=Material(tuple(door), base.door.roughness, 0.3),
    )


def _draw_layout(
    rng: np.random.Generator, width: float, height: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Handle and knob beside each other on a wide door, over each other on a tall one."""
    while True:
        handle = (rng.uniform(0.66, 0.80), rng.uniform(0.30, 0.62))
        knob = (rng.uniform(0.30, 0.66), rng.uniform(0.24, 0.76))
        if np.hypot((handle[0] - knob[0]) * width, (handle[1] - knob[1]) * height) >= 1.03 * MIN_PART_DISTANCE:
            return handle, knob


def make_novel_safe(number: int) -> ArticulatedObject:
    """Builds novel safe ``number``."""
    return build_safe(f"safe_n{number:03d}", draw_novel_design(np.random.default_rng([number, 0x5AFE, 1])))
