"""Pressure cookers: a pot, a domed lid with a valve, and two long handles over each other. Sizes of 3 to 8 litre pots.

The lid's handle stands over the pot's, as on a closed cooker, and turns either way before the lid can be lifted off.
Which way and how far is drawn per episode by the mechanism and leaves no trace in the geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, annotate, from_above
from lerobot_adamanip.objects.pressure_cooker.parts import LOOP_DEPTH, lid_shapes, pot_shapes, seal_shapes

LID_RANGE = 0.824
"""Nominal turn of the lid to either side [rad] (paper code)."""
LIFT_UPPER = 0.05
"""How far the lid lifts [m] (paper code)."""

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


def make_pressure_cooker(number: int) -> ArticulatedObject:
    """Builds cooker ``number`` (6 in the paper's set; any number is an object)."""
    design = draw_design(np.random.default_rng([number, 0xC270]))
    return build_pressure_cooker(f"pressure_cooker_{number:03d}", design)


def build_pressure_cooker(object_id: str, design: PressureCookerDesign) -> ArticulatedObject:
    """Builds the links and the annotation of a design: joints ``lift`` and ``lid``, part ``handle`` (the lid's)."""
    rim = (design.axis_x, 0.0, design.height)
    up = (0.0, 0.0, 1.0)
    # An arm reaching down gives by half a millimetre per newton: a lid of sheet aluminium, as light as real ones are.
    lift = Joint("lift", "prismatic", up, rim, (0.0, LIFT_UPPER), friction=0.3, damping=8.0)
    lid = Joint("lid", "revolute", up, (0.0, 0.0, 0.0), (-LID_RANGE, LID_RANGE), friction=0.15, damping=0.15)
    links = (
        Link("pot", pot_shapes(design), mass=2.5),
        Link("seal", seal_shapes(design), mass=0.05, parent="pot", joint=lift),
        Link("lid", lid_shapes(design), mass=0.4, parent="seal", joint=lid),
    )
    grip = (design.axis_x + design.grip_radius, 0.0, design.handle_z + 0.002)
    depth = 2 * design.radius + (LOOP_DEPTH if design.helper_loop else 0.0)
    return ArticulatedObject(
        object_id,
        "pressure_cooker",
        links,
        (annotate(links, "lid", "handle", from_above(grip)),),
        (2 * design.radius, depth, design.height + design.lid_rise + 0.035),
        f"{design.body_style} pot, {design.lid_style} lid, {design.valve_style} valve, {design.handle_style} handle",
    )
