"""Contacts: what the arm does to the object's joints that it touches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import rotation_vector_from_matrix
from lerobot_adamanip.episode.tries import Push
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.mechanism_driver import named_joints

if TYPE_CHECKING:  # so that it can be imported and tested without a simulator
    import sapien

Array = NDArray[np.float64]

TOUCH_FORCE = 1.0
"""Minimum force of a push along the joint's motion, or of a grip [N]; a weaker one is a graze."""
PUSH_LAG, PUSH_TURN_LAG = 0.002, 0.01
"""Minimum lag of a pushing hand [m, rad]: about 9 N, a third of the lag that ends a motion as a stall."""
PUSH_WAY, PUSH_TURN = PUSH_LAG / 2, PUSH_TURN_LAG / 2
"""Minimum travel of a meant push since the arm was last free of strain [m, rad]. The arm is free of strain below half
of the lag, so a hand that is held back while its target moves travels as far; one that is deflected does not."""
PUSH_TICKS = 20
"""Maximum number of control ticks of that travel. A hand that holds a lever against its spring is never free."""
PUSH_SHARE = 0.7
"""Minimum share of a meant push along the part's motion; a hand that moves elsewhere only passes by."""
NEAR_AXIS = 0.05
"""Distance from a revolute joint's axis below which a hand turns the part by its own rotation [m]."""
METRES_PER_RADIAN = 0.3
"""Motion of a hand that counts as much as its rotation by one radian [m/rad]."""
NO_ROOM = 1e-3
"""Distance to its nominal limit below which a joint cannot move farther in that direction [rad or m]."""


@dataclass(frozen=True)
class _Hand:
    """Where the hand is sent in one control tick; (4, 4) poses and motions, robot base frame.

    Attributes:
        wanted: tool pose of the joint targets.
        before: the same at some ticks before, the latest last.
        behind: motion from the present pose to ``wanted``.
    """

    wanted: Array
    before: list[Array]
    behind: Array

    def sent(self) -> Iterator[Array]:
        """Yields the motion of the target since each tick before, the latest first."""
        for pose in reversed(self.before):
            yield self.wanted @ np.linalg.inv(pose)


class ArmContacts:
    """Measures what an arm does to each joint of a target that it touches, with any of its links.

    The nominal limits of the object's joints are public and equal under every hidden state.
    """

    def __init__(
        self,
        system: sapien.physx.PhysxCpuSystem,
        arm: sapien.physx.PhysxArticulation,
        target: sapien.physx.PhysxArticulation,
        obj: ArticulatedObject,
    ) -> None:
        self._system, self._target = system, target
        self._ranges = {link.joint.name: link.joint.limits for link in obj.links if link.joint is not None}
        self._arm = {link.entity for link in arm.links}
        self._joints = named_joints(target, self._ranges)
        names = {joint.name: name for name, joint in self._joints.items()}
        self._carrying = {link.entity: _joints_above(link, names) for link in target.links}
        self._before: list[Array] = []

    def pushes(self, wanted: Array, actual: Array) -> dict[str, Push]:
        """Returns the push on each joint that carries a touched link. Call this after every tick.

        A joint holds the arm back if the hand lags behind its target along the joint's motion by more than half of
        `PUSH_LAG`, while it grips the part, or presses on it in that direction, with more than `TOUCH_FORCE`. PhysX
        reports no friction, so what a grip transmits is measured by the lag alone. The push is meant if the hand lags
        by all of `PUSH_LAG`, and its target has moved by more than `PUSH_WAY` since the arm was free of strain, mostly
        along this motion. A hand that grazes a part, is deflected by it, or leans on it in another direction, means no
        push; nor does one that pushes a joint past its nominal limit.

        Args:
            wanted: tool pose (4, 4) of the joint targets.
            actual: present tool pose (4, 4).
        """
        behind = wanted @ np.linalg.inv(actual)
        turn = float(np.linalg.norm(rotation_vector_from_matrix(behind[:3, :3]))) / PUSH_TURN_LAG
        strain = float(np.linalg.norm(wanted[:3, 3] - actual[:3, 3])) / PUSH_LAG
        touched = self._touched()
        if not touched or max(strain, turn) < 0.5:
            self._before = self._before[-1:]
        hand = _Hand(wanted, self._before or [wanted], behind)
        self._before = [*self._before, wanted][-PUSH_TICKS:]
        return {name: self._push(name, hand, *map(np.array, zip(*each, strict=True))) for name, each in touched.items()}

    def _push(self, name: str, hand: _Hand, places: Array, forces: Array) -> Push:
        """Returns the push on one joint from its contacts: ``places`` (N, 3) [m], ``forces`` on the part (N, 3) [N]."""
        joint, sizes = self._joints[name], np.linalg.norm(forces, axis=1)
        axis, along, radius = _motion(joint, place := np.average(places, axis=0, weights=sizes))
        is_near_axis = joint.type != "prismatic" and radius < NEAR_AXIS
        strain, turn = (
            float(_shift(hand.behind, place) @ along) / PUSH_LAG,
            float(_turn(hand.behind) @ axis) / PUSH_TURN_LAG,
        )
        latest = next(hand.sent())
        step = float(_turn(latest) @ axis) if is_near_axis else float(_shift(latest, place) @ along)
        if joint.type != "prismatic" and not is_near_axis:
            step /= radius
        turns = is_near_axis and abs(turn) > abs(strain)
        strain = turn if turns else strain
        direction = 1 if strain > 0 else -1
        grip = float(sizes.sum() - np.linalg.norm(forces.sum(0)))
        transmits = max(grip, direction * float(forces.sum(0) @ along)) > TOUCH_FORCE
        if not transmits or abs(strain) < 0.5 or self._room(name, direction) < NO_ROOM:
            return Push(step)
        way = direction * (axis if turns else along)
        return Push(
            step, direction, abs(strain) > 1 and any(_is_along(each, place, way, turns) for each in hand.sent())
        )

    def _room(self, name: str, way: float) -> float:
        """Returns how far a joint's nominal range lets it move in the direction of ``way`` [rad or m]."""
        lower, upper = self._ranges[name]
        position = float(self._target.get_qpos()[list(self._joints).index(name)])
        return upper - position if way > 0 else position - lower

    def _touched(self) -> dict[str, list[tuple[Array, Array]]]:
        """Returns joint -> place [m] and force [N] of each contact of the arm with a link that the joint carries."""
        touched: dict[str, list[tuple[Array, Array]]] = {}
        for contact in self._system.get_contacts():
            first, second = (body.entity for body in contact.bodies)
            link, sign = (second, -1.0) if first in self._arm else (first, 1.0) if second in self._arm else (None, 0.0)
            if carrying := self._carrying.get(link, ()):
                for point in contact.points:
                    if np.any(point.impulse):
                        force = sign / self._system.timestep * np.asarray(point.impulse, np.float64)
                        for name in carrying:
                            touched.setdefault(name, []).append((np.asarray(point.position, np.float64), force))
        return touched


def _motion(joint: Any, place: Array) -> tuple[Array, Array, float]:
    """Returns a joint's axis (3,), the unit vector (3,) of the motion of ``place`` (3,) with it, and a radius.

    The radius [m] is the distance from the axis of a revolute joint; on it the unit vector is zero.
    """
    pose = joint.global_pose.to_transformation_matrix().astype(np.float64)
    axis = pose[:3, 0]
    if joint.type == "prismatic":
        return axis, axis, 0.0
    across = np.cross(axis, place - pose[:3, 3])
    radius = float(np.linalg.norm(across))
    return axis, across / max(radius, 1e-9), radius


def _shift(motion: Array, place: Array) -> Array:
    """Returns how far a motion (4, 4) moves ``place`` (3,) [m]."""
    moved: Array = motion[:3, :3] @ place + motion[:3, 3] - place
    return moved


def _turn(motion: Array) -> Array:
    """Returns the rotation vector (3,) of a motion (4, 4) [rad]."""
    return rotation_vector_from_matrix(motion[:3, :3])


def _is_along(motion: Array, place: Array, way: Array, turns: bool) -> bool:
    """Returns whether a motion (4, 4) moves ``place`` (3,) mostly along ``way`` (3,), or turns mostly about it."""
    shift, turn = _shift(motion, place), _turn(motion)
    if not turns:
        return bool(shift @ way > max(PUSH_WAY, PUSH_SHARE * float(np.linalg.norm(shift))))
    whole = float(np.linalg.norm(shift)) / METRES_PER_RADIAN + float(np.linalg.norm(turn))
    return bool(turn @ way > max(PUSH_TURN, PUSH_SHARE * whole))


def _joints_above(link: Any, names: Mapping[str, str]) -> tuple[str, ...]:
    """Returns the ``names`` of the joints between a link and its root."""
    found: list[str] = []
    while link is not None:
        if link.joint.dof:
            found.append(names[link.joint.name])
        link = link.parent
    return tuple(found)
