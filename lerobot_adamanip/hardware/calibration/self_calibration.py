"""Calibrates a camera on the robot's own hand, which every cloud shows, and whose shape and pose are known.

The error of a resting camera is rigid, and the hand moves: points on the hand are registered to its surface over
several key frames at once. A coarse search over shifts finds the start of an iterative closest point (ICP) fit,
point to plane (Chen & Medioni 1992), with a prior: what few points do not determine stays as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Cloud
from lerobot_adamanip.contract.rotations import (
    Array,
    angle_between,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    transform,
)
from lerobot_adamanip.hardware.calibration.hand_shape import HandShape

REACH_M = 0.045
"""Distance around the hand within which its points are looked for: errors up to 30 mm and 3 degrees [m]."""
MIN_POINTS, NEAR_POINTS, FIT_POINTS = 60, 2000, 900
"""Fewest points around a visible hand, most of them that are kept of a key frame, and most in a fit of all."""
MAX_FRAMES = 10
"""Number of key frames in a fit, the latest ones."""
SAME_POSE_M, SAME_POSE_RAD = 0.015, 0.1
"""A hand that has moved less replaces its key frame."""
COARSE_FRAMES, COARSE_STEP_M, COARSE_STEPS = 3, 0.008, 4
"""The coarse search is repeated for the first key frames, over a cube of shifts of so many steps to each side."""
COARSE_SAMPLES, COARSE_CAP_M = 150, 0.016
"""Points of the hand's surface in the coarse search, and the distance beyond which a point is missing [m]."""
GATES_M, TRACKING = (0.018, 0.013, 0.010, 0.008, 0.007, 0.007), 3
"""Largest distance of a point to its surface in each iteration [m]; after the coarse search, the last few suffice."""
MIN_NOISE_M, SHARED_NOISE, HUBER_M = 0.002, 2.0, 0.002
"""Smallest standard deviation of a point [m]; factor for what the errors of neighbours have in common; error beyond
which a point counts less [m]."""
PRIOR_M, PRIOR_RAD = 0.020, 0.035
"""Expected error of a camera in the middle of the workspace [m, rad]."""
COVERED_M, MIN_COVERED = 0.008, 0.4
"""A hand is seen if points lie this near [m] to this share of its visible surface."""
WARN_M = 0.005
"""Distance by which a camera must have moved for a warning [m]."""
CENTER = np.add(DEFAULT_WORKSPACE.lower, DEFAULT_WORKSPACE.upper) / 2
"""Middle of the workspace (3,), base frame [m], which the prior's rotations leave in place."""


@dataclass
class _Frame:
    """One view of the hand: points near it (K, 3) in random order, and its visible surface (M, 3), base frame [m]."""

    tcp_in_base: Array
    points: Array
    surface: Array
    normals: Array

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the surface."""
        return cKDTree(self.surface)

    @cached_property
    def shift_costs(self) -> Array:
        """Mean distance of the surface to the points, up to a cap, for each shift of `_SHIFTS` (S,) [m]."""
        lower = self.surface.min(0) - REACH_M
        size = np.ceil((self.surface.max(0) + REACH_M - lower) / COARSE_STEP_M).astype(int) + 1
        cells = np.round((self.points - lower) / COARSE_STEP_M).astype(int)
        cells = cells[((cells >= 0) & (cells < size)).all(1)]
        free = np.ones(size, bool)
        free[tuple(cells.T)] = False
        distance = np.minimum(COARSE_STEP_M * distance_transform_edt(free), COARSE_CAP_M).astype(np.float32)
        chosen = self.surface[:: max(1, len(self.surface) // COARSE_SAMPLES)]
        places = np.round((chosen - lower) / COARSE_STEP_M).astype(int) - _SHIFTS[:, None]
        places = np.clip(places, 0, size - 1)
        costs: Array = distance[places[..., 0], places[..., 1], places[..., 2]].mean(1)
        return costs

    def covered(self, correction: Array) -> float:
        """Returns the share of the visible surface with a corrected point near it."""
        reached = cKDTree(moved(self.points, correction)).query(self.surface[::4], distance_upper_bound=COVERED_M)[0]
        return float(np.isfinite(reached).mean())


_STEPS = np.arange(-COARSE_STEPS, COARSE_STEPS + 1)
_SHIFTS = np.stack(np.meshgrid(_STEPS, _STEPS, _STEPS, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass
class SelfCalibration:
    """Estimate of one resting camera's error; call `update` at each key frame, or step, with the arm at rest.

    Attributes:
        shape: surface of the hand.
        eye: position (3,) of the camera as calibrated, base frame [m].
        correction: (4, 4) motion of clouds, base frame; the identity until a hand was seen.
        uncertainty_m: standard deviation of corrected points at `CENTER` [m]; infinity until a hand was seen.
    """

    shape: HandShape
    eye: Array
    correction: Array = field(default_factory=lambda: np.eye(4), init=False)
    uncertainty_m: float = field(default=np.inf, init=False)
    _frames: list[_Frame] = field(default_factory=list, init=False)

    @property
    def frames(self) -> int:
        """Number of key frames in the estimate."""
        return len(self._frames)

    @property
    def moved_by_m(self) -> float:
        """Distance by which the correction moves the middle of the workspace [m]."""
        return float(np.linalg.norm(moved(CENTER[None], self.correction)[0] - CENTER))

    def update(self, points: Cloud, tcp_in_base: Array, gripper: float) -> bool:
        """Improves the estimate by one cloud; returns whether it shows the hand. Otherwise nothing changes.

        Args:
            points: (N, 3) uncorrected points, base frame [m]: all that the camera sees, or a cropped and thinned cloud.
            tcp_in_base: (4, 4) tool pose at the exposure.
            gripper: opening of the gripper [0 closed, 1 open].
        """
        frame = self._frame(np.asarray(points, np.float64), tcp_in_base, gripper)
        return frame is not None and (
            self._accept([*(f for f in self._frames if not _same_pose(f, frame)), frame][-MAX_FRAMES:])
            or (self.frames > 0 and self._accept([frame]))  # the camera has moved: what was seen before is wrong
        )

    def corrected(self, points: Cloud) -> Cloud:
        """Returns points (N, 3) as a calibrated camera would report them."""
        return moved(points, self.correction).astype(np.float32) if self.frames else points

    def _frame(self, points: Array, tcp_in_base: Array, gripper: float) -> _Frame | None:
        """Returns the view of the hand in a cloud; None if too few points are near it."""
        rotation, position = tcp_in_base[:3, :3], tcp_in_base[:3, 3]
        surface, normals = self.shape.at(gripper)
        in_tool = (points - position) @ rotation
        near = ((in_tool > surface.min(0) - REACH_M) & (in_tool < surface.max(0) + REACH_M)).all(1)
        places = np.flatnonzero(near)
        if len(places) < MIN_POINTS:
            return None
        places = np.random.default_rng(0).permutation(places)[:NEAR_POINTS]
        surface, normals = surface @ rotation.T + position, normals @ rotation.T
        facing = ((self.eye - surface) * normals).sum(1) > 0
        return _Frame(tcp_in_base, points[places], surface[facing], normals[facing])

    def _accept(self, frames: list[_Frame]) -> bool:
        """Fits all frames, and keeps them with their estimate if the last one shows the hand."""
        starts = [self.correction] if len(frames) > 1 else []
        if len(frames) <= COARSE_FRAMES:
            costs = np.sum([frame.shift_costs for frame in frames], axis=0)
            starts.append(transform(COARSE_STEP_M * _SHIFTS[int(np.argmin(costs))]))
        gates = GATES_M if len(frames) <= COARSE_FRAMES else GATES_M[-TRACKING:]
        fits = [self._fit(frames, start, gates) for start in starts]
        correction, information, _ = max(fits, key=lambda fit: fit[2])
        if frames[-1].covered(correction) < MIN_COVERED:
            return False
        self._frames, self.correction = frames, correction
        spread = float(np.trace(np.linalg.inv(information)[:3, :3]))
        self.uncertainty_m = float(np.sqrt(spread + self.shape.accuracy_m**2))
        return True

    def _fit(self, frames: Sequence[_Frame], correction: Array, gates: Sequence[float]) -> tuple[Array, Array, int]:
        """Returns correction (4, 4), its information (6, 6), and the number of points on the hand."""
        prior = np.diag([PRIOR_M**-2.0] * 3 + [PRIOR_RAD**-2.0] * 3)
        each = FIT_POINTS // len(frames)
        for gate in gates:
            rows = [_rows(frame, moved(frame.points[:each], correction), gate) for frame in frames]
            errors, arms, normals = (np.concatenate(column) for column in zip(*rows, strict=True))
            slopes = np.concatenate([normals, np.cross(arms - CENTER, normals)], axis=1)
            noise = max(MIN_NOISE_M, SHARED_NOISE * 1.48 * float(np.median(np.abs(errors)))) if len(errors) else 1.0
            weights = 1.0 / (noise**2 * np.maximum(1.0, np.abs(errors) / HUBER_M))
            so_far = np.concatenate(
                [
                    moved(CENTER[None], correction)[0] - CENTER,
                    rotation_vector_from_matrix(correction[:3, :3]),
                ]
            )
            information = (slopes * weights[:, None]).T @ slopes + prior
            step = np.linalg.solve(information, -(slopes.T @ (weights * errors)) - prior @ so_far)
            turn = matrix_from_rotation_vector(step[3:])
            correction = transform(CENTER + step[:3] - turn @ CENTER, turn) @ correction
        return correction, information, len(errors)


def moved(points: NDArray[np.floating], motion: Array) -> Array:
    """Returns points (N, 3) after a motion (4, 4)."""
    return np.asarray(points @ motion[:3, :3].T + motion[:3, 3], np.float64)


def _rows(frame: _Frame, points: Array, gate: float) -> tuple[Array, Array, Array]:
    """Returns distances (K,) of points to their surface, the points (K, 3) and its normals (K, 3), within a gate."""
    distance, place = frame.tree.query(points, distance_upper_bound=gate)
    found = np.isfinite(distance)
    points, place = points[found], place[found]
    normals = frame.normals[place]
    return ((points - frame.surface[place]) * normals).sum(1), points, normals


def _same_pose(one: _Frame, other: _Frame) -> bool:
    distance = np.linalg.norm(one.tcp_in_base[:3, 3] - other.tcp_in_base[:3, 3])
    return (
        bool(distance < SAME_POSE_M)
        and angle_between(one.tcp_in_base[:3, :3], other.tcp_in_base[:3, :3]) < SAME_POSE_RAD
    )
