"""The physics of one control tick: joint targets, then steps, each as exact as what touches demands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lerobot_env_adamanip.sim.kinematics import NUM_ARM_JOINTS

if TYPE_CHECKING:  # so that it loads, and is tested, without a simulator
    import sapien

CONTACT_OFFSET = 0.002
"""Two bodies nearer than twice this are a contact to be reckoned with [m]. The fastest hand goes 2.3 mm in a physics
step. ManiSkill's 20 mm make contacts of all that is in a hand's neighbourhood, at up to three times the cost."""
FREE_ITERATIONS = 4
"""Solver iterations of an arm that touches nothing. How many there are decides how hard a contact is, and each costs as
much as the next: where there is no contact, they buy nothing."""


class ControlTick:
    """Drives an arm through one control tick, of ``steps`` physics steps.

    The arm has nine joints, the fingers last; its solver iterations are those that contacts need.
    """

    def __init__(self, system: sapien.physx.PhysxCpuSystem, arm: sapien.physx.PhysxArticulation, *, steps: int) -> None:
        self._system, self._arm, self._steps = system, arm, steps
        joints = arm.active_joints
        self._joints, self._fingers = joints[:NUM_ARM_JOINTS], joints[NUM_ARM_JOINTS:]
        self._links = set(arm.links)
        self._touching_iterations = self._iterations = arm.get_solver_position_iterations()

    def run(self, target: NDArray[np.float64], velocity: NDArray[np.float64], finger: float) -> None:
        """Advances by one tick with joint targets (7,) [rad], their velocities (7,) [rad/s] and a finger target [m]."""
        for joint, position, speed in zip(self._joints, target.tolist(), velocity.tolist(), strict=True):
            joint.set_drive_target(position)
            joint.set_drive_velocity_target(speed)
        for joint in self._fingers:
            joint.set_drive_target(finger)
        touches = False
        for _ in range(self._steps):
            # PhysX knows of a contact before it is one, see `CONTACT_OFFSET`: no step is taken into it unprepared.
            touches = touches or self.touches()
            self._iterate(self._touching_iterations if touches else FREE_ITERATIONS)
            self._system.step()

    def touches(self) -> bool:
        """Returns whether anything is so near to the arm that the physics engine reckons with a contact."""
        links = self._links
        return any(not links.isdisjoint(contact.bodies) for contact in self._system.get_contacts())

    def _iterate(self, iterations: int) -> None:
        if iterations != self._iterations:
            self._arm.set_solver_position_iterations(iterations)
            self._iterations = iterations
