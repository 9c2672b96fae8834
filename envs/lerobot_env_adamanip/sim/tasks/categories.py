"""Table of the categories' tasks: each row makes a ManiSkill task, ``AdaManip-Safe-v1``, and its class `SafeTask`."""

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
"""Control steps per episode in plain ManiSkill, which has no key frames."""
CONVERGED, SLIM = 24, 40
"""Solver iterations. With ManiSkill's 15, friction does not converge: a blocked pull slips 10 mm instead of holding,
and fingers sink 2 mm into a cap. That is a third of a slim pen's cap, which needs more iterations."""
WIDE_SWING = float(np.deg2rad(32))
"""Required swing of a full-size leaf [rad]: more than success at 26 degrees; 0.44 m of travel."""
PUSH_REACH = 0.025
"""Required push depth of a button [m]: upstream's travel is 0.1 m, and success is at 0.01."""

ROWS = (
    CategoryTask("bottle", turn_then_open("cap", "cap", "lift", LIFT_REACH),
        nominal_x=0.41, part_height=0.57, plinth_least=0.07, motion=GENTLE, solver_iterations=CONVERGED, rest=HIGH_REST,
    ),
    CategoryTask("pen", turn_then_open("cap", "cap", "lift", LIFT_REACH),
        nominal_x=0.40, part_height=0.57, plinth_least=0.07, motion=GENTLE, solver_iterations=SLIM, rest=HIGH_REST,
    ),
    CategoryTask("pressure_cooker", turn_then_open("handle", "lid", "lift", LIFT_REACH),
        nominal_x=0.50, part_height=0.58, rest=DOWN_REST,
    ),
    CategoryTask("coffee_maker", turn_then_open("handle", "portafilter", "drop", LIFT_REACH),
        nominal_x=0.56, part_height=0.58, rest=DOWN_REST,
    ),
    CategoryTask("safe", safe_reaches,
        external=ExternalStand(wide_farthest={"door": WIDE_SWING}),
    ),
    CategoryTask("microwave", microwave_reaches,
        external=ExternalStand(wide_farthest={"door": WIDE_SWING}),
    ),
    CategoryTask("window", turn_then_open("handle", "handle", "sash", SWING_REACH),
        solver_iterations=CONVERGED, external=ExternalStand(wide_farthest={"sash": WIDE_SWING}),
    ),
    CategoryTask("door", turn_then_open("lever", "lever", "leaf", SWING_REACH),
        solver_iterations=CONVERGED, external=ExternalStand(wide_farthest={"leaf": WIDE_SWING}),
    ),
    CategoryTask("lamp", lamp_reaches,
        nominal_x=0.44, part_height=0.56, motion=GENTLE, rest=DOWN_REST,
        external=ExternalStand(farthest={"button": PUSH_REACH}),
    ),
)  # fmt: skip


def register_task(row: CategoryTask) -> type[AdaManipTask]:
    """Creates a row's class and registers it with ManiSkill and Gymnasium."""
    category = CATEGORIES[row.category]
    contents = {"definition": row, "__doc__": category.instruction, "__module__": __name__}
    task = type(f"{category.camel_name}Task", (AdaManipTask,), contents)
    registered: type[AdaManipTask] = register_env(category.task_id, max_episode_steps=MAX_STEPS)(task)
    return registered


TASKS = {row.category: register_task(row) for row in ROWS}
"""Category -> class of its task."""
CLASSES = {task.__name__: task for task in TASKS.values()}
"""Class name, ``SafeTask``, -> class."""
