"""AdaManip-Window-v1: turn a handle that goes one way only, and open the sash."""

from __future__ import annotations

from typing import ClassVar

from mani_skill.utils.registration import register_env

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.placement import ReachRequirement
from lerobot_env_adamanip.sim.tasks.base import SWING_REACH, AdaManipTask, turn_then_open


@register_env(CATEGORIES["window"].task_id, max_episode_steps=2000)
class WindowTask(AdaManipTask):
    """Open the window.

    Task Description: turn the handle, nobody knows which way and how far, and pull the sash open.

    Randomizations: as `AdaManipTask`; direction with p = 0.5, range U(0.5, 1.0) of the object's; free at 0.85 of it.
    Success Conditions: the sash stands open by more than pi/6.
    """

    category: ClassVar[str] = "window"
    # With ManiSkill's 15 friction has not converged: a blocked pull slips 10 mm where it should hold.
    solver_iterations: ClassVar[int] = 40

    def reaches(self, obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        """The handle turns both ways, and opens from there."""
        return (turn_then_open(obj, "handle", "handle", "sash", SWING_REACH),)
