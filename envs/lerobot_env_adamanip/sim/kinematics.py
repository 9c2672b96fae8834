"""The arm: inverse kinematics with joint limits, and what the joints feel. The base frame is the robot's root link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.rotations import rotation_vector_from_matrix

if TYPE_CHECKING:  # so that the driver and the layout's presets load, and are tested, without a simulator
    import sapien

Array = NDArray[np.float64]

NUM_ARM_JOINTS = 7
LEVEL_REST = np.array([1.544, 1.467, -2.540, -2.320, 2.025, 1.976, -0.171])
"""Hand level and forward at (0.45, 0, 0.74) m with the elbow out to the left, and where spare freedom is pulled to.

With the elbow in the vertical plane a level hand is near-singular and the sixth joint at its limit; from this posture
the whole of x 0.35-0.66, y +-0.18, z 0.60-0.84 m is reached, yawed by +-43 and rolled by +-92 degrees.
"""
DOWN_REST = np.array([0.0, -0.287, 0.0, -1.376, 0.0, 1.090, np.pi / 4])
"""Hand pointing down at (0.38, 0, 0.70) m, above what stands on a plinth: for what is held from above.

At x = 0.42 m a hand that points down comes up to 0.74 m, where the arm is stretched.
"""
HIGH_REST = np.array([0.0, -0.219, 0.0, -1.341, 0.0, 1.122, 0.0])
"""Hand pointing down at (0.41, 0, 0.69) m, above what stands on a plinth, the last joint in the middle of its range: a
cap held from above turns by +-2.35 rad, for grasps yawed by up to +-0.5 from there, at x 0.36-0.52, z 0.55-0.70 m."""
LIMIT_MARGIN = 0.02
"""Kept from every joint limit [rad]."""


@dataclass(frozen=True)
class IKResult:
    """Joint positions (7,) [rad] and the pose error left: metres and radians."""

    qpos: Array
    position_error: float
    rotation_error: float

    def within(self, position: float, rotation: float) -> bool:
        """True if both errors are below the given bounds [m, rad]."""
        return self.position_error <= position and self.rotation_error <= rotation


class ArmKinematics:
    """Forward and inverse kinematics of the Panda by SAPIEN's Pinocchio model.

    SAPIEN's own solver knows neither joint limits nor what to do with the seventh joint; this one steps damped least
    squares inside the limits and pulls the spare freedom towards a rest posture, so that equal poses get equal elbows.
    """

    def __init__(
        self,
        articulation: sapien.physx.PhysxArticulation,
        rest: Array = LEVEL_REST,
        tcp_link: str = "panda_hand_tcp",
    ) -> None:
        self.rest = rest
        self._model: Any = articulation.create_pinocchio_model()
        names = [
            link.name.split("_", 1)[-1] if link.name.startswith("scene") else link.name for link in articulation.links
        ]
        self._tcp = next(i for i, name in enumerate(names) if name.endswith(tcp_link))
        limits = np.asarray(articulation.get_qlimits(), dtype=np.float64)[:NUM_ARM_JOINTS]
        self.lower, self.upper = limits[:, 0] + LIMIT_MARGIN, limits[:, 1] - LIMIT_MARGIN
        self._fingers = np.zeros(articulation.dof - NUM_ARM_JOINTS)

    def tcp_in_base(self, qpos: Array) -> Array:
        """Returns the (4, 4) pose of the tool centre point for arm joints (7,) [rad]."""
        self._model.compute_forward_kinematics(np.concatenate([qpos, self._fingers]))
        return np.asarray(self._model.get_link_pose(self._tcp).to_transformation_matrix(), dtype=np.float64)

    def body_jacobian(self, qpos: Array) -> Array:
        """Returns the (6, 7) Jacobian, tool frame: linear rows first."""
        full = self._model.compute_single_link_local_jacobian(np.concatenate([qpos, self._fingers]), self._tcp)
        return np.asarray(full, dtype=np.float64)[:, :NUM_ARM_JOINTS]

    def canonical(self, goal: Array) -> IKResult:
        """Returns the posture for ``goal`` (4, 4) that is nearest to rest, wherever the arm is now."""
        return self.solve(goal, self.rest, iterations=120, posture_steps=60)

    def solve(
        self, goal: Array, start: Array, *, iterations: int = 40, posture_steps: int = 1, tolerance: float = 1e-4
    ) -> IKResult:
        """Returns joint positions that bring the tool to ``goal`` (4, 4), from ``start`` (7,), never past a limit.

        Args:
            goal: pose in the base frame.
            start: initial guess [rad].
            iterations: steps at most; a warm start needs two or three.
            posture_steps: how many of them also pull the elbow towards rest. One for each step of a path keeps the
                motion smooth; as many as there are iterations finds the canonical posture of a pose.
            tolerance: position [m] and rotation [rad] error at which to stop.
        """
        qpos = np.clip(start, self.lower, self.upper)
        for number in range(iterations):
            error = pose_error(self.tcp_in_base(qpos), goal)
            if number >= posture_steps and np.abs(error).max() < tolerance:
                break
            jacobian = self.body_jacobian(qpos)
            inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + 1e-4 * np.eye(6))
            step = np.clip(inverse @ error, -0.2, 0.2)
            if number < posture_steps:
                spare = 0.1 * (self.rest - qpos)
                step += np.clip(spare - inverse @ (jacobian @ spare), -0.02, 0.02)
            qpos = np.clip(qpos + step, self.lower, self.upper)
        error = pose_error(self.tcp_in_base(qpos), goal)
        return IKResult(qpos, float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:])))


def joint_path(start: Array, end: Array, largest_step: float) -> Array:
    """Returns postures (K, 7) on a straight line in joint space, without ``start``, at most so far apart [rad]."""
    steps = max(1, int(np.ceil(np.abs(end - start).max() / largest_step)))
    return start + np.linspace(0.0, 1.0, steps + 1)[1:, None] * (end - start)


def pose_error(actual: Array, goal: Array) -> Array:
    """Returns the (6,) twist in the actual tool frame that leads to the goal: metres, then radians."""
    rotation = actual[:3, :3].T
    turn = rotation_vector_from_matrix(rotation @ goal[:3, :3])
    return np.concatenate([rotation @ (goal[:3, 3] - actual[:3, 3]), turn])
