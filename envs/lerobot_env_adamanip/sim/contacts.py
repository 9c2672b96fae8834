"""Contacts: detects the object's joints that the hand touches, and those that it pushes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import rotation_vector_from_matrix
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.mechanism_driver import joint_name

if TYPE_CHECKING:  # so that it can be imported and tested without a simulator
    import sapien

Array = NDArray[np.float64]

HAND_LINKS = ("hand", "leftfinger", "rightfinger", "leftfinger_pad", "rightfinger_pad")
TOUCH_FORCE = 1.0
"""Minimum force of a contact [N]; a weaker one does not count."""
PUSH_WAY, PUSH_TURN = 0.003, 0.03
"""Minimum travel of a push after the first touch [m, rad]: as far as a motion that counts."""
PUSH_LAG, PUSH_TURN_LAG = 0.003, 0.015
"""Minimum lag of a pushing hand [m, rad]: half of the lag that ends a motion as a stall, see `MotionLimits`."""
PUSH_SHARE = 0.7
"""Minimum share of a push along the part's motion; a hand that moves elsewhere only passes by."""
NO_ROOM = 1e-3
"""Distance to its nominal limit below which a joint cannot move farther in that direction [rad or m]."""


@dataclass
class _Push:
    """Sums over the contacts that act on one joint: forces [N], and forces times distances [N m].

    Attributes:
        behind, sent: lag of the hand behind its target, and travel of the target since the hand's first touch, about
            the joint's axis [rad].
        net: force along the joint's motion.
        total: sum of the forces' magnitudes.
        lag: force times the hand's lag, along the joint's motion.
        way: force times the target's travel since the first touch, along the joint's motion.
        whole: force magnitudes times that travel, in any direction.
    """

    behind: float
    sent: float
    net: float = 0.0
    total: float = 0.0
    lag: float = 0.0
    way: float = 0.0
    whole: float = 0.0

    def add(self, force: float, lag: float, way: float, whole: float) -> None:
        size = abs(force)
        self.net, self.total = self.net + force, self.total + size
        self.lag, self.way, self.whole = self.lag + force * lag, self.way + force * way, self.whole + size * whole

    @property
    def is_meant(self) -> bool:
        """Whether the target moved along the joint's motion, and the joint held the hand back."""
        sign = 1.0 if self.net > 0 else -1.0
        held_back = self.lag > PUSH_LAG * self.total or sign * self.behind > PUSH_TURN_LAG
        along = self.way > max(PUSH_WAY * self.total, PUSH_SHARE * self.whole)
        return abs(self.net) > TOUCH_FORCE and held_back and (along or sign * self.sent > PUSH_TURN)


class HandTouch:
    """Detects contacts and pushes between an arm's hand (`HAND_LINKS`) and a target.

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
        self._hand = {link.entity for link in arm.links if link.name.endswith(HAND_LINKS)}
        self._joints = {joint_name(joint): joint for joint in target.active_joints}
        self._carrying = {link.entity: _joints_above(link) for link in target.links}
        self._touched_at: Array | None = None

    def joints(self) -> set[str]:
        """Returns the joints that carry a link in contact with the hand."""
        touched: set[str] = set()
        for carrying, contact, _ in self._contacts():
            if sum(float(np.linalg.norm(point.impulse)) for point in contact.points) / self._timestep > TOUCH_FORCE:
                touched.update(carrying)
        return touched

    def pushed(self, wanted: Array, actual: Array) -> set[str]:
        """Returns the joints that the hand pushes now, in a direction in which they can move.

        A push has three conditions. The contact force along the joint's motion exceeds `TOUCH_FORCE`. After the first
        touch, the target moved more than `PUSH_WAY`, mostly along this motion. The hand lags by more than `PUSH_LAG`.
        A hand that grazes a part, is deflected by it, or leans on it in another direction, pushes nothing. Call this
        after every tick, because it stores the target at the first touch.

        Args:
            wanted: tool pose (4, 4) of the joint targets.
            actual: present tool pose (4, 4).
        """
        contacts = list(self._contacts())
        if not contacts:
            self._touched_at = None
            return set()
        if self._touched_at is None:
            self._touched_at = wanted
        behind, since = wanted @ np.linalg.inv(actual), wanted @ np.linalg.inv(self._touched_at)
        turns = [rotation_vector_from_matrix(each[:3, :3]) for each in (behind, since)]
        pushes: dict[str, _Push] = {}
        for carrying, contact, sign in contacts:
            for point in contact.points:
                force = sign / self._timestep * np.asarray(point.impulse, np.float64)
                place = np.asarray(point.position, np.float64)
                lag, sent = (each[:3, :3] @ place + each[:3, 3] - place for each in (behind, since))
                for name in carrying:
                    axis, along = _motion(self._joints[name], place)
                    push = pushes.setdefault(name, _Push(*(float(turn @ axis) for turn in turns)))
                    pressed, late, way = (float(each @ along) for each in (force, lag, sent))
                    push.add(pressed, late, way, float(np.linalg.norm(sent)))
        return {n for n, push in pushes.items() if push.is_meant and self._room(n, push.net) > NO_ROOM}

    def _room(self, name: str, way: float) -> float:
        """Returns how far a joint's nominal range lets it move in the direction of ``way`` [rad or m]."""
        lower, upper = self._ranges[name]
        position = float(self._target.get_qpos()[list(self._joints).index(name)])
        return upper - position if way > 0 else position - lower

    def _contacts(self) -> Iterator[tuple[tuple[str, ...], Any, float]]:
        """Yields the hand's contacts with movable links: carrying joints, contact, sign of its impulses on the part."""
        for contact in self._system.get_contacts():
            first, second = (body.entity for body in contact.bodies)
            link, sign = (
                (second, -1.0) if first in self._hand else (first, 1.0) if second in self._hand else (None, 0.0)
            )
            if carrying := self._carrying.get(link, ()):
                yield carrying, contact, sign

    @property
    def _timestep(self) -> float:
        return float(self._system.timestep)


def _motion(joint: Any, place: Array) -> tuple[Array, Array]:
    """Returns a joint's axis (3,), zero if prismatic, and the unit vector of ``place``'s (3,) motion with it.

    On the axis of a revolute joint the latter is zero.
    """
    pose = joint.global_pose.to_transformation_matrix().astype(np.float64)
    axis = pose[:3, 0]
    if joint.type == "prismatic":
        return np.zeros(3), axis
    across = np.cross(axis, place - pose[:3, 3])
    length = float(np.linalg.norm(across))
    return axis, across / length if length > 0 else across


def _joints_above(link: Any) -> tuple[str, ...]:
    """Returns the names of the joints between a link and its root."""
    names: list[str] = []
    while link is not None:
        if link.joint.dof:
            names.append(joint_name(link.joint))
        link = link.parent
    return tuple(names)
