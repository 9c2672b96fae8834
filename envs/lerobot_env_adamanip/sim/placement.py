"""Where object, robot and camera stand: randomisation, and the check that the arm reaches what it has to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import PRE_GRASP
from lerobot_adamanip.contract.rotations import rotation_about, straight_path, transform
from lerobot_adamanip.objects import ArticulatedObject, PartAnnotation
from lerobot_adamanip.util.errors import UnreachableError, require_choice
from lerobot_env_adamanip.sim.kinematics import ArmKinematics, Pull

Array = NDArray[np.float64]

PATH_STEPS = 6
"""Poses checked on each leg of a path."""
APPROACH_STEPS, APPROACHING = 8, Pull(steps=5)
"""Poses checked on each leg of the way to a part, and how the elbow is drawn to rest on it: in a motion there is one
pull a control tick, so several for each pose here."""


@dataclass(frozen=True)
class Randomization:
    """Half widths of uniform draws around the nominal placement.

    Attributes:
        object_x, object_y: [m].
        object_yaw: [rad].
        joint: standard deviation of the start posture [rad].
        camera_position: [m] along each axis, camera and its target alike.
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
"""``fixed``: upstream's code moves neither object, robot nor camera."""


def randomization(preset: str) -> Randomization:
    """Returns a preset by name; raises `ConfigurationError` that lists them for another name."""
    return RANDOMIZATIONS[require_choice("poses", preset, RANDOMIZATIONS)]


@dataclass(frozen=True)
class Placement:
    """An episode's poses: the object's root (4, 4) and the arm's start (7,) [rad]; annotations in the base frame."""

    object_in_base: Array
    start_qpos: Array
    annotations: dict[str, PartAnnotation]


Path = tuple[Mapping[str, float], ...]
"""Joint positions [rad or m] to visit one after the other, from rest."""


@dataclass(frozen=True)
class ReachRequirement:
    """What the arm must reach at a part: hold it, and take it along every one of ``paths``.

    >>> ReachRequirement("knob", ({"knob": -1.2},), ({"knob": 1.2},))  # both ways from rest
    >>> ReachRequirement("cap", ({"cap": 2.0}, {"cap": 2.0, "lift": 0.05}))  # turn, then lift
    """

    part: str
    paths: tuple[Path, ...]

    def __init__(self, part: str, *paths: Path) -> None:
        object.__setattr__(self, "part", part)
        object.__setattr__(self, "paths", paths)


def draw_placement(
    rng: np.random.Generator,
    obj: ArticulatedObject,
    kinematics: ArmKinematics,
    reaches: tuple[ReachRequirement, ...],
    spread: Randomization,
    *,
    nominal_x: float,
    floor_z: float,
    nominal_y: float = 0.0,
    tries: int = 30,
    must_reach: bool = True,
) -> Placement:
    """Draws poses until the arm reaches every part, held and turned; one draw decides everything.

    Args:
        rng: generator of this episode's layout.
        obj: the object.
        kinematics: of the arm.
        reaches: part motions to check.
        spread: half widths.
        nominal_x: distance of the object's front from the robot's base [m].
        floor_z: height of the surface it stands on [m].
        nominal_y: of the middle of the object's front [m].
        tries: draws at most.
        must_reach: whether none is an error; else the object then stands where the last draw put it.

    Raises:
        UnreachableError: none of the draws could be reached.
    """
    for _ in range(tries):
        pose = _drawn_pose(rng, spread, nominal_x, nominal_y, floor_z)
        start = np.clip(kinematics.rest + rng.normal(size=7) * spread.joint, kinematics.lower, kinematics.upper)
        if (annotations := _reachable(obj, pose, kinematics, reaches, start)) is not None:
            return Placement(pose, start, annotations)
    if not must_reach:
        return Placement(pose, start, {part.name: part.in_frame(pose) for part in obj.parts})
    raise _unreachable(obj, f"{tries} draws around x = {nominal_x:.2f} m, floor at {floor_z:.2f} m")


def _drawn_pose(rng: np.random.Generator, spread: Randomization, x: float, y: float, z: float) -> Array:
    """An object's pose (4, 4) around its nominal place [m], facing the robot."""
    x, y = x + rng.uniform(-1, 1) * spread.object_x, y + rng.uniform(-1, 1) * spread.object_y
    yaw = np.pi + rng.uniform(-1, 1) * spread.object_yaw
    return transform((x, y, z), rotation_about((0.0, 0.0, 1.0), yaw))


def _unreachable(obj: ArticulatedObject, tried: str) -> UnreachableError:
    return UnreachableError(
        f"{obj.object_id} cannot be placed where the arm reaches its parts.",
        got=tried,
        allowed="every part within reach, on the way to it, held and turned",
        hint="--env.poses=fixed, or another object",
    )


def _reachable(
    obj: ArticulatedObject, pose: Array, kinematics: ArmKinematics, reaches: tuple[ReachRequirement, ...], start: Array
) -> dict[str, PartAnnotation] | None:
    found = {}
    for reach in reaches:
        part = obj.part(reach.part).in_frame(pose)
        candidates = [part.rolled(angle) if angle else part for angle in part.rolls]
        costs = [_cost(each, reach, kinematics) for each in candidates]
        best = sorted((cost, k) for k, cost in enumerate(costs) if cost is not None)
        chosen = next((k for _, k in best if approachable(candidates[k].grasp, kinematics, start)), None)
        if chosen is None:
            return None
        found[reach.part] = candidates[chosen]
    return found


def approachable(grasp: Array, kinematics: ArmKinematics, start: Array) -> bool:
    """Returns whether the arm gets from ``start`` (7,) [rad] straight to before a grasp (4, 4), and on to it.

    A pose that has a solution is not enough: near its full stretch the arm may not come there on a straight line. The
    steps are those of `KeyframeDriver`, but fewer.
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
    """Returns how far the wrist strays from rest while holding and moving the part; None if out of reach."""
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
    """Joint positions on the way: the first is rest."""
    here: dict[str, float] = dict.fromkeys(path[0], 0.0)
    yield here
    for leg in path:
        for fraction in np.arange(1, PATH_STEPS + 1) / PATH_STEPS:
            start = {name: here.get(name, 0.0) for name in leg}
            yield {name: start[name] + float(fraction) * (goal - start[name]) for name, goal in leg.items()}
        here = dict(leg)
