"""The arm: inverse kinematics with joint limits, and what the joints feel. The base frame is the robot's root link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sapien
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

NUM_ARM_JOINTS = 7
REST_QPOS = np.array([0.0, -0.45, 0.0, -2.35, 0.0, 3.40, 0.785])
"""Hand level and forward in front of the robot; also where spare freedom is pulled to."""
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

    def __init__(self, articulation: sapien.physx.PhysxArticulation, tcp_link: str = "panda_hand_tcp") -> None:
        self._model: Any = articulation.create_pinocchio_model()
        names = [link.name.split("_", 1)[-1] if link.name.startswith("scene") else link.name for link in articulation.links]
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

    def solve(self, goal: Array, start: Array, *, iterations: int = 40, tolerance: float = 1e-4) -> IKResult:
        """Returns joint positions that bring the tool to ``goal`` (4, 4), from ``start`` (7,), never past a limit.

        Args:
            goal: pose in the base frame.
            start: initial guess [rad].
            iterations: steps at most; a warm start needs two or three.
            tolerance: position [m] and rotation [rad] error at which to stop.
        """
        qpos = np.clip(start, self.lower, self.upper)
        for _ in range(iterations):
            error = pose_error(self.tcp_in_base(qpos), goal)
            if np.abs(error).max() < tolerance:
                break
            jacobian = self.body_jacobian(qpos)
            damped = jacobian @ jacobian.T + 1e-4 * np.eye(6)
            step = jacobian.T @ np.linalg.solve(damped, error)
            spare = 0.05 * (REST_QPOS - qpos)
            step += spare - jacobian.T @ np.linalg.solve(damped, jacobian @ spare)
            qpos = np.clip(qpos + np.clip(step, -0.2, 0.2), self.lower, self.upper)
        error = pose_error(self.tcp_in_base(qpos), goal)
        return IKResult(qpos, float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:])))

    def tool_wrench(self, qpos: Array, torque: Array) -> Array:
        """Returns the (6,) force [N] and torque [N m] in the tool frame that joint torques (7,) exert at the tool."""
        jacobian = self.body_jacobian(qpos)
        return np.asarray(np.linalg.lstsq(jacobian.T, torque, rcond=1e-2)[0])


def pose_error(actual: Array, goal: Array) -> Array:
    """Returns the (6,) twist in the actual tool frame that leads to the goal: metres, then radians."""
    rotation = actual[:3, :3].T
    turn = Rotation.from_matrix(rotation @ goal[:3, :3]).as_rotvec()
    return np.concatenate([rotation @ (goal[:3, 3] - actual[:3, 3]), turn])
