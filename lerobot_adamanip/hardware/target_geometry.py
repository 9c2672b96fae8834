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
"""Error of a rotation's rows that is not corrected, due to float32 precision."""


@dataclass(frozen=True)
class Placed:
    """A target with its pose in float64.

    Attributes:
        target: (10,) float32 target.
        position: (3,) position [m].
        rotation: (3, 3) rotation matrix.
    """

    target: Target
    position: Array
    rotation: Array


def placed(target: Target) -> Placed:
    """Returns a valid target with its pose."""
    values = target.tolist()
    return Placed(target, np.array(values[:3]), _rotation(values[3:9]))


def placed_at(tcp_in_base: Array, gripper: float) -> Placed:
    """Returns a pose (4, 4), rounded to float32 like every target."""
    return placed(pose_vector(tcp_in_base, gripper))


def _rotation(rows: list[float]) -> Array:
    """Orthonormalises two nearly orthonormal rows (Gram-Schmidt)."""
    a, b, c, d, e, f = rows
    size = math.sqrt(a * a + b * b + c * c)
    a, b, c = a / size, b / size, c / size
    along = a * d + b * e + c * f
    d, e, f = d - along * a, e - along * b, f - along * c
    size = math.sqrt(d * d + e * e + f * f)
    d, e, f = d / size, e / size, f / size
    return np.array(((a, b, c), (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d)))


def canonical(target: NDArray[np.generic]) -> Target | None:
    """Returns a target as float32 with an orthonormal rotation and a gripper in [0, 1]; None if it is malformed.

    A canonical target stays the same, bit for bit.
    """
    try:
        with np.errstate(over="ignore"):
            wanted = np.array(target, dtype=np.float32)
    except (TypeError, ValueError):
        return None
    if wanted.shape != (ACTION_DIM,) or not np.isfinite(wanted).all():
        return None
    a, b, c, d, e, f = (float(value) for value in wanted[ROTATION_DIMS])
    error = max(abs(a * a + b * b + c * c - 1), abs(d * d + e * e + f * f - 1), abs(a * d + b * e + c * f))
    if error > ROUGH:
        return None
    if error > EXACT:
        wanted[ROTATION_DIMS] = placed(wanted).rotation[:2].ravel()
    wanted[GRIPPER_DIM] = min(max(float(wanted[GRIPPER_DIM]), 0.0), 1.0)
    return wanted


def distance(first: Placed, second: Placed) -> float:
    """Returns the distance between two targets [m]."""
    return math.dist(first.position.tolist(), second.position.tolist())


def angle(first: Placed, second: Placed) -> float:
    """Returns the angle between two targets' rotations [rad]; exact for small angles, 0 for equal rotations."""
    chord = (first.rotation - second.rotation).ravel()
    return 2.0 * math.asin(min(1.0, math.sqrt(float(chord @ chord) / 8.0)))


def turn_vector(start: Placed, goal: Placed) -> tuple[Array, float]:
    """Returns the rotation vector (3,) [rad] from start to goal, in the start's frame, and its length."""
    vector = rotation_vector_from_matrix(start.rotation.T @ goal.rotation)
    return vector, math.sqrt(float(vector @ vector))


def turned_by(start: Placed, vector: Array) -> Placed:
    """Returns the target turned by a rotation vector (3,) [rad] in its own frame."""
    rotation = start.rotation @ matrix_from_rotation_vector(vector)
    return placed_at(transform(start.position, rotation), float(start.target[GRIPPER_DIM]))


def moved_to(start: Placed, position: Array, gripper: float) -> Placed:
    """Returns the target at another position [m] and opening. Its rotation stays bit-identical."""
    target = start.target.copy()
    target[POSITION_DIMS], target[GRIPPER_DIM] = position, gripper
    return Placed(target, target[POSITION_DIMS].astype(np.float64), start.rotation)


def between(start: Placed, goal: Placed, share: float) -> Placed:
    """Returns the target at the fraction ``share`` of the path, with the gripper of ``goal``."""
    position = start.position + share * (goal.position - start.position)
    same = (start.target[ROTATION_DIMS] == goal.target[ROTATION_DIMS]).all()
    turned = start if same else turned_by(start, share * turn_vector(start, goal)[0])
    return moved_to(turned, position, float(goal.target[GRIPPER_DIM]))
