"""Physics of one control tick: sets joint targets, then steps; uses more solver iterations for contacts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lerobot_env_adamanip.sim.kinematics import NUM_ARM_JOINTS

if TYPE_CHECKING:  # so that it can be imported and tested without a simulator
    import sapien

CONTACT_OFFSET = 0.002
"""Half of the distance at which PhysX creates contacts between two bodies [m]. The fastest hand moves 2.3 mm per
physics step. ManiSkill's 20 mm creates contacts with everything near the hand, at up to three times the cost."""
FREE_ITERATIONS = 4
"""Solver iterations of an arm without contacts. Iterations only harden contacts, and all cost the same, so more would
bring nothing here."""
GRIP_TICKS = 8
"""Control ticks in which fingers settle around a part."""
STAYING = 1e-3
"""Maximum motion of joint targets in a control tick at which the arm stays [rad]."""
VELOCITY_LAG = 0.1
"""Time in which a drive of velocities would catch up with its lag [s]."""


class Closing:
    """Detects that fingers close around a part: their target falls, or fell `GRIP_TICKS` ago, and the arm stays."""

    def __init__(self) -> None:
        self._finger, self._left = np.inf, 0
        self._arm: NDArray[np.float64] = np.zeros(NUM_ARM_JOINTS)

    def update(self, arm: NDArray[np.float64], finger: float) -> bool:
        """Advances by one control tick with joint targets (7,) [rad] and a finger target [m]."""
        self._left = GRIP_TICKS if finger < self._finger < np.inf else max(0, self._left - 1)
        stays = float(np.abs(arm - self._arm).max()) < STAYING
        self._finger, self._arm = finger, arm
        return stays and self._left > 0


class ControlTick:
    """Runs one control tick of an arm, with ``steps`` physics steps.

    The arm has nine joints, with the fingers last. Its solver iterations are those for contacts.
    """

    def __init__(self, system: sapien.physx.PhysxCpuSystem, arm: sapien.physx.PhysxArticulation, *, steps: int) -> None:
        self._system, self._arm, self._steps = system, arm, steps
        joints = arm.active_joints
        self._joints, self._fingers = joints[:NUM_ARM_JOINTS], joints[NUM_ARM_JOINTS:]
        self._links = set(arm.links)
        self._touching_iterations = self._iterations = arm.get_solver_position_iterations()

    def run(self, target: NDArray[np.float64], velocity: NDArray[np.float64], finger: float) -> None:
        """Runs one tick with joint targets (7,) [rad], their velocities (7,) [rad/s] and a finger target [m]."""
        for joint, position, speed in zip(self._joints, target.tolist(), velocity.tolist(), strict=True):
            joint.set_drive_target(position)
            joint.set_drive_velocity_target(speed)
        for joint in self._fingers:
            joint.set_drive_target(finger)
        touches = False
        for _ in range(self._steps):
            # PhysX reports a contact before it happens, see `CONTACT_OFFSET`: every contact step has all iterations.
            touches = touches or self.touches()
            self._iterate(self._touching_iterations if touches else FREE_ITERATIONS)
            self._system.step()

    def touches(self) -> bool:
        """Returns whether PhysX has a contact of the arm, including imminent ones."""
        links = self._links
        return any(not links.isdisjoint(contact.bodies) for contact in self._system.get_contacts())

    def _iterate(self, iterations: int) -> None:
        if iterations != self._iterations:
            self._arm.set_solver_position_iterations(iterations)
            self._iterations = iterations


def drive_targets(arm: sapien.physx.PhysxArticulation) -> NDArray[np.float64]:
    """Returns the targets (7,) [rad] of an arm's drives. A drive of velocities is that far ahead of the arm."""
    joints, qpos, qvel = arm.active_joints[:NUM_ARM_JOINTS], arm.get_qpos(), arm.get_qvel()
    return np.array(
        [
            joint.drive_target[0]
            if joint.stiffness
            else qpos[k] + VELOCITY_LAG * (joint.drive_velocity_target[0] - qvel[k])
            for k, joint in enumerate(joints)
        ],
        np.float64,
    )


def finger_target(arm: sapien.physx.PhysxArticulation) -> float:
    """Returns the target of an arm's fingers [m]."""
    return float(arm.active_joints[NUM_ARM_JOINTS].drive_target[0])
