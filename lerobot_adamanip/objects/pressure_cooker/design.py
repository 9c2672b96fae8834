"""The parameters of a pressure cooker, and how they are drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import Material

_STEELS = (
    Material((0.80, 0.81, 0.83), 0.25, 0.7),
    Material((0.66, 0.67, 0.69), 0.32, 0.75),
    Material((0.76, 0.75, 0.72), 0.42, 0.7),
)
_ENAMELS = (
    Material((0.50, 0.02, 0.025), 0.25, 0.1),
    Material((0.03, 0.08, 0.22), 0.25, 0.1),
    Material((0.04, 0.20, 0.12), 0.25, 0.1),
    Material((0.60, 0.20, 0.02), 0.25, 0.1),
    Material((0.70, 0.68, 0.60), 0.25, 0.1),
    Material((0.07, 0.07, 0.075), 0.35, 0.2),
)
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


@dataclass(frozen=True)
class PressureCookerDesign:
    """The parameters of one cooker [m]."""

    radius: float
    height: float
    body_style: str
    lid_style: str
    lid_rise: float
    valve_style: str
    handle_style: str
    handle_reach: float
    handle_length: float
    handle_half: tuple[float, float]
    helper_loop: bool
    band: bool
    body: Material
    lid: Material
    steel: Material
    plastic: Material
    accent: Material

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


def draw_design(rng: np.random.Generator) -> PressureCookerDesign:
    """Draws the parameters of one cooker. The grip is far enough out for a hand to clear the dome."""
    radius = rng.uniform(0.092, 0.124)
    reach = rng.uniform(0.066, 0.078)
    steel = _STEELS[rng.integers(len(_STEELS))]
    enamel = _ENAMELS[rng.integers(len(_ENAMELS))]
    coloured = rng.random() < 0.45
    return PressureCookerDesign(
        radius=radius,
        height=float(np.clip(2 * radius * rng.uniform(0.58, 0.88), 0.12, 0.185)),
        body_style=str(rng.choice(BODY_STYLES)),
        lid_style=str(rng.choice(LID_STYLES)),
        lid_rise=rng.uniform(0.024, 0.042),
        valve_style=str(rng.choice(VALVE_STYLES)),
        handle_style=str(rng.choice(HANDLE_STYLES)),
        handle_reach=reach,
        handle_length=reach + rng.uniform(0.045, 0.075),
        handle_half=(rng.uniform(0.011, 0.0145), rng.uniform(0.0105, 0.0135)),
        helper_loop=bool(rng.random() < 0.75),
        band=bool(rng.random() < 0.5),
        body=enamel if coloured else steel,
        lid=steel if not coloured or rng.random() < 0.7 else enamel,
        steel=steel,
        plastic=_PLASTICS[rng.integers(len(_PLASTICS))],
        accent=_ACCENTS[rng.integers(len(_ACCENTS))],
    )


def draw_novel_design(rng: np.random.Generator) -> PressureCookerDesign:
    """Draws a cooker wider and lower, or slimmer and taller, than any seen one, in new styles all over."""
    base = draw_design(rng)
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
