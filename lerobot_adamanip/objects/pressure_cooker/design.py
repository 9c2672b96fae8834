"""The parameters of a pressure cooker, and how they are drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import Material
from lerobot_adamanip.objects.drawing import chance, chosen, computed, draw, picked, uniform

_STEELS = (
    Material((0.80, 0.81, 0.83), 0.25, 0.7), Material((0.66, 0.67, 0.69), 0.32, 0.75),
    Material((0.76, 0.75, 0.72), 0.42, 0.7),
)  # fmt: skip
_ENAMELS = (
    Material((0.50, 0.02, 0.025), 0.25, 0.1), Material((0.03, 0.08, 0.22), 0.25, 0.1),
    Material((0.04, 0.20, 0.12), 0.25, 0.1), Material((0.60, 0.20, 0.02), 0.25, 0.1),
    Material((0.70, 0.68, 0.60), 0.25, 0.1), Material((0.07, 0.07, 0.075), 0.35, 0.2),
)  # fmt: skip
_PLASTICS = tuple(
    Material(color, 0.45)
    for color in ((0.018, 0.018, 0.02), (0.05, 0.05, 0.055), (0.11, 0.02, 0.015), (0.09, 0.05, 0.03))
)
_ACCENTS = tuple(
    Material(color, 0.35) for color in ((0.65, 0.05, 0.02), (0.75, 0.38, 0.02), (0.05, 0.30, 0.10), (0.60, 0.60, 0.62))
)
BODY_STYLES = ("straight", "bellied", "tapered")
LID_STYLES = ("dome", "stepped", "flat")
VALVE_STYLES = ("weight", "indicator", "dial")
HANDLE_STYLES = ("straight", "tapered", "moulded")

NOVEL_BODY_STYLES = ("bowl", "chamfered")
NOVEL_LID_STYLES = ("cone", "plateau")
NOVEL_VALVE_STYLES = ("bell", "twin")
NOVEL_COLORS = ((0.02, 0.30, 0.34), (0.55, 0.30, 0.42), (0.36, 0.17, 0.06), (0.55, 0.50, 0.06), (0.20, 0.10, 0.34))


@dataclass(frozen=True, kw_only=True)
class PressureCookerDesign:
    """The parameters of one cooker [m]. The grip is far enough out for a hand to clear the dome."""

    radius: float = uniform(0.092, 0.124)
    handle_reach: float = uniform(0.066, 0.078)
    steel: Material = picked(_STEELS)
    enamel: Material = picked(_ENAMELS)
    coloured: bool = chance(0.45)
    height: float = computed(lambda rng, d: float(np.clip(2 * d.radius * rng.uniform(0.58, 0.88), 0.12, 0.185)))
    body_style: str = chosen(BODY_STYLES)
    lid_style: str = chosen(LID_STYLES)
    lid_rise: float = uniform(0.024, 0.042)
    valve_style: str = chosen(VALVE_STYLES)
    handle_style: str = chosen(HANDLE_STYLES)
    handle_length: float = computed(lambda rng, d: d.handle_reach + rng.uniform(0.045, 0.075))
    handle_half: tuple[float, float] = computed(
        lambda rng, d: (rng.uniform(0.011, 0.0145), rng.uniform(0.0105, 0.0135))
    )
    helper_loop: bool = chance(0.75)
    band: bool = chance(0.5)
    body: Material = computed(lambda rng, d: d.enamel if d.coloured else d.steel)
    lid: Material = computed(lambda rng, d: d.steel if not d.coloured or rng.random() < 0.7 else d.enamel)
    plastic: Material = picked(_PLASTICS)
    accent: Material = picked(_ACCENTS)

    @property
    def axis_x(self) -> float:
        """Where the pot's axis is: a radius behind its front [m]."""
        return -self.radius

    @property
    def handle_z(self) -> float:
        """Height of the lid handle's middle [m]."""
        return self.height + 0.002 + self.handle_half[1]

    @property
    def grip_radius(self) -> float:
        """Distance of the grip from the pot's axis [m]."""
        return self.radius + self.handle_reach


def draw_novel_design(rng: np.random.Generator) -> PressureCookerDesign:
    """Draws a cooker wider and lower, or slimmer and taller, than any seen one, in new styles all over."""
    base = draw(PressureCookerDesign, rng)
    wide = rng.random() < 0.5
    radius = rng.uniform(0.126, 0.134) if wide else rng.uniform(0.082, 0.090)
    color = Material(NOVEL_COLORS[rng.integers(len(NOVEL_COLORS))], 0.25, 0.1)
    return replace(
        base,
        radius=radius,
        height=rng.uniform(0.098, 0.116) if wide else rng.uniform(0.188, 0.21),
        body_style=str(rng.choice(NOVEL_BODY_STYLES)),
        lid_style=str(rng.choice(NOVEL_LID_STYLES)),
        lid_rise=rng.uniform(0.026, 0.038),
        valve_style=str(rng.choice(NOVEL_VALVE_STYLES)),
        handle_style="banded",
        body=color,
        lid=color if rng.random() < 0.5 else base.steel,
    )
