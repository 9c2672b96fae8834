"""AdaManip-Bottle-v1: turn a cap that goes one way only, and lift it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from mani_skill.utils.registration import register_env
from numpy.typing import NDArray

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.arm import HIGH_REST
from lerobot_env_adamanip.driver import MotionLimits
from lerobot_env_adamanip.layout import Reach
from lerobot_env_adamanip.tasks.base import LIFT_REACH, AdaManipTask, turn_then_open


@register_env(CATEGORIES["bottle"].task_id, max_episode_steps=2000)
class BottleTask(AdaManipTask):
    """Open the bottle.

    Task Description: turn the cap, nobody knows which way and how far, and lift it.

    Randomizations: as `AdaManipTask`; direction with p = 0.5, range U(0.5, 1.0) of the object's; free at 0.85 of it.
    Success Conditions: the cap is lifted by more than 25 mm.
    """

    category: ClassVar[str] = "bottle"
    nominal_x: ClassVar[float] = 0.41
    part_height: ClassVar[float] = 0.57
    plinth_least: ClassVar[float] = 0.07
    motion: ClassVar[MotionLimits] = MotionLimits(angular_speed=0.8, stall_rotation=0.03, stall_ticks=3)
    """At the usual speed a blocked cap slips by 20 degrees in the fingers before the arm gives up."""
    solver_iterations: ClassVar[int] = 40
    """With ManiSkill's 15 the fingers sink 2 mm into a cap, a third of a slim pen's."""
    rest: ClassVar[NDArray[np.float64]] = HIGH_REST

    def reaches(self, obj: ArticulatedObject) -> tuple[Reach, ...]:
        """The cap turns both ways, and opens from there."""
        return (turn_then_open(obj, "cap", "cap", "lift", LIFT_REACH),)
