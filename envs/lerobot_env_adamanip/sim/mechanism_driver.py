"""A mechanism at work on a simulated object: reads its joints, writes their limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import torch
from numpy.typing import NDArray

from lerobot_adamanip.mechanisms import Mechanism

Limits = tuple[float, float]


class LimitedJoint(Protocol):
    """A joint whose limits can be set, as SAPIEN has it."""

    @property
    def name(self) -> str:
        """Ends in ``_`` and the mechanism's name of the joint."""

    def set_limits(self, limits: list[list[float]]) -> None:
        """Takes ``[[lower, upper]]`` [rad or m]."""


class LimitedArticulation(Protocol):
    """The part of a `sapien.physx.PhysxArticulation` that a mechanism needs."""

    @property
    def active_joints(self) -> Sequence[LimitedJoint]:
        """Joints that move, in the order of `get_qpos`."""

    def get_qpos(self) -> NDArray[Any]:
        """Returns the positions (J,) [rad or m]."""


class MechanismDriver:
    """Keeps an articulation within what its mechanism allows.

    Args:
        mechanism: the rules.
        state: this episode's hidden draw.
        articulation: the object.
    """

    def __init__(self, mechanism: Mechanism[Any], state: Any, articulation: LimitedArticulation) -> None:
        self.mechanism, self.state = mechanism, state
        self._articulation = articulation
        self._applied: dict[str, Limits] = {}
        self._detent: dict[str, float] | None = None

    @property
    def held(self) -> bool:
        """Whether the joints are held where they are."""
        return self._detent is not None

    def joint_positions(self) -> dict[str, float]:
        """Returns the object's joint positions [rad or m]."""
        raw = self._articulation
        return {joint_name(joint): float(q) for joint, q in zip(raw.active_joints, raw.get_qpos(), strict=True)}

    def apply(self, *, hold: bool) -> None:
        """Steps the mechanism and writes its limits; with ``hold``, joints are held where they were when it began."""
        positions = self.joint_positions()
        self._detent = (self._detent or positions) if hold else None
        self.state, command = self.mechanism.step(self.state, reading(positions))
        for joint in self._articulation.active_joints:
            name = joint_name(joint)
            limits = (float(command[name].lower[0]), float(command[name].upper[0]))
            if self._detent is not None:
                limits = (self._detent[name], self._detent[name])
            if self._applied.get(name) != limits:
                joint.set_limits([list(limits)])
                self._applied[name] = limits

    def hidden_state(self) -> dict[str, Any]:
        """Returns what cannot be seen, JSON-able: privileged, never part of an observation."""
        return self.mechanism.hidden(self.state, 0)

    def succeeded(self) -> bool:
        """Returns whether a joint is beyond its goal, see `Mechanism.goals`."""
        return bool(self.mechanism.succeeded(reading(self.joint_positions()))[0])


def joint_name(joint: LimitedJoint) -> str:
    """Returns the mechanism's name of a joint: ManiSkill puts scene and object before it."""
    return joint.name.rsplit("_", 1)[-1]


def reading(positions: Mapping[str, float]) -> dict[str, torch.Tensor]:
    """Returns a mechanism's reading of one environment."""
    return {name: torch.tensor([position]) for name, position in positions.items()}
