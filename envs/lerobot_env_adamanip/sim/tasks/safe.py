"""AdaManip-Safe-v1: open a safe that may be locked, by a knob that turns either way."""

from __future__ import annotations

from typing import ClassVar

from mani_skill.utils.registration import register_env

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.placement import ReachRequirement
from lerobot_env_adamanip.sim.tasks.base import SWING_REACH, AdaManipTask


@register_env(CATEGORIES["safe"].task_id, max_episode_steps=2000)
class SafeTask(AdaManipTask):
    """Open the safe.

    Task Description: pull the door open by its handle; if it is locked, turn the knob first.
    Randomizations: as `AdaManipTask`; locked with p = 0.5, the knob's direction with p = 0.5, its range U(0.9, 1.0) of
        the object's; the lock gives at 0.85 of that range.
    Success Conditions: the door stands open by more than pi/7.
    """

    category: ClassVar[str] = "safe"

    def reaches(self, obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        """The handle swings with the door, the knob turns both ways."""
        turn = obj.joint("knob").limits[1]
        return (
            ReachRequirement("handle", ({"door": SWING_REACH},)),
            ReachRequirement("knob", ({"knob": -turn},), ({"knob": turn},)),
        )
