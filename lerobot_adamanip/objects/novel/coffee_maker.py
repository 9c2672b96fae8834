"""Novel coffee makers: slim and barrel-shaped machines with new panels, boilers and ball-ended handles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Material
from lerobot_adamanip.objects.coffee_maker.design import BLACK, CoffeeMakerDesign, draw_design
from lerobot_adamanip.objects.coffee_maker.generator import build_coffee_maker

PANEL_STYLES = ("twin gauge", "slot")
_COLORS = ((0.72, 0.30, 0.04), (0.30, 0.05, 0.20), (0.10, 0.28, 0.10), (0.72, 0.54, 0.10), (0.20, 0.36, 0.56))


def draw_novel_design(rng: np.random.Generator) -> CoffeeMakerDesign:
    """Draws a machine slimmer, or wider and lower, than any seen one, in new styles all over."""
    base = draw_design(rng)
    slim = rng.random() < 0.5
    body = Material(_COLORS[rng.integers(len(_COLORS))], rng.uniform(0.25, 0.45), 0.1)
    return replace(
        base,
        width=rng.uniform(0.175, 0.195) if slim else rng.uniform(0.31, 0.345),
        height=base.group_z + (rng.uniform(0.16, 0.19) if slim else rng.uniform(0.105, 0.114)),
        depth=rng.uniform(0.335, 0.36) if slim else rng.uniform(0.23, 0.248),
        head_x=-rng.uniform(0.022, 0.034),
        body_style="slim" if slim else "barrel",
        panel_style=str(rng.choice(PANEL_STYLES)),
        top_style="boiler",
        handle_style="ball end",
        body=body,
        base=BLACK if rng.random() < 0.5 else body,
    )


def make_novel_coffee_maker(number: int) -> ArticulatedObject:
    """Builds novel machine ``number``."""
    design = draw_novel_design(np.random.default_rng([number, 0xCAFA, 1]))
    return build_coffee_maker(f"coffee_maker_n{number:03d}", design)
