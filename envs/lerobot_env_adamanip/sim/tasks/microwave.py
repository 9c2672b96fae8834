"""AdaManip-Microwave-v1: open a microwave that may be locked, by a button that releases it."""

from __future__ import annotations

from typing import ClassVar

from mani_skill.utils.registration import register_env

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.placement import ReachRequirement
from lerobot_env_adamanip.sim.tasks.base import SWING_REACH, AdaManipTask


@register_env(CATEGORIES["microwave"].task_id, max_episode_steps=2000)
class MicrowaveTask(AdaManipTask):
    """Open the microwave.

    Task Description: pull the door open by its handle; if it is locked, push the button first.

    Randomizations: as `AdaManipTask`; locked with p = 0.5; the lock gives at 0.7 of the button's travel.
    Success Conditions: the door stands open by more than pi/7.
    """

    category: ClassVar[str] = "microwave"

    def reaches(self, obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        """The handle swings with the door, the button goes in."""
        travel = obj.joint("button").limits[1]
        return (ReachRequirement("handle", ({"door": SWING_REACH},)), ReachRequirement("button", ({"button": travel},)))
