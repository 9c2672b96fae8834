"""AdaManip-CoffeeMaker-v1: turn a portafilter that goes one way only, and lower it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from mani_skill.utils.registration import register_env
from numpy.typing import NDArray

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.kinematics import DOWN_REST
from lerobot_env_adamanip.sim.placement import ReachRequirement
from lerobot_env_adamanip.sim.tasks.base import LIFT_REACH, AdaManipTask, turn_then_open


@register_env(CATEGORIES["coffee_maker"].task_id, max_episode_steps=2000)
class CoffeeMakerTask(AdaManipTask):
    """Take the portafilter out of the coffee maker.

    Task Description: turn it by its handle, nobody knows which way and how far, and lower it.

    Randomizations: as `AdaManipTask`; direction with p = 0.5, range U(0.5, 1.0) of the object's; free at 0.85 of it.
    Success Conditions: the portafilter is lowered by more than 25 mm.
    """

    category: ClassVar[str] = "coffee_maker"
    nominal_x: ClassVar[float] = 0.56
    part_height: ClassVar[float] = 0.58
    rest: ClassVar[NDArray[np.float64]] = DOWN_REST

    def reaches(self, obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        """The handle turns both ways, and opens from there."""
        return (turn_then_open(obj, "handle", "portafilter", "drop", LIFT_REACH),)
