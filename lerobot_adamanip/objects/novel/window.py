"""Novel windows: tall slits and broad sashes with denser glazing bars, and handles that no seen window has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Material
from lerobot_adamanip.objects.fittings.handles import METALS, draw_handle
from lerobot_adamanip.objects.window import WindowDesign, build_window, draw_design

BARS = ((2, 2), (1, 3), (2, 1), (2, 0), (0, 4))
HANDLE_STYLES = ("paddle lever", "ball lever", "octagon knob", "cross bar")
_COLORS = ((0.62, 0.30, 0.06), (0.34, 0.10, 0.30), (0.56, 0.54, 0.12), (0.03, 0.30, 0.34), (0.70, 0.36, 0.42))


def draw_novel_design(rng: np.random.Generator) -> WindowDesign:
    """Draws a window narrower and taller, or wider and lower, than any seen one, bars and handle in new styles."""
    base = draw_design(rng)
    tall = rng.random() < 0.5
    height = rng.uniform(0.54, 0.62) if tall else rng.uniform(0.29, 0.34)
    color = np.asarray(_COLORS[rng.integers(len(_COLORS))]) * rng.uniform(0.9, 1.1)
    return replace(
        base,
        width=rng.uniform(0.25, 0.285) if tall else rng.uniform(0.39, 0.42),
        height=height,
        bars=BARS[rng.integers(len(BARS))],
        handle=draw_handle(rng, HANDLE_STYLES, 0.0, METALS),
        handle_v=height * rng.uniform(0.46, 0.54),
        frame=Material(tuple(np.clip(color, 0.02, 0.86)), rng.uniform(0.35, 0.65)),
    )


def make_novel_window(number: int) -> ArticulatedObject:
    """Builds novel window ``number``."""
    return build_window(f"window_n{number:03d}", draw_novel_design(np.random.default_rng([number, 0x51D0, 1])))
