"""Novel microwaves: portholes, new handles and buttons, ovens taller for their width than any seen one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lerobot_adamanip.objects.base import Material
from lerobot_adamanip.objects.microwave.generator import MicrowaveDesign, draw_design
from lerobot_adamanip.objects.microwave.looks import BLACK, CHROME, STEEL, Look

HANDLE_STYLES = ("fin", "ball bar")


def _look(name: str, color: tuple[float, float, float], panel: Material, controls: str) -> Look:
    paint = Material(color, 0.35)
    return Look(name, paint, paint, panel, CHROME, STEEL, CHROME, "porthole", controls)


LOOKS = (
    _look("orange", (0.70, 0.24, 0.03), Material((0.70, 0.24, 0.03), 0.35), "dials"),
    _look("navy and steel", (0.02, 0.05, 0.16), STEEL, "keypad"),
    _look("pink", (0.74, 0.34, 0.40), Material((0.80, 0.80, 0.79), 0.4), "retro"),
    _look("olive and black", (0.20, 0.24, 0.06), BLACK, "touch"),
)


def draw_novel_design(rng: np.random.Generator) -> MicrowaveDesign:
    """Draws a small or a large oven of new proportions, with new handle, button and window."""
    base = draw_design(rng)
    width = rng.uniform(0.35, 0.375) if rng.random() < 0.5 else rng.uniform(0.495, 0.52)
    height = rng.uniform(0.30, 0.335)
    panel = float(np.clip(width * rng.uniform(0.24, 0.27), 0.094, 0.130))
    half, length = rng.uniform(0.019, 0.023), rng.uniform(0.12, 0.19)
    return replace(
        base,
        width=width,
        height=height,
        depth=width * rng.uniform(0.66, 0.76),
        panel=panel,
        hinge_side=int(rng.choice([-1, 1])),
        handle_style=str(rng.choice(HANDLE_STYLES)),
        handle_length=length,
        handle_z=height / 2 + rng.uniform(0.0, 0.02),
        button_style="octagon",
        button_half=(half, half),
        button_z=half + rng.uniform(0.024, 0.034),
        look=LOOKS[rng.integers(len(LOOKS))].varied(rng),
    )
