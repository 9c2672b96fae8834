"""AdaManip-Pen-v1: turn a pen's cap that goes one way only, and lift it."""

from __future__ import annotations

from typing import ClassVar

from mani_skill.utils.registration import register_env

from lerobot_adamanip.categories import CATEGORIES
from lerobot_env_adamanip.sim.tasks.capped import CappedTask


@register_env(CATEGORIES["pen"].task_id, max_episode_steps=2000)
class PenTask(CappedTask):
    """Take the cap off the pen.

    Task Description: turn the cap, nobody knows which way and how far, and lift it.

    Randomizations: as `AdaManipTask`; direction with p = 0.5, range U(0.5, 1.0) of the object's; free at 0.85 of it.
    Success Conditions: the cap is lifted by more than 25 mm.
    """

    category: ClassVar[str] = "pen"
    nominal_x: ClassVar[float] = 0.40
