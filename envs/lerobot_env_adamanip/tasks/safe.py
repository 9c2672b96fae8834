"""AdaManip-Safe-v1: open a safe that may be locked, by a knob that turns either way."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch
from mani_skill.utils.registration import register_env

from lerobot_adamanip.mechanisms import Mechanism, SafeMechanism
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.objects.safe import DOOR_UPPER, knob_range
from lerobot_env_adamanip.layout import Reach
from lerobot_env_adamanip.tasks.base import AdaManipTask

SUCCESS_ANGLE = np.pi / 7
"""Door angle beyond which the safe counts as opened [rad] (paper code)."""
OPENING_REACH = np.deg2rad(44)
"""The arm must be able to swing the door this far [rad]: past success, with room for a slack grip."""


@register_env("AdaManip-Safe-v1", max_episode_steps=2000)
class SafeTask(AdaManipTask):
    """Open the safe.

    Task Description: pull the door open by its handle; if it is locked, turn the knob first.
    Randomizations: as `AdaManipTask`; locked with p = 0.5, the knob's direction with p = 0.5, its range U(0.9, 1.0) of
        the object's; the lock gives at 0.85 of that range.
    Success Conditions: the door stands open by more than pi/7.
    """

    category: ClassVar[str] = "safe"

    def make_mechanism(self, obj: ArticulatedObject) -> Mechanism[Any]:
        """Lock, random rotation direction and switch contact."""
        return SafeMechanism(door_upper=DOOR_UPPER, knob_range=knob_range(obj))

    def reaches(self, obj: ArticulatedObject) -> tuple[Reach, ...]:
        """The handle swings with the door, the knob turns both ways."""
        door = Reach("handle", 0.0, OPENING_REACH)
        return (door, Reach("knob", -knob_range(obj), knob_range(obj)))

    def evaluate(self) -> dict[str, Any]:
        """Returns success and the door's angle [rad]."""
        door = self.joint_positions()["door"]
        return {"success": torch.tensor([door > SUCCESS_ANGLE]), "door_angle": torch.tensor([door])}
