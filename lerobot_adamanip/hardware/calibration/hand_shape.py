"""Surface of the robot's hand in the tool's frame, for calibration on the robot itself."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import Array

FINGER_TRAVEL_M = 0.04
"""Travel of each finger from closed to open [m]."""
SPACING_M = 0.005
"""Distance of neighbouring surface points [m]."""


@dataclass(frozen=True)
class HandShape:
    """Points on the surface of a hand and of what is rigid with it, tool frame: z to the fingertips.

    Attributes:
        points: (N, 3) with closed fingers [m].
        normals: (N, 3), outward.
        fingers: (N,) direction of motion along y of a finger's points, 1 or -1; 0 for the rest.
        accuracy_m: error of a calibration on it that more points do not reduce [m].
    """

    points: Array
    normals: Array
    fingers: Array
    accuracy_m: float = 0.0005

    def at(self, gripper: float) -> tuple[Array, Array]:
        """Returns points (N, 3) [m] and normals (N, 3) at an opening of the gripper [0 closed, 1 open]."""
        points = self.points.copy()
        points[:, 1] += FINGER_TRAVEL_M * float(np.clip(gripper, 0.0, 1.0)) * self.fingers
        return points, self.normals


@dataclass(frozen=True)
class _Part:
    """A box between two corners, tool frame [m], or with ``is_round`` the elliptic cylinder along z inside it.

    ``finger`` is its direction of motion along y.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    finger: float = 0.0
    is_round: bool = False

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Returns which points (N, 3) are inside, (N,)."""
        middle, half = self._middle, self._half - 1e-6
        offset = np.abs(points - middle) / half
        across = np.hypot(offset[:, 0], offset[:, 1]) if self.is_round else offset[:, :2].max(1)
        return np.asarray((across < 1) & (offset[:, 2] < 1))

    def surface(self) -> tuple[Array, Array]:
        """Returns points (N, 3) and outward normals (N, 3)."""
        ends = [self._side(axis, sign) for axis in range(3) for sign in (-1.0, 1.0) if axis == 2 or not self.is_round]
        points, normals = (np.concatenate(column) for column in zip(*ends, strict=True))
        if not self.is_round:
            return points, normals
        flat = np.linalg.norm((points - self._middle)[:, :2] / self._half[:2], axis=1) < 1
        heights = np.arange(self.lower[2] + SPACING_M / 2, self.upper[2], SPACING_M)
        angles = np.arange(0.0, 2 * np.pi, SPACING_M / self._half[0])
        angle, height = (grid.ravel() for grid in np.meshgrid(angles, heights))
        out = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
        wall = self._middle + self._half * out
        wall[:, 2] = height
        return np.concatenate([points[flat], wall]), np.concatenate([normals[flat], out])

    def _side(self, axis: int, sign: float) -> tuple[Array, Array]:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        sides = [np.arange(lower[k] + SPACING_M / 2, upper[k], SPACING_M) for k in range(3) if k != axis]
        grid = np.stack([part.ravel() for part in np.meshgrid(*sides)], axis=1)
        points = np.insert(grid, axis, (lower if sign < 0 else upper)[axis], axis=1)
        return points, np.tile(sign * np.eye(3)[axis], (len(points), 1))

    @property
    def _middle(self) -> Array:
        return np.add(self.lower, self.upper, dtype=np.float64) / 2

    @property
    def _half(self) -> Array:
        return np.subtract(self.upper, self.lower, dtype=np.float64) / 2


_LAST_LINK = (
    # The joint, and the part beside it.
    _Part((-0.0444, -0.0444, -0.1584), (0.0444, 0.0444, -0.1125), is_round=True),
    _Part((-0.0330, 0.0000, -0.1413), (0.0330, 0.0863, -0.1110)),
)
_HAND = (
    # Flange, wedge and plug.
    _Part((-0.0314, -0.0314, -0.1130), (0.0314, 0.0314, -0.0972), is_round=True),
    _Part((-0.0269, -0.0218, -0.1115), (0.0269, 0.0878, -0.0981)),
    _Part((-0.0200, -0.1017, -0.1272), (0.0200, -0.0440, -0.1060)),
    # Body of the hand, which tapers to the fingers.
    _Part((-0.0180, -0.1019, -0.1068), (0.0180, 0.0941, -0.0840)),
    _Part((-0.0200, -0.0978, -0.0851), (0.0200, 0.0977, -0.0740)),
    _Part((-0.0181, -0.0998, -0.0750), (0.0181, 0.0998, -0.0430)),
    _Part((-0.0175, -0.1005, -0.0440), (0.0175, 0.1005, -0.0379)),
    # Fingers: the part that slides, and the tip.
    _Part((-0.0103, 0.0096, -0.0434), (0.0103, 0.0252, -0.0185), 1.0),
    _Part((-0.0103, -0.0252, -0.0434), (0.0103, -0.0096, -0.0185), -1.0),
    _Part((-0.0087, 0.0004, -0.0190), (0.0087, 0.0160, 0.0083), 1.0),
    _Part((-0.0087, -0.0160, -0.0190), (0.0087, -0.0004, 0.0083), -1.0),
)
"""Fitted to the outline of the Franka Hand with open fingers: half of its surface is nearer than 0.4 mm."""


_FRANKA_ACCURACY_M = 0.003
"""Measured with the simulated hand, whose edges are round: 2 to 4 mm in the middle of the workspace [m]."""


@functools.cache
def franka_hand(*, last_link: bool = True) -> HandShape:
    """Returns the Franka Hand as boxes and cylinders, with or without the arm's last link."""
    parts = (*_LAST_LINK, *_HAND) if last_link else _HAND
    surfaces = [part.surface() for part in parts]
    points, normals = (np.concatenate(column) for column in zip(*surfaces, strict=True))
    fingers = np.repeat([part.finger for part in parts], [len(surface[0]) for surface in surfaces])
    inside = np.any([part.contains(points) for part in parts], axis=0)
    return HandShape(points[~inside], normals[~inside], fingers[~inside], _FRANKA_ACCURACY_M)
