"""Contacts: what the arm does to the object's joints that it touches."""

from __future__ import annotations

from collections.abc import Mapping
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
PUSH_LAG, PUSH_TURN_LAG = 0.003, 0.015
"""Minimum lag of a pushing hand [m, rad]: half of the lag that ends a motion as a stall, see `MotionLimits`."""
PUSH_WAY, PUSH_TURN = PUSH_LAG / 2, PUSH_TURN_LAG / 2
"""Minimum travel of a meant push since the arm was last free of strain [m, rad]. The arm is free of strain below half
of the lag, so a hand that is held back while its target moves travels as far; one that is deflected does not."""
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
    """Motion of the hand in one control tick: (4, 4) transforms that move points of the hand, robot base frame.

    Attributes:
        behind: from the present pose to that of the joint targets.
        sent: motion of the target since the arm was free of strain.
        step: motion of the target in this tick.
    """

    behind: Array
    sent: Array
    step: Array

    def shifts(self, places: Array) -> list[Array]:
        """Returns the motions of ``places`` (N, 3) [m] by each transform, three of (N, 3)."""
        return [places @ each[:3, :3].T + each[:3, 3] - places for each in (self.behind, self.sent, self.step)]

    @property
    def turn(self) -> Array:
        """Rotation vector (3,) of ``sent`` [rad]."""
        return rotation_vector_from_matrix(self.sent[:3, :3])

    def turns(self, axis: Array) -> list[float]:
        """Returns the rotations about ``axis`` (3,) by each transform [rad]."""
        transforms = (self.behind, self.sent, self.step)
        return [float(rotation_vector_from_matrix(each[:3, :3]) @ axis) for each in transforms]


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
        self._free_at: Array | None = None
        self._wanted: Array | None = None

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
        strain = float(np.linalg.norm(wanted[:3, 3] - actual[:3, 3])) / PUSH_LAG
        turn = float(np.linalg.norm(rotation_vector_from_matrix(behind[:3, :3]))) / PUSH_TURN_LAG
        touched = self._touched()
        if not touched or self._free_at is None or max(strain, turn) < 0.5:
            self._free_at = wanted
        before, self._wanted = wanted if self._wanted is None else self._wanted, wanted
        hand = _Hand(behind, wanted @ np.linalg.inv(self._free_at), wanted @ np.linalg.inv(before))
        return {
            name: self._push(name, hand, *map(np.array, zip(*points, strict=True))) for name, points in touched.items()
        }

    def _push(self, name: str, hand: _Hand, places: Array, forces: Array) -> Push:
        """Returns the push on one joint from its contacts: ``places`` (N, 3) [m], ``forces`` on the part (N, 3) [N]."""
        joint, sizes = self._joints[name], np.linalg.norm(forces, axis=1)
        axis, along, radii = _motion(joint, places)
        weights = sizes / sizes.sum()
        shifts = hand.shifts(places)
        lag, way, step = (float(weights @ (shift * along).sum(1)) for shift in shifts)
        net, grip = float((forces * along).sum()), float(sizes.sum() - np.linalg.norm(forces.sum(0)))
        radius, whole = float(weights @ radii), float(weights @ np.linalg.norm(shifts[1], axis=1))
        strain, is_along = lag / PUSH_LAG, abs(way) > max(PUSH_WAY, PUSH_SHARE * whole)
        if joint.type != "prismatic":
            turns = hand.turns(axis)
            step = float(turns[2]) if radius < NEAR_AXIS else step / radius
            if radius < NEAR_AXIS and abs(turns[0]) / PUSH_TURN_LAG > abs(strain):
                strain, way = turns[0] / PUSH_TURN_LAG, turns[1]
                other = PUSH_SHARE * (whole / METRES_PER_RADIAN + float(np.linalg.norm(hand.turn)))
                is_along = abs(way) > max(PUSH_TURN, other)
        direction = 1 if strain > 0 else -1
        transmits = max(grip, direction * net) > TOUCH_FORCE
        if not transmits or abs(strain) < 0.5 or self._room(name, direction) < NO_ROOM:
            return Push(step)
        return Push(step, direction, bool(abs(strain) > 1 and is_along and direction * way > 0))

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


def _motion(joint: Any, places: Array) -> tuple[Array, Array, Array]:
    """Returns a joint's axis (3,), the unit vectors (N, 3) of the motion of ``places`` (N, 3) with it, and radii (N,).

    The radii [m] are distances from the axis of a revolute joint; on it the unit vector is zero.
    """
    pose = joint.global_pose.to_transformation_matrix().astype(np.float64)
    axis = pose[:3, 0]
    if joint.type == "prismatic":
        return axis, np.tile(axis, (len(places), 1)), np.zeros(len(places))
    across = np.cross(axis, places - pose[:3, 3])
    radii = np.linalg.norm(across, axis=1)
    return axis, across / np.maximum(radii, 1e-9)[:, None], radii


def _joints_above(link: Any, names: Mapping[str, str]) -> tuple[str, ...]:
    """Returns the ``names`` of the joints between a link and its root."""
    found: list[str] = []
    while link is not None:
        if link.joint.dof:
            found.append(names[link.joint.name])
        link = link.parent
    return tuple(found)
