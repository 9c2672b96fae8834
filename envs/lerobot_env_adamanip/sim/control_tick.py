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
