"""ManiSkill's Franka Panda with the grip force of a real Franka Hand."""

from __future__ import annotations

from typing import ClassVar

from mani_skill.agents.registration import register_agent
from mani_skill.agents.robots.panda.panda import Panda


@register_agent()
class AdaManipPanda(Panda):
    """Panda with a compliant wrist and a strong hand.

    ManiSkill's arm has 1000 N m/rad in every joint: it would twist a knob out of the fingers without feedback. A real
    Franka under Cartesian impedance has tens of N m/rad about the tool, so a blocked turn is felt. ManiSkill's hand
    closes with about 20 N on a thin bar; the Franka Hand grips with up to 140 N.
    """

    uid: ClassVar[str] = "adamanip_panda"
    arm_stiffness = (1000.0, 1000.0, 1000.0, 1000.0, 150.0, 150.0, 25.0)
    arm_damping = (100.0, 100.0, 100.0, 100.0, 15.0, 15.0, 2.5)
    gripper_stiffness = 8e3
    gripper_damping = 3e2
    gripper_force_limit = 120
