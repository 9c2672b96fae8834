"""What stands upright and has a cap to turn and lift: shared by bottle and pen."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.keyframes import GENTLE, MotionLimits
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.kinematics import HIGH_REST
from lerobot_env_adamanip.sim.placement import ReachRequirement
from lerobot_env_adamanip.sim.tasks.base import LIFT_REACH, AdaManipTask, turn_then_open


class CappedTask(AdaManipTask):
    """A hand from above, slow turns and hard contacts; not registered itself."""

    part_height: ClassVar[float] = 0.57
    plinth_least: ClassVar[float] = 0.07
    motion: ClassVar[MotionLimits] = GENTLE
    solver_iterations: ClassVar[int] = 40
    """With ManiSkill's 15 the fingers sink 2 mm into a cap, a third of a slim pen's."""
    rest: ClassVar[NDArray[np.float64]] = HIGH_REST

    def reaches(self, obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        """The cap turns both ways, and opens from there."""
        return (turn_then_open(obj, "cap", "cap", "lift", LIFT_REACH),)
