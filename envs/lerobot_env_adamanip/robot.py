"""The Franka Panda as ManiSkill ships it, with the grip a real Franka Hand has."""

from __future__ import annotations

from typing import ClassVar

from mani_skill.agents.registration import register_agent
from mani_skill.agents.robots.panda.panda import Panda


@register_agent()
class AdaManipPanda(Panda):
    """Panda with a firm hand: ManiSkill's closes with about 20 N on a thin bar, the Franka Hand holds up to 70 N."""

    uid: ClassVar[str] = "adamanip_panda"
    gripper_stiffness = 5e3
    gripper_damping = 2e2
    gripper_force_limit = 70
