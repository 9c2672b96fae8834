"""Novel pressure cookers: bowls and chamfered pots under cones and plateaus, with bells and twin valves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Material
from lerobot_adamanip.objects.pressure_cooker import PressureCookerDesign, build_pressure_cooker, draw_design

BODY_STYLES = ("bowl", "chamfered")
LID_STYLES = ("cone", "plateau")
VALVE_STYLES = ("bell", "twin")
_COLORS = ((0.02, 0.30, 0.34), (0.55, 0.30, 0.42), (0.36, 0.17, 0.06), (0.55, 0.50, 0.06), (0.20, 0.10, 0.34))


def draw_novel_design(rng: np.random.Generator) -> PressureCookerDesign:
    """Draws a cooker wider and lower, or slimmer and taller, than any seen one, in new styles all over."""
    base = draw_design(rng)
    wide = rng.random() < 0.5
    radius = rng.uniform(0.126, 0.134) if wide else rng.uniform(0.082, 0.090)
    color = Material(_COLORS[rng.integers(len(_COLORS))], 0.25, 0.1)
    return replace(
        base,
        radius=radius,
        height=rng.uniform(0.098, 0.116) if wide else rng.uniform(0.188, 0.21),
        body_style=str(rng.choice(BODY_STYLES)),
        lid_style=str(rng.choice(LID_STYLES)),
        lid_rise=rng.uniform(0.026, 0.038),
        valve_style=str(rng.choice(VALVE_STYLES)),
        handle_style="banded",
        body=color,
        lid=color if rng.random() < 0.5 else base.steel,
    )


def make_novel_pressure_cooker(number: int) -> ArticulatedObject:
    """Builds novel cooker ``number``."""
    design = draw_novel_design(np.random.default_rng([number, 0xC270, 1]))
    return build_pressure_cooker(f"pressure_cooker_n{number:03d}", design)
