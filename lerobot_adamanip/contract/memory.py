"""Memory as an observation: the latest felt tries as numbers for a column, or as a sentence after the instruction.

`lerobot_adamanip.episode.felt_tries` says what a felt try is. `lerobot_adamanip.episode.memory` fills both forms.
"""

from __future__ import annotations

from typing import Any

from lerobot_adamanip.contract.control import ACTION_NAMES, DENSE, JOINT
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

NO_MEMORY, EVENTS, TEXT = "none", "events", "text"
MEMORIES = (NO_MEMORY, EVENTS, TEXT)
"""``none``; ``events``: numbers in the column `MEMORY`; ``text``: a sentence after the instruction."""
MEMORY = "observation.environment_state"
"""Column of the numbers. LeRobot's ACT and diffusion policy read it as it is, without normalisation."""
NUM_TRIES = 4
"""Number of felt tries in the memory: the latest ones."""
TRY_NAMES = (
    "is_try", "x", "y", "z", *(f"r6d_{i}" for i in range(6)), *(f"commanded_{name}" for name in ("x", "y", "z")),
    *(f"commanded_r{name}" for name in ("x", "y", "z")), *(f"measured_{name}" for name in ("x", "y", "z")),
    *(f"measured_r{name}" for name in ("x", "y", "z")), "blocked", "times",
)  # fmt: skip
"""Numbers of one try; all are 0 without a try.

``is_try``: 1. ``x`` ... ``r6d_5``: tool pose in the robot base frame when the try began: position [m], rotation 6D.
``commanded_*``: commanded motion in the tool's frame of that moment: translation, rotation vector, in `MOTION_UNITS`.
``measured_*``: measured motion, likewise. ``blocked``: 1 if the hand was held back, 0 if it moved. ``times``: how often
this try was made, as a share of `MAX_TIMES`.
"""
MEMORY_NAMES = tuple(f"try_{number}.{name}.pos" for number in range(1, NUM_TRIES + 1) for name in TRY_NAMES)
"""Names of the column's numbers: ``try_1`` is the latest try. LeRobot's robot commands keep only
names that end in ``.pos`` or ``.vel``."""
MOTION_UNITS = (0.05, 0.05, 0.05, 0.5, 0.5, 0.5)
"""Units of a motion [m, m, m, rad, rad, rad]: a typical motion in contact."""
MAX_MOTION, MAX_TIMES = 3.0, 4
"""Largest absolute value of a motion in its units, and largest number of times; larger ones are clipped."""
SO_FAR = " Tried so far: "
"""Start of the sentence after an instruction."""


def memory_feature() -> dict[str, Any]:
    """Returns the description of the column `MEMORY` in a LeRobotDataset."""
    return {"dtype": "float32", "shape": (len(MEMORY_NAMES),), "names": list(MEMORY_NAMES)}


def instruction_of(task: str) -> str:
    """Returns a task's instruction without its memory."""
    return task.partition(SO_FAR)[0]


def check_memory(memory: str, *, control: str, action: str) -> None:
    """Raises `ConfigurationError` for an unknown memory, or one that needs tool poses without having them."""
    require_choice("memory", memory, MEMORIES, hint="--env.memory=events")
    if memory != NO_MEMORY and control == DENSE and action == JOINT:
        raise ConfigurationError(
            "A memory needs commanded tool poses.",
            got=f"memory={memory} with actions of {JOINT} positions",
            allowed=", ".join(kind for kind in ACTION_NAMES if kind != JOINT),
            hint="--env.action=ee_delta",
        )
