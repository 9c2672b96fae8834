"""The arm: inverse kinematics with joint limits, and what the joints feel. The base frame is the robot's root link."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from lerobot_adamanip.contract.rotations import rotation_vector_from_matrix

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
DAMPING = 1e-4
"""Of the least squares: what a step gives up where the arm is stretched."""
LARGEST_STEP = 0.2
"""Of one iteration, towards the goal [rad]."""


@dataclass(frozen=True)
class Pull:
    """How an iteration draws the spare freedom towards rest.

    Attributes:
        share: of the way there.
        largest: of one iteration [rad].
        steps: iterations that do so. One for each step of a path keeps the motion smooth.
        settled: a pull smaller than this has found the posture nearest to rest, and was the last [rad].
    """

    share: float = 0.1
    largest: float = 0.02
    steps: int = 1
    settled: float = 0.0


ALONG = Pull()
"""In a motion."""
CANONICAL = Pull(share=0.5, largest=0.2, steps=60, settled=1e-3)
"""For the posture of a pose, wherever the arm is."""


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
        self._qpos = np.zeros(articulation.dof)  # the fingers stay at 0: they do not move the tool

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
        """Returns the posture for ``goal`` (4, 4) that is nearest to rest, wherever the arm is now."""
        return self.solve(goal, self.rest, iterations=120, pull=CANONICAL)

    def solve(
        self, goal: Array, start: Array, *, iterations: int = 40, pull: Pull = ALONG, tolerance: float = 1e-4
    ) -> IKResult:
        """Returns joint positions that bring the tool to ``goal`` (4, 4), from ``start`` (7,), never past a limit.

        A warm start needs two or three iterations. ``tolerance`` is the error [m, rad] at which to stop.
        """
        qpos, pulls = self._inside(start), pull.steps
        for _ in range(iterations):
            error = pose_error(self.tcp_in_base(qpos), goal)
            if not pulls and max(map(abs, error.tolist())) < tolerance:
                break
            step, pulled = self._step(qpos, error, pull if pulls else None)
            pulls = max(0, pulls - 1) if pulled >= pull.settled else 0
            qpos = self._inside(qpos + step)
        else:
            error = pose_error(self.tcp_in_base(qpos), goal)
        position, rotation = error[:3].tolist(), error[3:].tolist()
        return IKResult(qpos, math.hypot(*position), math.hypot(*rotation))

    def _step(self, qpos: Array, error: Array, pull: Pull | None) -> tuple[Array, float]:
        """Returns the damped step (7,) that takes the tool by a twist (6,), and how far it was pulled in it [rad].

        A control tick takes a few of these, and a reset hundreds: each call of NumPy counts.
        """
        jacobian = self.body_jacobian(qpos)
        square = jacobian @ jacobian.T
        square.flat[::7] += DAMPING
        if pull is None:
            return _bounded(jacobian.T @ dposv(square, error)[1], LARGEST_STEP), 0.0
        spare = pull.share * (self.rest - qpos)
        wanted = np.empty((6, 2), order="F")
        wanted[:, 0], wanted[:, 1] = error, jacobian @ spare
        step, taken = (jacobian.T @ dposv(square, wanted)[1]).T
        pulled = _bounded(spare - taken, pull.largest)
        return _bounded(step, LARGEST_STEP) + pulled, max(map(abs, pulled.tolist()))

    def _inside(self, qpos: Array) -> Array:
        return np.asarray(np.minimum(np.maximum(qpos, self.lower), self.upper))


def _bounded(vector: Array, largest: float) -> Array:
    """``np.clip`` without its overhead, which is five times the work."""
    return np.asarray(np.minimum(np.maximum(vector, -largest), largest))


def joint_path(start: Array, end: Array, largest_step: float) -> Array:
    """Returns postures (K, 7) on a straight line in joint space, without ``start``, at most so far apart [rad]."""
    steps = max(1, int(np.ceil(np.abs(end - start).max() / largest_step)))
    return start + np.linspace(0.0, 1.0, steps + 1)[1:, None] * (end - start)


def pose_error(actual: Array, goal: Array) -> Array:
    """Returns the (6,) twist in the actual tool frame that leads to the goal: metres, then radians."""
    rotation = actual[:3, :3].T
    turn = rotation_vector_from_matrix(rotation @ goal[:3, :3])
    return np.concatenate([rotation @ (goal[:3, 3] - actual[:3, 3]), turn])
