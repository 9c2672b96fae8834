"""Driver of a mechanism on a simulated object: reads joints, writes their limits, and holds untried joints."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from lerobot_adamanip.mechanisms import Limits, Mechanism


class MechanismDriver:
    """Keeps an articulation within its mechanism's limits, and hides the mechanism until a try.

    A *held* joint has its limits closed around its position. This models the latch, detent or friction of a real joint,
    and makes the simulator bit-identical under every hidden state. A joint is held while it is at rest and no try moves
    it, see `TryTracker`: neither the way to a part, nor contact, nor a graze shows anything. All joints are held while
    fingers close: they close unevenly, and would move a free joint before its next try.

    ``state`` is this episode's hidden state, ``articulation`` a `sapien.physx.PhysxArticulation`. Tests disable
    ``hold`` to show its effect.
    """

    def __init__(self, mechanism: Mechanism[Any], state: Any, articulation: Any, *, hold: bool = True) -> None:
        self.mechanism, self.state = mechanism, state
        self._articulation, self._hold = articulation, hold
        self._joints = named_joints(articulation, mechanism.joints)
        self._applied: dict[str, Limits] = {}
        self._held: dict[str, float] = {}
        self.apply(mechanism.joints)

    def joint_positions(self) -> dict[str, float]:
        """Returns the object's joint positions [rad or m]."""
        return dict(zip(self._joints, self._articulation.get_qpos().tolist(), strict=True))

    @property
    def held(self) -> frozenset[str]:
        """Joints that are held now."""
        return frozenset(self._held)

    def apply(self, held: Collection[str]) -> None:
        """Steps the mechanism and writes its limits, except for ``held`` joints, which stay where they are."""
        if not self._hold:
            held = ()
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


def named_joints(articulation: Any, names: Collection[str]) -> dict[str, Any]:
    """Returns name -> active joint of an articulation, in its order; ManiSkill prefixes names with scene and object."""
    return {
        max((name for name in names if f"_{joint.name}".endswith(f"_{name}")), key=len): joint
        for joint in articulation.active_joints
    }
