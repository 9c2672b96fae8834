"""The categories' tasks, as a table: a row makes a ManiSkill task, ``AdaManip-Safe-v1``, and its class, `SafeTask`."""

from __future__ import annotations

import numpy as np
from mani_skill.utils.registration import register_env

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import GENTLE
from lerobot_env_adamanip.sim.kinematics import DOWN_REST, HIGH_REST
from lerobot_env_adamanip.sim.placement import ExternalStand
from lerobot_env_adamanip.sim.tasks.base import AdaManipTask
from lerobot_env_adamanip.sim.tasks.category_task import (
    LIFT_REACH,
    SWING_REACH,
    CategoryTask,
    lamp_reaches,
    microwave_reaches,
    safe_reaches,
    turn_then_open,
)

MAX_STEPS = 2000
"""Control steps of an episode in plain ManiSkill, where no key frames are counted."""
CONVERGED, SLIM = 24, 40
"""Solver iterations. With ManiSkill's 15 friction has not converged: a blocked pull slips 10 mm where it should hold,
and fingers sink 2 mm into a cap, a third of a slim pen's, which needs more."""
WIDE_SWING = float(np.deg2rad(32))
"""How far the arm must be able to swing a full-size leaf [rad]: past success at 26 degrees, 0.44 m of way."""
PUSH_REACH = 0.025
"""How far the arm must be able to push a button in [m]: upstream's goes 0.1 m, and success is at 0.01."""
_TURN_DRAWS = "direction with p = 0.5, range U(0.5, 1.0) of the object's; free at 0.85 of it."
_LIFTED = "by more than 25 mm."

ROWS = (
    CategoryTask(
        "bottle",
        "turn the cap, nobody knows which way and how far, and lift it.",
        _TURN_DRAWS,
        f"the cap is lifted {_LIFTED}",
        turn_then_open("cap", "cap", "lift", LIFT_REACH),
        nominal_x=0.41, part_height=0.57, plinth_least=0.07, motion=GENTLE, solver_iterations=CONVERGED, rest=HIGH_REST,
    ),
    CategoryTask(
        "pen",
        "turn the cap, nobody knows which way and how far, and lift it.",
        _TURN_DRAWS,
        f"the cap is lifted {_LIFTED}",
        turn_then_open("cap", "cap", "lift", LIFT_REACH),
        nominal_x=0.40, part_height=0.57, plinth_least=0.07, motion=GENTLE, solver_iterations=SLIM, rest=HIGH_REST,
    ),
    CategoryTask(
        "pressure_cooker",
        "turn the lid by its handle, nobody knows which way and how far, and lift it.",
        _TURN_DRAWS,
        f"the lid is lifted {_LIFTED}",
        turn_then_open("handle", "lid", "lift", LIFT_REACH),
        nominal_x=0.50, part_height=0.58, rest=DOWN_REST,
    ),
    CategoryTask(
        "coffee_maker",
        "turn the portafilter by its handle, nobody knows which way and how far, and lower it.",
        _TURN_DRAWS,
        f"the portafilter is lowered {_LIFTED}",
        turn_then_open("handle", "portafilter", "drop", LIFT_REACH),
        nominal_x=0.56, part_height=0.58, rest=DOWN_REST,
    ),
    CategoryTask(
        "safe",
        "pull the door open by its handle; if it is locked, turn the knob first.",
        "locked with p = 0.5, the knob's direction with p = 0.5, its range U(0.9, 1.0) of the object's; the lock gives "
        "at 0.85 of that range.",
        "the door stands open by more than pi/7.",
        safe_reaches,
        external=ExternalStand(wide_farthest={"door": WIDE_SWING}),
    ),
    CategoryTask(
        "microwave",
        "pull the door open by its handle; if it is locked, push the button first.",
        "locked with p = 0.5; the lock gives at 0.7 of the button's travel.",
        "the door stands open by more than pi/7.",
        microwave_reaches,
        external=ExternalStand(wide_farthest={"door": WIDE_SWING}),
    ),
    CategoryTask(
        "window",
        "turn the handle, nobody knows which way and how far, and pull the sash open.",
        _TURN_DRAWS,
        "the sash stands open by more than pi/6.",
        turn_then_open("handle", "handle", "sash", SWING_REACH),
        solver_iterations=CONVERGED, external=ExternalStand(wide_farthest={"sash": WIDE_SWING}),
    ),
    CategoryTask(
        "door",
        "turn the lever, nobody knows which way and how far, and pull the leaf open.",
        _TURN_DRAWS,
        "the leaf stands open by more than pi/7.",
        turn_then_open("lever", "lever", "leaf", SWING_REACH),
        solver_iterations=CONVERGED, external=ExternalStand(wide_farthest={"leaf": WIDE_SWING}),
    ),
    CategoryTask(
        "lamp",
        "push the part, or turn it one way or the other; nobody knows which it is.",
        "push, turn + or turn - with p = 1/3 each.",
        "pushed by more than 10 mm, or turned by more than 0.85 of its range.",
        lamp_reaches,
        nominal_x=0.44, part_height=0.56, motion=GENTLE, rest=DOWN_REST,
        external=ExternalStand(farthest={"button": PUSH_REACH}),
    ),
)  # fmt: skip


def register_task(row: CategoryTask) -> type[AdaManipTask]:
    """Makes a row's class and registers it with ManiSkill and Gymnasium."""
    category = CATEGORIES[row.category]
    contents = {"definition": row, "__doc__": row.documentation, "__module__": __name__}
    made = type(f"{category.camel_name}Task", (AdaManipTask,), contents)
    registered: type[AdaManipTask] = register_env(category.task_id, max_episode_steps=MAX_STEPS)(made)
    return registered


TASKS = {row.category: register_task(row) for row in ROWS}
"""Category -> its task's class."""
CLASSES = {made.__name__: made for made in TASKS.values()}
"""Class name, ``SafeTask``, -> class."""


def __getattr__(name: str) -> type[AdaManipTask]:
    """Lets the classes be imported by name from this module."""
    if name in CLASSES:
        return CLASSES[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
