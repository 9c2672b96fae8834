"""Kinematics of the arm: inverse kinematics with joint limits. The base frame is the robot's root link."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from lerobot_adamanip.contract.cameras import TOOL
from lerobot_adamanip.contract.rotations import rotation_vector_from_matrix

if TYPE_CHECKING:  # so that driver and placement presets can be imported and tested without a simulator
    import sapien

Array = NDArray[np.float64]

NUM_ARM_JOINTS = 7
LEVEL_REST = np.array([1.544, 1.467, -2.540, -2.320, 2.025, 1.976, -0.171])
"""Rest posture: hand level and forward at (0.45, 0, 0.74) m, with the elbow to the left.

With the elbow in the vertical plane, a level hand is near-singular and the sixth joint at its limit. From this posture
the arm reaches x 0.35-0.66, y +-0.18, z 0.60-0.84 m, with yaw +-43 and roll +-92 degrees.
"""
DOWN_REST = np.array([0.0, -0.287, 0.0, -1.376, 0.0, 1.090, np.pi / 4])
"""Rest posture: hand down at (0.38, 0, 0.70) m, above objects on a plinth, for grasps from above.

At x = 0.42 m the downward hand is limited to a height of 0.74 m, where the arm is stretched.
"""
HIGH_REST = np.array([0.0, -0.219, 0.0, -1.341, 0.0, 1.122, 0.0])
"""Rest posture: hand down at (0.41, 0, 0.69) m, with the last joint in the middle of its range. A cap gripped from
above turns by +-2.35 rad, for grasps with yaw up to +-0.5 from there, at x 0.36-0.52, z 0.55-0.70 m."""
LIMIT_MARGIN = 0.02
"""Margin to every joint limit [rad]."""
DAMPING = 1e-4
"""Damping of the least squares, which shortens steps of a stretched arm."""
LARGEST_STEP = 0.2
"""Maximum step of one iteration towards the goal [rad]."""


@dataclass(frozen=True)
class Pull:
    """Pull of the redundant degree of freedom towards rest, per iteration.

    Attributes:
        share: fraction of the distance to rest.
        largest: maximum per iteration [rad].
        steps: number of iterations with a pull. One per step of a path keeps the motion smooth.
        settled: pull below which the posture counts as nearest to rest, and pulling ends [rad].
    """

    share: float = 0.1
    largest: float = 0.02
    steps: int = 1
    settled: float = 0.0


ALONG = Pull()
"""For a motion."""
CANONICAL = Pull(share=0.5, largest=0.2, steps=60, settled=1e-3)
"""For the posture of a pose, independent of the arm's present posture."""


@dataclass(frozen=True)
class IKResult:
    """Joint positions (7,) [rad] and the remaining pose error: metres and radians."""

    qpos: Array
    position_error: float
    rotation_error: float

    def within(self, position: float, rotation: float) -> bool:
        """Returns whether both errors are below the given bounds [m, rad]."""
        return self.position_error <= position and self.rotation_error <= rotation


class ArmKinematics:
    """Forward and inverse kinematics of the Panda by SAPIEN's Pinocchio model.

    SAPIEN's solver has no joint limits and leaves the seventh joint undefined. This one uses damped least squares
    inside the limits and pulls the redundant degree of freedom to a rest posture: equal poses get equal elbows.
    """

    def __init__(self, articulation: sapien.physx.PhysxArticulation, rest: Array = LEVEL_REST) -> None:
        self.rest = rest
        self._model: Any = articulation.create_pinocchio_model()
        self._tcp = next(i for i, link in enumerate(articulation.links) if link.name.endswith(TOOL))
        limits = np.asarray(articulation.get_qlimits(), dtype=np.float64)[:NUM_ARM_JOINTS]
        self.lower, self.upper = limits[:, 0] + LIMIT_MARGIN, limits[:, 1] - LIMIT_MARGIN
        self._qpos = np.zeros(articulation.dof)  # the fingers stay at 0, as they do not move the tool

    def tcp_in_base(self, qpos: Array) -> Array:
        """Returns the (4, 4) pose of the tool centre point for arm joints (7,) [rad]."""
        self._qpos[:NUM_ARM_JOINTS] = qpos
        self._model.compute_forward_kinematics(self._qpos)
        return np.asarray(self._model.get_link_pose(self._tcp).to_transformation_matrix(), dtype=np.float64)

    def body_jacobian(self, qpos: Array) -> Array:
        """Returns the (6, 7) Jacobian, tool frame: linear rows first."""
        self._qpos[:NUM_ARM_JOINTS] = qpos
        full = self._model.compute_single_link_local_jacobian(self._qpos, self._tcp)
        return np.asarray(full, dtype=np.float64)[:, :NUM_ARM_JOINTS]

    def canonical(self, goal: Array) -> IKResult:
        """Returns the posture for ``goal`` (4, 4) nearest to rest, independent of the arm's present posture."""
        return self.solve(goal, self.rest, iterations=120, pull=CANONICAL)

    def solve(
        self, goal: Array, start: Array, *, iterations: int = 40, pull: Pull = ALONG, tolerance: float = 1e-4
    ) -> IKResult:
        """Returns joint positions that bring the tool to ``goal`` (4, 4), from ``start`` (7,), within all limits.

        A warm start needs two or three iterations. ``tolerance`` is the error [m, rad] at which it stops.
        """
        qpos, pulls = self.inside(start), pull.steps
        for _ in range(iterations):
            error = pose_error(self.tcp_in_base(qpos), goal)
            if not pulls and max(map(abs, error.tolist())) < tolerance:
                break
            step, pulled = self._step(qpos, error, pull if pulls else None)
            pulls = max(0, pulls - 1) if pulled >= pull.settled else 0
            qpos = self.inside(qpos + step)
        else:
            error = pose_error(self.tcp_in_base(qpos), goal)
        position, rotation = error[:3].tolist(), error[3:].tolist()
        return IKResult(qpos, math.hypot(*position), math.hypot(*rotation))

    def _step(self, qpos: Array, error: Array, pull: Pull | None) -> tuple[Array, float]:
        """Returns the damped step (7,) for a tool twist (6,), and the size of the pull in it [rad].

        A control tick runs a few of these, and a reset hundreds, so the number of NumPy calls matters.
        """
        jacobian = self.body_jacobian(qpos)
        square = jacobian @ jacobian.T
        square.flat[::7] += DAMPING
        if pull is None:
            return _bounded(jacobian.T @ dposv(square, error)[1], LARGEST_STEP), 0.0
        spare = pull.share * (self.rest - qpos)
        targets = np.empty((6, 2), order="F")
        targets[:, 0], targets[:, 1] = error, jacobian @ spare
        step, taken = (jacobian.T @ dposv(square, targets)[1]).T
        pulled = _bounded(spare - taken, pull.largest)
        return _bounded(step, LARGEST_STEP) + pulled, max(map(abs, pulled.tolist()))

    def inside(self, qpos: Array) -> Array:
        """Returns joint positions (7,) clipped to all limits."""
        return np.asarray(np.minimum(np.maximum(qpos, self.lower), self.upper))


def _bounded(vector: Array, largest: float) -> Array:
    """Clips like ``np.clip``, without its overhead of five times the work."""
    return np.asarray(np.minimum(np.maximum(vector, -largest), largest))


def joint_path(start: Array, end: Array, largest_step: float) -> Array:
    """Returns postures (K, 7) on a joint-space line without ``start``, at most ``largest_step`` apart [rad]."""
    steps = max(1, int(np.ceil(np.abs(end - start).max() / largest_step)))
    return start + np.linspace(0.0, 1.0, steps + 1)[1:, None] * (end - start)


def pose_error(actual: Array, goal: Array) -> Array:
    """Returns the twist (6,) in the actual tool frame that leads to the goal: metres, then radians."""
    rotation = actual[:3, :3].T
    turn = rotation_vector_from_matrix(rotation @ goal[:3, :3])
    return np.concatenate([rotation @ (goal[:3, 3] - actual[:3, 3]), turn])
