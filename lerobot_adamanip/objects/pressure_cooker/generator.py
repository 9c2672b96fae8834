"""Pressure cookers: a pot, a domed lid with a valve, and two long handles over each other. Sizes of 3 to 8 litre pots.

The lid's handle stands over the pot's, as on a closed cooker, and turns either way before the lid can be lifted off.
"""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, annotate, from_above
from lerobot_adamanip.objects.pressure_cooker.design import PressureCookerDesign, draw_design, draw_novel_design
from lerobot_adamanip.objects.pressure_cooker.parts import LOOP_DEPTH, lid_shapes, pot_shapes, seal_shapes

LID_RANGE = 0.824
"""Nominal turn of the lid to either side [rad] (paper code)."""
LIFT_UPPER = 0.05
"""How far the lid lifts [m] (paper code)."""


def make_pressure_cooker(number: int) -> ArticulatedObject:
    """Builds cooker ``number`` (6 in the paper's set; any number is an object)."""
    design = draw_design(np.random.default_rng([number, 0xC270]))
    return build_pressure_cooker(f"pressure_cooker_{number:03d}", design)


def make_novel_pressure_cooker(number: int) -> ArticulatedObject:
    """Builds novel cooker ``number``."""
    design = draw_novel_design(np.random.default_rng([number, 0xC270, 1]))
    return build_pressure_cooker(f"pressure_cooker_n{number:03d}", design)


def build_pressure_cooker(object_id: str, design: PressureCookerDesign) -> ArticulatedObject:
    """Builds the links and the annotation of a design: joints ``lift`` and ``lid``, part ``handle`` (the lid's)."""
    rim = (design.axis_x, 0.0, design.height)
    up = (0.0, 0.0, 1.0)
    # An arm reaching down gives by half a millimetre per newton: a lid of sheet aluminium, as light as real ones are.
    lift = Joint("lift", "prismatic", up, rim, (0.0, LIFT_UPPER), damping=8.0)
    lid = Joint("lid", "revolute", up, (0.0, 0.0, 0.0), (-LID_RANGE, LID_RANGE), damping=0.15)
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
