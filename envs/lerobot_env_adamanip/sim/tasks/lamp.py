"""AdaManip-Lamp-v1: switch on a lamp by a button, or by a knob that looks the same."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from mani_skill.utils.registration import register_env
from numpy.typing import NDArray

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.keyframes import GENTLE, MotionLimits
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.kinematics import DOWN_REST
from lerobot_env_adamanip.sim.placement import ReachRequirement
from lerobot_env_adamanip.sim.tasks.base import AdaManipTask


@register_env(CATEGORIES["lamp"].task_id, max_episode_steps=2000)
class LampTask(AdaManipTask):
    """Switch on the lamp.

    Task Description: push the part, or turn it one way or the other; nobody knows which it is.

    Randomizations: as `AdaManipTask`; push, turn + or turn - with p = 1/3 each.
    Success Conditions: pushed by more than 10 mm, or turned by more than 0.85 of its range.
    """

    category: ClassVar[str] = "lamp"
    nominal_x: ClassVar[float] = 0.44
    part_height: ClassVar[float] = 0.56
    motion: ClassVar[MotionLimits] = GENTLE
    rest: ClassVar[NDArray[np.float64]] = DOWN_REST

    def reaches(self, obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        """The knob turns both ways, and goes down."""
        turn, travel = obj.joint("knob").limits[1], obj.joint("button").limits[1]
        return (ReachRequirement("knob", ({"knob": -turn},), ({"knob": turn},), ({"button": travel},)),)
