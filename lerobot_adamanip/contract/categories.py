"""The nine categories: name, number of objects in the paper, and task instruction.

Pure data, light to import. A module named after the category holds everything else: its objects in
`lerobot_adamanip.objects`, its rules in `lerobot_adamanip.mechanisms`, its experts in `lerobot_adamanip.experts`. Its
ManiSkill task is a row of `lerobot_env_adamanip.sim.tasks.categories`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Category:
    """One kind of object.

    Attributes:
        name: ``pressure_cooker``.
        seen: number of training objects in the paper's Table 1; demonstrations are collected on them.
        instruction: the task in words, as policies and datasets carry it.
    """

    name: str
    seen: int
    instruction: str

    @property
    def camel_name(self) -> str:
        """``PressureCooker``, as ManiSkill spells tasks."""
        return "".join(word.capitalize() for word in self.name.split("_"))

    @property
    def task_id(self) -> str:
        """``AdaManip-PressureCooker-v1``."""
        return f"AdaManip-{self.camel_name}-v1"

    @property
    def keyframe_id(self) -> str:
        """``AdaManipKeyframe-PressureCooker-v0``: the id of the key-frame environment, for `gymnasium.make`."""
        return f"AdaManipKeyframe-{self.camel_name}-v0"

    @property
    def dense_id(self) -> str:
        """``AdaManipDense-PressureCooker-v0``: the id of the environment at control rate, for `gymnasium.make`."""
        return f"AdaManipDense-{self.camel_name}-v0"


CATEGORIES = {
    category.name: category
    for category in (
        Category("bottle", 32, "Open the bottle."),
        Category("pen", 36, "Take the cap off the pen."),
        Category("pressure_cooker", 6, "Open the pressure cooker."),
        Category("coffee_maker", 18, "Take the portafilter out of the coffee maker."),
        Category("safe", 36, "Open the safe."),
        Category("microwave", 37, "Open the microwave."),
        Category("window", 30, "Open the window."),
        Category("door", 57, "Open the door."),
        Category("lamp", 25, "Switch on the lamp."),
    )
}
"""In the order of the paper's result tables."""
ALL = "all"
"""Selects every category where a command expects one."""


def is_asset_id(identifier: str) -> bool:
    """Returns whether an id names an external asset (``safe:sa1``), not a generated object (``safe_001``)."""
    return ":" in identifier
