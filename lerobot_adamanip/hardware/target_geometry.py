"""Targets of the safety filter: sent as float32, computed as float64. Fast for single targets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import (
    Array,
    matrix_from_rotation_vector,
    pose_vector,
    rotation_vector_from_matrix,
    transform,
)
from lerobot_adamanip.contract.schema import ACTION_DIM, GRIPPER_DIM, POSITION_DIMS, ROTATION_DIMS

Target = NDArray[np.float32]

ROUGH = 0.2
"""Maximum correctable error of a rotation's rows. Policies have about 0.01, noise about 1."""
EXACT = 2e-6
"""Error of a rotation's rows below which it is not corrected: float32 precision."""


@dataclass(frozen=True)
class TargetPose:
    """A valid target with its pose in float64.

    Attributes:
        target: (10,) float32 target.
        position: (3,) position [m].
        rotation: (3, 3) rotation matrix.
    """

    target: Target
    position: Array
    rotation: Array

    @classmethod
    def of(cls, target: Target) -> TargetPose:
        """Returns a valid target (10,) with its pose. Orthonormalises its rotation (Gram-Schmidt)."""
        values = target.tolist()
        a, b, c, d, e, f = values[3:9]
        size = math.sqrt(a * a + b * b + c * c)
        a, b, c = a / size, b / size, c / size
        along = a * d + b * e + c * f
        d, e, f = d - along * a, e - along * b, f - along * c
        size = math.sqrt(d * d + e * e + f * f)
        d, e, f = d / size, e / size, f / size
        rotation = np.array(((a, b, c), (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d)))
        return cls(target, np.array(values[:3]), rotation)

    @classmethod
    def at(cls, tcp_in_base: Array, gripper: float) -> TargetPose:
        """Returns a pose (4, 4), rounded to float32 like every target."""
        return cls.of(pose_vector(tcp_in_base, gripper))

    @property
    def gripper(self) -> float:
        """Opening, 0 closed ... 1 open."""
        return float(self.target[GRIPPER_DIM])

    def distance(self, other: TargetPose) -> float:
        """Returns the distance to another target [m]."""
        return math.dist(self.position.tolist(), other.position.tolist())

    def angle(self, other: TargetPose) -> float:
        """Returns the angle to another rotation [rad]; exact for small angles, 0 for equal rotations."""
        chord = (self.rotation - other.rotation).ravel()
        return 2.0 * math.asin(min(1.0, math.sqrt(float(chord @ chord) / 8.0)))

    def turn_to(self, goal: TargetPose) -> tuple[Array, float]:
        """Returns the rotation vector (3,) [rad] to a goal, in the own frame, and its length."""
        vector = rotation_vector_from_matrix(self.rotation.T @ goal.rotation)
        return vector, math.sqrt(float(vector @ vector))

    def turned_by(self, vector: Array) -> TargetPose:
        """Returns the target turned by a rotation vector (3,) [rad] in its own frame."""
        rotation = self.rotation @ matrix_from_rotation_vector(vector)
        return TargetPose.at(transform(self.position, rotation), self.gripper)

    def moved_to(self, position: Array, gripper: float) -> TargetPose:
        """Returns the target at another position [m] and opening. Its rotation stays bit-identical."""
        target = self.target.copy()
        target[POSITION_DIMS], target[GRIPPER_DIM] = position, gripper
        return TargetPose(target, target[POSITION_DIMS].astype(np.float64), self.rotation)

    def towards(self, goal: TargetPose, share: float) -> TargetPose:
        """Returns the target at the fraction ``share`` of the path to a goal, with the goal's gripper."""
        position = self.position + share * (goal.position - self.position)
        same = (self.target[ROTATION_DIMS] == goal.target[ROTATION_DIMS]).all()
        turned = self if same else self.turned_by(share * self.turn_to(goal)[0])
        return turned.moved_to(position, goal.gripper)

    def into_box(self, lower: Array, upper: Array) -> TargetPose:
        """Returns the target with its position moved into a box and rounded inwards."""
        position = np.clip(self.position, lower, upper)
        if (position == self.position).all():
            return self
        rounded = position.astype(np.float32)
        rounded = np.where(rounded < lower, np.nextafter(rounded, np.float32(np.inf)), rounded)
        rounded = np.where(rounded > upper, np.nextafter(rounded, np.float32(-np.inf)), rounded)
        return self.moved_to(rounded.astype(np.float64), self.gripper)


def canonical(target: NDArray[np.generic]) -> Target | None:
    """Returns a target as float32 with an orthonormal rotation and a gripper in [0, 1]; None if it is malformed.

    A canonical target stays the same, bit for bit.
    """
    try:
        with np.errstate(over="ignore"):
            result = np.array(target, dtype=np.float32)
    except (TypeError, ValueError):
        return None
    if result.shape != (ACTION_DIM,) or not np.isfinite(result).all():
        return None
    a, b, c, d, e, f = (float(value) for value in result[ROTATION_DIMS])
    error = max(abs(a * a + b * b + c * c - 1), abs(d * d + e * e + f * f - 1), abs(a * d + b * e + c * f))
    if error > ROUGH:
        return None
    if error > EXACT:
        result[ROTATION_DIMS] = TargetPose.of(result).rotation[:2].ravel()
    result[GRIPPER_DIM] = min(max(float(result[GRIPPER_DIM]), 0.0), 1.0)
    return result


def pose_error(tcp_in_base: Array, goal_in_base: Array) -> tuple[float, float]:
    """Returns the distance between two (4, 4) poses [m, rad]."""
    turn = rotation_vector_from_matrix(tcp_in_base[:3, :3].T @ goal_in_base[:3, :3])
    return math.dist(tcp_in_base[:3, 3], goal_in_base[:3, 3]), math.sqrt(float(turn @ turn))
