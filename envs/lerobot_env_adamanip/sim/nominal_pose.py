"""Where an object stands nominally: what is generated stands as its category does, an external asset as its size needs.

External assets keep their real size. Upstream moves and lifts the robot for them, per category; here the robot's base
is the origin, so the floor and the object move: a door whose lever is a metre up stands on a floor below the base.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from lerobot_adamanip.objects import ArticulatedObject, PartAnnotation
from lerobot_env_adamanip.sim.kinematics import ArmKinematics
from lerobot_env_adamanip.sim.placement import Path, Placement, Randomization, ReachRequirement, draw_placement

LEAST_PLINTH, HIGHEST_PLINTH = 0.04, 0.7
"""Of the plinth under a generated object [m]."""


@dataclass(frozen=True)
class ExternalStand:
    """How a category's external assets stand before the arm, robot base frame.

    Attributes:
        part_y: the first part comes no farther to the side than this [m].
        wide: a leaf whose handle is farther from its hinge than this [m] counts as wide.
        wide_x: distance of a wide leaf's front from the robot's base [m]: its handle comes far towards the robot.
        wide_y: distance of a wide leaf's handle from the arm's middle plane, away from the hinge, which it nears [m].
        farthest: joint -> how far the arm must be able to take it [rad or m], whatever the joint's own limit.
        wide_farthest: the same of wide leaves.
    """

    part_y: float = 0.12
    wide: float = 0.5
    wide_x: float = 0.73
    wide_y: float = 0.08
    farthest: Mapping[str, float] = field(default_factory=dict)
    wide_farthest: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Stand:
    """Where one object stands, robot base frame, and what the arm must be able to do there.

    Attributes:
        x, y: of the middle of its front [m].
        floor_z: of the surface it stands on [m].
        reaches: part motions.
    """

    x: float
    y: float
    floor_z: float
    reaches: tuple[ReachRequirement, ...]

    @property
    def ground_z(self) -> float:
        """Height of the ground: below the robot's base where the object needs it [m]."""
        return min(self.floor_z, 0.0)

    def draw(
        self,
        rng: np.random.Generator,
        obj: ArticulatedObject,
        kinematics: ArmKinematics,
        spread: Randomization,
        *,
        must_reach: bool = True,
    ) -> Placement:
        """Returns an episode's poses around this stand; see `draw_placement`."""
        return draw_placement(
            rng,
            obj,
            kinematics,
            self.reaches,
            spread,
            nominal_x=self.x,
            nominal_y=self.y,
            floor_z=self.floor_z,
            must_reach=must_reach,
        )


def generated_stand(
    obj: ArticulatedObject, reaches: tuple[ReachRequirement, ...], *, nominal_x: float, part_height: float
) -> Stand:
    """Returns the stand of a generated object: in front of the robot, lifted until its first part is at hand."""
    floor = float(np.clip(part_height - obj.parts[0].grasp[2, 3], LEAST_PLINTH, HIGHEST_PLINTH))
    return Stand(nominal_x, 0.0, floor, reaches)


def external_stand(
    obj: ArticulatedObject,
    reaches: tuple[ReachRequirement, ...],
    rule: ExternalStand,
    *,
    nominal_x: float,
    part_height: float,
) -> Stand:
    """Returns the stand of an external asset: lifted or lowered, and shifted until its first part is at hand."""
    part = obj.parts[0]
    floor = min(part_height - float(part.grasp[2, 3]), HIGHEST_PLINTH)
    # Yawed by half a turn towards the robot: what is at +y of the object is at -y of the base.
    aside, hinge = -float(part.grasp[1, 3]), _hinge_y(part)
    if hinge is None or abs(float(part.grasp[1, 3]) - hinge) <= rule.wide:
        wanted = float(np.clip(aside, -rule.part_y, rule.part_y))
        return Stand(nominal_x, wanted - aside, floor, _capped(reaches, rule.farthest))
    wanted = rule.wide_y * float(np.sign(hinge - part.grasp[1, 3]))
    return Stand(rule.wide_x, wanted - aside, floor, _capped(reaches, {**rule.farthest, **rule.wide_farthest}))


def _hinge_y(part: PartAnnotation) -> float | None:
    """The y of the upright hinge that carries a part, object frame [m]; None if there is none."""
    hinges = [motion for motion in part.motions if motion.kind == "revolute" and abs(motion.axis[2]) > 0.9]
    return float(hinges[0].point[1]) if hinges else None


def _capped(reaches: tuple[ReachRequirement, ...], farthest: Mapping[str, float]) -> tuple[ReachRequirement, ...]:
    def leg(positions: Mapping[str, float]) -> dict[str, float]:
        return {
            name: float(np.clip(q, -farthest.get(name, np.inf), farthest.get(name, np.inf)))
            for name, q in positions.items()
        }

    def path(legs: Path) -> Path:
        return tuple(leg(positions) for positions in legs)

    return tuple(ReachRequirement(reach.part, *(path(legs) for legs in reach.paths)) for reach in reaches)
