"""Touch: which joints of the object the hand has its fingers on, and which of them it pushes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import rotation_vector_from_matrix
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.mechanism_driver import joint_name

if TYPE_CHECKING:  # so that it loads, and is tested, without a simulator
    import sapien

Array = NDArray[np.float64]

HAND_LINKS = ("hand", "leftfinger", "rightfinger", "leftfinger_pad", "rightfinger_pad")
TOUCH_FORCE = 1.0
"""A contact weaker than this is a brush [N]."""
PUSH_WAY, PUSH_TURN = 0.003, 0.03
"""A push goes farther than this after the hand has touched the part [m, rad]: as far as a motion that counts."""
PUSH_LAG, PUSH_TURN_LAG = 0.003, 0.015
"""A push is held back by more than this [m, rad]: half of what ends a motion as a stall, see `MotionLimits`."""
PUSH_SHARE = 0.7
"""A push goes at least this much of its way where the part would go: what goes elsewhere is on its way there."""
NO_ROOM = 1e-3
"""A joint that is nearer than this to its nominal limit does not move farther that way [rad or m]."""


@dataclass
class _Push:
    """What the contacts that act on one joint come to: sums of forces [N], and of forces times ways [N m].

    Attributes:
        behind, sent: how far the hand is behind its target, and how far the target has gone since the hand has touched
            the part, about the joint's axis [rad].
        net: force along the joint's motion.
        total: of the forces' sizes.
        lag: force times the way by which the hand is behind, along the joint's motion.
        way: force times the way that the target has gone since, likewise.
        whole: of the forces' sizes times that way, in whatever direction.
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
        """Whether the hand is sent where the joint would have to move, and is held back by it."""
        sign = 1.0 if self.net > 0 else -1.0
        held_back = self.lag > PUSH_LAG * self.total or sign * self.behind > PUSH_TURN_LAG
        along = self.way > max(PUSH_WAY * self.total, PUSH_SHARE * self.whole)
        return abs(self.net) > TOUCH_FORCE and held_back and (along or sign * self.sent > PUSH_TURN)


class HandTouch:
    """Finds what an arm's hand (`HAND_LINKS`) touches and pushes of a target.

    The nominal limits of the object's joints are public, the same under every hidden state.
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
        """Returns the joints that carry a link which the hand touches now."""
        touched: set[str] = set()
        for carrying, contact, _ in self._contacts():
            if sum(float(np.linalg.norm(point.impulse)) for point in contact.points) / self._timestep > TOUCH_FORCE:
                touched.update(carrying)
        return touched

    def pushed(self, wanted: Array, actual: Array) -> set[str]:
        """Returns the joints that the hand pushes now, in a direction in which they can move.

        A hand pushes a joint if its contacts act along the joint's motion with more than `TOUCH_FORCE`, if it is sent
        mostly that way after it has touched the part, by more than `PUSH_WAY`, and if it is held back by `PUSH_LAG`. So
        a hand that grazes a part on its way, is turned aside by it, or leans on it otherwise, pushes nothing.
        To be called after every tick, since it remembers where the hand was sent when it began to touch.

        Args:
            wanted: tool pose (4, 4) that the joint targets stand for.
            actual: tool pose (4, 4) now.
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
        """How far a joint's nominal range lets it move in the direction of ``way`` [rad or m]."""
        lower, upper = self._ranges[name]
        position = float(self._target.get_qpos()[list(self._joints).index(name)])
        return upper - position if way > 0 else position - lower

    def _contacts(self) -> Iterator[tuple[tuple[str, ...], Any, float]]:
        """Contacts of the hand with what moves: the joints that carry it, contact, sign of its impulses on the part."""
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
    """Returns a joint's axis (3,), zero if it does not turn, and the unit vector in which ``place`` (3,) moves with it.

    On the axis of a turning joint the latter is zero.
    """
    pose = joint.global_pose.to_transformation_matrix().astype(np.float64)
    axis = pose[:3, 0]
    if joint.type == "prismatic":
        return np.zeros(3), axis
    across = np.cross(axis, place - pose[:3, 3])
    length = float(np.linalg.norm(across))
    return axis, across / length if length > 0 else across


def _joints_above(link: Any) -> tuple[str, ...]:
    """Names of the joints between a link and its root."""
    names: list[str] = []
    while link is not None:
        if link.joint.dof:
            names.append(joint_name(link.joint))
        link = link.parent
    return tuple(names)
