"""A mechanism at work on a simulated object: reads its joints, writes their limits, and holds what nobody has tried."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from lerobot_adamanip.mechanisms import Limits, Mechanism


class MechanismDriver:
    """Keeps an articulation within what its mechanism allows, and hides the mechanism until somebody tries it.

    From reset on every joint is *held*: its limits are closed around where it stands, whatever the hidden draw, as the
    latch, detent or friction of a real one holds it below its break-away torque. So the simulator is the same to the
    bit under every hidden state. A joint is released for the rest of the episode when a closed hand that touches what
    it carries is sent somewhere else, or when a hand, whatever its fingers do, is sent against it in the direction in
    which it moves (`HandTouch.pushed`): when it is tried. Until then nothing shows, neither on the way to a part, nor
    in touching it, nor in closing the fingers on it. A *detent* holds the released ones, too, while a key frame does
    nothing but close the fingers: these close unevenly, and would move what is free before it is tried anew.

    ``state`` is this episode's hidden draw, ``articulation`` a `sapien.physx.PhysxArticulation`. A test turns ``hold``
    off, to show what it is good for.
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
        """Joints that nobody has tried yet."""
        return frozenset(self._untried)

    def joint_positions(self) -> dict[str, float]:
        """Returns the object's joint positions [rad or m]."""
        return dict(zip(self._joints, self._articulation.get_qpos().tolist(), strict=True))

    def update(self, *, detent: bool, tried: Collection[str] = ()) -> None:
        """Releases what is tried and sets the detent, at once; writes nothing if neither changes anything."""
        if detent != self.detent or not self._untried.isdisjoint(tried):
            self._untried.difference_update(tried)
            self.detent = detent
            self.apply()

    def apply(self) -> None:
        """Steps the mechanism, and writes its limits but for the joints that are held."""
        held = self.mechanism.joints if self.detent else self._untried
        if self._held.keys() == self._joints.keys() == set(held):
            return  # nothing has moved since, and nothing may
        positions = self.joint_positions()
        self._held = {name: self._held.get(name, positions[name]) for name in held}
        self.state, command = self.mechanism.step(self.state, positions)
        for name, joint in self._joints.items():
            limits = (self._held[name], self._held[name]) if name in self._held else command[name]
            if self._applied.get(name) != limits:
                joint.set_limits([list(limits)])
                self._applied[name] = limits

    def hidden_state(self) -> dict[str, Any]:
        """Returns what cannot be seen, JSON-able: privileged, never part of an observation."""
        return self.mechanism.hidden(self.state)

    def succeeded(self) -> bool:
        """Returns whether a joint is beyond its goal, see `Mechanism.goals`."""
        return self.mechanism.succeeded(self.joint_positions())


def joint_name(joint: Any) -> str:
    """Returns the mechanism's name of a joint: ManiSkill puts scene and object before it."""
    return str(joint.name).rsplit("_", 1)[-1]
