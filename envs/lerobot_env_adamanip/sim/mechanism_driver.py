"""Driver of a mechanism on a simulated object: reads joints, writes their limits, and holds untried joints."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from lerobot_adamanip.mechanisms import Limits, Mechanism


class MechanismDriver:
    """Keeps an articulation within its mechanism's limits, and hides the mechanism until a try.

    At reset every joint is *held*: its limits are closed around its position. This models the latch, detent or
    friction of a real joint, and makes the simulator bit-identical under every hidden state. A try releases a joint for
    the rest of the episode. There are two kinds of tries. A closed hand that touches a link on the joint is sent
    elsewhere, or any hand is sent against it in its direction of motion (`HandTouch.pushed`). Until then nothing shows:
    neither on the way to a part, nor at contact, nor while the fingers close. A *detent* also holds released joints
    while a key frame only closes the fingers. They close unevenly, and would move a free joint before its next try.

    ``state`` is this episode's hidden state, ``articulation`` a `sapien.physx.PhysxArticulation`. Tests disable
    ``hold`` to show its effect.
    """

    def __init__(self, mechanism: Mechanism[Any], state: Any, articulation: Any, *, hold: bool = True) -> None:
        self.mechanism, self.state = mechanism, state
        self.detent = False
        self._articulation = articulation
        self._joints = {joint_name(joint): joint for joint in articulation.active_joints}
        self._untried = set(mechanism.joints) if hold else set()
        self._applied: dict[str, Limits] = {}
        self._held: dict[str, float] = {}

    @property
    def untried(self) -> frozenset[str]:
        """Joints without a try so far."""
        return frozenset(self._untried)

    def joint_positions(self) -> dict[str, float]:
        """Returns the object's joint positions [rad or m]."""
        return dict(zip(self._joints, self._articulation.get_qpos().tolist(), strict=True))

    def update(self, *, detent: bool, tried: Collection[str] = ()) -> None:
        """Releases tried joints and sets the detent; writes limits only if something changes."""
        if detent != self.detent or not self._untried.isdisjoint(tried):
            self._untried.difference_update(tried)
            self.detent = detent
            self.apply()

    def apply(self) -> None:
        """Steps the mechanism and writes its limits, except for held joints."""
        held = self.mechanism.joints if self.detent else self._untried
        if self._held.keys() == self._joints.keys() == set(held):
            return  # nothing has moved since, and nothing can
        positions = self.joint_positions()
        self._held = {name: self._held.get(name, positions[name]) for name in held}
        self.state, command = self.mechanism.step(self.state, positions)
        for name, joint in self._joints.items():
            limits = (self._held[name], self._held[name]) if name in self._held else command[name]
            if self._applied.get(name) != limits:
                joint.set_limits([list(limits)])
                self._applied[name] = limits

    def hidden_state(self) -> dict[str, Any]:
        """Returns the hidden state, JSON-serialisable; privileged, never part of an observation."""
        return self.mechanism.hidden(self.state)

    def succeeded(self) -> bool:
        """Returns whether a joint is beyond its goal, see `Mechanism.goals`."""
        return self.mechanism.succeeded(self.joint_positions())


def joint_name(joint: Any) -> str:
    """Returns the mechanism's name of a joint, without ManiSkill's prefix of scene and object."""
    return str(joint.name).rsplit("_", 1)[-1]
