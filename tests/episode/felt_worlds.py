"""Hands that move by hand-written rules: streams of states and commands for felt tries, without a simulator."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.dense_codec import delta_action, pose_state
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.contract.schema import STATE_DIM
from lerobot_adamanip.episode.memory import Memory

Array = NDArray[np.float64]
DOWN = rotation_about((1.0, 0.0, 0.0), np.pi)
"""Rotation of a tool that points straight down."""
GRIP = 0.3
"""Opening of a hand that holds something."""


@dataclass
class Stream:
    """A hand's stream, which its memory follows.

    Attributes:
        memory: memory to follow.
        pose: (4, 4) measured tool pose.
        gripper: measured opening.
        states, actions: all so far; there is one state more.
    """

    memory: Memory
    pose: Array = field(default_factory=lambda: transform((0.5, 0.0, 0.3), DOWN))
    gripper: float = 1.0
    is_dense: bool = False
    states: list[NDArray[np.float32]] = field(default_factory=list)
    actions: list[NDArray[np.float32]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.states.append(self._state())

    def _state(self) -> NDArray[np.float32]:
        if self.is_dense:
            return pose_state(self.pose, self.gripper)
        pose = pose_vector(self.pose, self.gripper)
        return np.concatenate([pose, np.zeros(STATE_DIM - len(pose))]).astype(np.float32)

    def sends(
        self, shift: tuple[float, ...] = (0, 0, 0), turn: float = 0.0, *, share: float, opens: bool = False
    ) -> None:
        """Commands a motion in the tool's frame [m], and a turn about its approach [rad]; the hand covers a share."""
        goals = [
            self.pose @ transform(np.multiply(part, shift), rotation_about((0.0, 0.0, 1.0), part * turn))
            for part in (1.0, share)
        ]
        target = 1.0 if opens else 0.0
        self.actions.append(
            delta_action(goals[0], target, pose_from_state(self.states[-1]))
            if self.is_dense
            else pose_vector(goals[0], target)
        )
        self.pose = goals[1]
        self.states.append(self._state())
        self.memory.after(self.states[-2], self.actions[-1], self.states[-1])

    def grasps(self, gripper: float = GRIP) -> None:
        """Closes the hand where it is."""
        self.gripper = gripper
        self.sends(share=1.0)

    def opens(self) -> None:
        """Opens the hand where it is."""
        self.gripper = 1.0
        self.sends(share=1.0, opens=True)


def pose_from_state(state: NDArray[np.float32]) -> Array:
    """Returns the tool pose (4, 4) of a state of either kind."""
    from lerobot_adamanip.episode.memory import hand_of

    return pose_from_vector(state[:10])[0] if len(state) == STATE_DIM else hand_of(state).tcp_in_base
