"""Task of a category: placement of its objects, required reach, and motion settings of the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import is_asset_id
from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, MotionLimits
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.kinematics import LEVEL_REST
from lerobot_env_adamanip.sim.placement import ExternalStand, ReachRequirement, Stand, external_stand, generated_stand

Reaches = Callable[[ArticulatedObject], tuple[ReachRequirement, ...]]
SWING_REACH = float(np.deg2rad(44))
"""Required swing of a door [rad]: more than success, with a margin for a loose grip."""
LIFT_REACH = 0.045
"""Required lift of a cap or lid [m]: more than success."""


@dataclass(frozen=True, eq=False)
class CategoryTask:
    """One row of the table of tasks.

    Attributes:
        category: ``safe``.
        reaches: returns the part motions of an object that the arm must be able to make.
        nominal_x: distance of the object's front from the robot's base [m].
        part_height: height of the first part on the plinth [m].
        plinth_least: half of the plinth's minimum width and depth [m].
        motion: limits of the arm's motion, and when a motion is aborted.
        solver_iterations: position iterations of the physics engine; more make contacts harder.
        external: placement of external assets.
        rest: start posture of the arm, to which its elbow is pulled (7,) [rad].
    """

    category: str
    reaches: Reaches
    nominal_x: float = 0.66
    part_height: float = 0.72
    plinth_least: float = 0.02
    motion: MotionLimits = DEFAULT_MOTION
    solver_iterations: int = 15
    external: ExternalStand = field(default_factory=ExternalStand)
    rest: NDArray[np.float64] = field(default_factory=lambda: LEVEL_REST)

    def stand(self, obj: ArticulatedObject) -> Stand:
        """Returns an object's nominal placement, with the motions that the arm must be able to make there."""
        reaches, where = self.reaches(obj), {"nominal_x": self.nominal_x, "part_height": self.part_height}
        if is_asset_id(obj.object_id):
            return external_stand(obj, reaches, self.external, **where)
        return generated_stand(obj, reaches, **where)


def turn_then_open(part: str, key: str, final: str, far: float) -> Reaches:
    """Returns the reach for a part that turns over its key joint's range and then opens by ``far``."""

    def reaches(obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        paths = [({key: turn}, {key: turn, final: far}) for turn in obj.joint(key).limits if turn]
        return (ReachRequirement(part, *paths),)

    return reaches


def safe_reaches(obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
    """Returns the reach for a safe: the handle swings with the door, the knob turns both ways."""
    turn = obj.joint("knob").limits[1]
    knob = ReachRequirement("knob", ({"knob": -turn},), ({"knob": turn},))
    return ReachRequirement("handle", ({"door": SWING_REACH},)), knob


def microwave_reaches(obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
    """Returns the reach for a microwave: the handle swings with the door, the button is pushed in."""
    button = ReachRequirement("button", ({"button": obj.joint("button").limits[1]},))
    return ReachRequirement("handle", ({"door": SWING_REACH},)), button


def lamp_reaches(obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
    """Returns the reach for a lamp: the knob turns both ways and goes down."""
    turn, travel = obj.joint("knob").limits[1], obj.joint("button").limits[1]
    return (ReachRequirement("knob", ({"knob": -turn},), ({"knob": turn},), ({"button": travel},)),)
