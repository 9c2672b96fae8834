"""Placement of object, robot and camera: nominal poses, randomization, and the reachability check.

External assets keep their real size. The robot's base is the origin, so floor and object move. For a door with its
lever one metre up, the floor is below the base.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import PRE_GRASP
from lerobot_adamanip.contract.rotations import rotation_about, straight_path, transform
from lerobot_adamanip.objects import ArticulatedObject, PartAnnotation
from lerobot_adamanip.util.errors import UnreachableError, require_choice
from lerobot_env_adamanip.sim.kinematics import ArmKinematics, Pull

if TYPE_CHECKING:
    from lerobot_env_adamanip.sim.tasks.category_task import CategoryTask

Array = NDArray[np.float64]

LEAST_PLINTH, HIGHEST_PLINTH = 0.04, 0.7
"""Range of plinth heights for a generated object [m]."""
DRAWS = 30
"""Maximum number of sampled poses of a scene."""
PATH_STEPS = 6
"""Number of poses checked on each leg of a path."""
APPROACH_STEPS, APPROACHING = 8, Pull(steps=5)
"""Number of poses checked on each leg of the way to a part. A motion pulls the elbow to rest at each control tick,
several times per checked pose."""
CHECK_SEED = 0
"""Seed of the poses at which external assets are checked."""


@dataclass(frozen=True)
class Randomization:
    """Half widths of uniform samples around the nominal placement.

    Attributes:
        object_x, object_y: half widths [m].
        object_yaw: half width [rad].
        joint: standard deviation of the start posture [rad].
        camera_position: half width [m] along each axis, for camera and target.
    """

    object_x: float = 0.04
    object_y: float = 0.06
    object_yaw: float = 0.15
    joint: float = 0.02
    camera_position: float = 0.03


RANDOMIZATIONS = {
    "randomized": Randomization(),
    "fixed": Randomization(0.0, 0.0, 0.0, 0.0, 0.0),
}
"""``fixed``: as upstream's code, which moves neither object, robot nor camera."""


def randomization(preset: str) -> Randomization:
    """Returns a preset by name; raises `ConfigurationError` that lists the names for an unknown one."""
    return RANDOMIZATIONS[require_choice("poses", preset, RANDOMIZATIONS)]


@dataclass(frozen=True)
class Placement:
    """Poses of an episode: the object's root (4, 4) and the arm's start (7,) [rad]; annotations in the base frame."""

    object_in_base: Array
    start_qpos: Array
    annotations: dict[str, PartAnnotation]


Path = tuple[Mapping[str, float], ...]
"""Joint positions [rad or m] to visit in sequence, from rest."""


class ReachRequirement:
    """Required reach at a part: hold it, and move it along each of ``paths``.

    >>> ReachRequirement("knob", ({"knob": -1.2},), ({"knob": 1.2},))  # both ways from rest
    >>> ReachRequirement("cap", ({"cap": 2.0}, {"cap": 2.0, "lift": 0.05}))  # turn, then lift
    """

    def __init__(self, part: str, *paths: Path) -> None:
        self.part, self.paths = part, paths


@dataclass(frozen=True)
class ExternalStand:
    """Nominal placement of a category's external assets, robot base frame.

    Attributes:
        part_y: maximum sideways distance of the first part [m].
        wide: distance of handle and hinge [m] above which a leaf counts as wide.
        wide_x: distance of a wide leaf's front from the robot's base [m].
        wide_y: distance of a wide leaf's handle from the arm's middle plane, away from the hinge [m].
        farthest: joint -> maximum position that the arm must reach [rad or m].
        wide_farthest: the same for wide leaves.
    """

    part_y: float = 0.12
    wide: float = 0.5
    wide_x: float = 0.73
    wide_y: float = 0.08
    farthest: Mapping[str, float] = field(default_factory=dict)
    wide_farthest: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Stand:
    """Nominal placement of one object, robot base frame, with the motions that the arm must be able to make there.

    Attributes:
        x, y: middle of its front [m].
        floor_z: height of its supporting surface [m].
        reaches: required part motions.
    """

    x: float
    y: float
    floor_z: float
    reaches: tuple[ReachRequirement, ...]

    @property
    def ground_z(self) -> float:
        """Height of the ground: below the robot's base if the object needs it [m]."""
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
        """Samples poses around this placement until the arm can hold and move every part.

        If all `DRAWS` samples fail, raises `UnreachableError` if ``must_reach``; otherwise returns the last sample.
        Fixed poses have one sample.
        """
        is_fixed = spread == RANDOMIZATIONS["fixed"]
        draws = 1 if is_fixed else DRAWS
        for _ in range(draws):
            pose = _drawn_pose(rng, spread, self.x, self.y, self.floor_z)
            start = np.clip(kinematics.rest + rng.normal(size=7) * spread.joint, kinematics.lower, kinematics.upper)
            if (annotations := _reachable(obj, pose, kinematics, self.reaches, start)) is not None:
                return Placement(pose, start, annotations)
        if not must_reach:
            return Placement(pose, start, {part.name: part.in_frame(pose) for part in obj.parts})
        error = UnreachableError(
            f"{obj.object_id} cannot be placed where the arm reaches its parts.",
            got=f"{draws} draws around x = {self.x:.2f} m, floor at {self.floor_z:.2f} m",
            allowed="every part within reach, on the way to it, held and turned",
            hint="another object" if is_fixed else "--env.poses=fixed, or another object",
        )
        error.is_certain = is_fixed
        raise error


def generated_stand(
    obj: ArticulatedObject, reaches: tuple[ReachRequirement, ...], *, nominal_x: float, part_height: float
) -> Stand:
    """Returns the placement of a generated object: in front of the robot, its first part at ``part_height`` [m]."""
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
    """Returns the placement of an external asset: moved until its first part is in reach."""
    part = obj.parts[0]
    floor = min(part_height - float(part.grasp[2, 3]), HIGHEST_PLINTH)
    # The object faces the robot, rotated by half a turn: its +y is the base's -y.
    aside, hinge = -float(part.grasp[1, 3]), _hinge_y(part)
    if hinge is None or abs(float(part.grasp[1, 3]) - hinge) <= rule.wide:
        part_y = float(np.clip(aside, -rule.part_y, rule.part_y))
        return Stand(nominal_x, part_y - aside, floor, _capped(reaches, rule.farthest))
    part_y = rule.wide_y * float(np.sign(hinge - part.grasp[1, 3]))
    return Stand(rule.wide_x, part_y - aside, floor, _capped(reaches, {**rule.farthest, **rule.wide_farthest}))


def _hinge_y(part: PartAnnotation) -> float | None:
    """Returns the y of the vertical hinge that carries a part, object frame [m]; None without one."""
    hinges = [motion for motion in part.motions if motion.kind == "revolute" and abs(motion.axis[2]) > 0.9]
    return float(hinges[0].point[1]) if hinges else None


def _capped(reaches: tuple[ReachRequirement, ...], farthest: Mapping[str, float]) -> tuple[ReachRequirement, ...]:
    def capped(name: str, position: float) -> float:
        limit = farthest.get(name, np.inf)
        return float(np.clip(position, -limit, limit))

    def path(legs: Path) -> Path:
        return tuple({name: capped(name, position) for name, position in leg.items()} for leg in legs)

    return tuple(ReachRequirement(reach.part, *map(path, reach.paths)) for reach in reaches)


def _drawn_pose(rng: np.random.Generator, spread: Randomization, x: float, y: float, z: float) -> Array:
    """Samples an object's pose (4, 4) around its nominal position [m], facing the robot."""
    x, y = x + rng.uniform(-1, 1) * spread.object_x, y + rng.uniform(-1, 1) * spread.object_y
    yaw = np.pi + rng.uniform(-1, 1) * spread.object_yaw
    return transform((x, y, z), rotation_about((0.0, 0.0, 1.0), yaw))


def _reachable(
    obj: ArticulatedObject, pose: Array, kinematics: ArmKinematics, reaches: tuple[ReachRequirement, ...], start: Array
) -> dict[str, PartAnnotation] | None:
    reachable = {}
    for reach in reaches:
        part = obj.part(reach.part).in_frame(pose)
        candidates = [part.rolled(angle) if angle else part for angle in part.rolls]
        costs = [_cost(candidate, reach, kinematics) for candidate in candidates]
        best = sorted((cost, k) for k, cost in enumerate(costs) if cost is not None)
        chosen = next((k for _, k in best if approachable(candidates[k].grasp, kinematics, start)), None)
        if chosen is None:
            return None
        reachable[reach.part] = candidates[chosen]
    return reachable


def approachable(grasp: Array, kinematics: ArmKinematics, start: Array) -> bool:
    """Returns whether the arm can move from ``start`` (7,) [rad] via the pre-grasp to a grasp (4, 4) on straight lines.

    An almost stretched arm may reach a pose, but not on a straight line.
    """
    qpos, here = start, kinematics.tcp_in_base(start)
    for goal in (grasp @ transform((0.0, 0.0, -PRE_GRASP)), grasp):
        for waypoint in straight_path(here, goal, np.arange(1, APPROACH_STEPS + 1) / APPROACH_STEPS):
            solution = kinematics.solve(waypoint, qpos, iterations=80, pull=APPROACHING)
            if not solution.within(5e-3, 0.03):
                return False
            qpos = solution.qpos
        here = goal
    return True


def _cost(part: PartAnnotation, reach: ReachRequirement, kinematics: ArmKinematics) -> float | None:
    """Returns the largest wrist rotation from rest while holding and moving the part; None if out of reach."""
    before = part.grasp @ transform((0.0, 0.0, -PRE_GRASP))
    grasped = kinematics.canonical(before)
    if not grasped.within(2e-3, 0.01):
        return None
    first = kinematics.solve(part.grasp, grasped.qpos, iterations=60)
    strayed = 0.0
    for path in reach.paths:
        qpos = first.qpos
        for positions in _along(path):
            solution = kinematics.solve(part.moved(positions), qpos, iterations=40, tolerance=1e-3)
            if not solution.within(2e-3, 0.01):
                return None
            qpos = solution.qpos
            strayed = max(strayed, float(np.abs(qpos[6] - kinematics.rest[6])))
    return strayed


def _along(path: Path) -> Iterator[dict[str, float]]:
    """Yields the joint positions along a path, starting at rest."""
    here: dict[str, float] = dict.fromkeys(path[0], 0.0)
    yield here
    for leg in path:
        for fraction in np.arange(1, PATH_STEPS + 1) / PATH_STEPS:
            start = {name: here.get(name, 0.0) for name in leg}
            yield {name: start[name] + float(fraction) * (goal - start[name]) for name, goal in leg.items()}
        here = dict(leg)


@functools.cache
def placement_check(task: CategoryTask, poses: str) -> Callable[[ArticulatedObject], str]:
    """Returns a check: object -> why it cannot be placed, or an empty text. It uses kinematics alone.

    It samples one episode; an object that can be placed there can be placed in almost every episode.
    """
    spread = randomization(poses)

    def placement_problem(obj: ArticulatedObject) -> str:
        stand = task.stand(obj)
        try:
            stand.draw(np.random.default_rng(CHECK_SEED), obj, _arm(task), spread)
        except UnreachableError:
            names = " or ".join(reach.part for reach in stand.reaches)
            return f"the arm does not reach its {names} on the way to it, held and turned, wherever it stands ({poses})"
        return ""

    return placement_problem


@functools.cache
def _arm(task: CategoryTask) -> ArmKinematics:
    """Returns the kinematics of an arm without shapes, which needs no renderer."""
    import sapien

    from lerobot_env_adamanip.sim.robot import AdaManipPanda

    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    builder = loader.parse(AdaManipPanda.urdf_path)[0][0]
    for link in builder.link_builders:
        link.visual_records, link.collision_records = [], []
    return ArmKinematics(builder.build(), task.rest)
