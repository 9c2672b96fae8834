"""Rotations and rigid transforms in numpy. Quaternions are wxyz; rotation 6D is the first two rows, flattened."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

HALF_TURN = 1e-4
"""Sine of an angle near pi below which the axis needs another formula."""
SMALL_ANGLE = 1e-5
"""Angle [rad] below which sin(x) / x is 1 and (1 - cos(x)) / x^2 is 1/2 in double precision."""


def rotation_6d_from_matrix(matrix: ArrayLike) -> Array:
    """Returns the first two rows of rotation matrices, flattened. (..., 3, 3) -> (..., 6)."""
    array = np.asarray(matrix, dtype=np.float64)
    return np.asarray(array[..., :2, :].reshape(*array.shape[:-2], 6))


def matrix_from_rotation_6d(rotation_6d: ArrayLike) -> Array:
    """Returns the nearest rotation by Gram-Schmidt. (..., 6) -> (..., 3, 3); any six finite numbers are accepted.

    Zero or parallel rows do not define a rotation; a fixed perpendicular axis replaces the unusable row.
    """
    array = np.asarray(rotation_6d, dtype=np.float64)
    first, second = _scaled(array[..., :3]), _scaled(array[..., 3:])
    x = _normalised(first, fallback=np.array([1.0, 0.0, 0.0]))
    y = second - np.sum(x * second, axis=-1, keepdims=True) * x
    helper = np.where(np.abs(x[..., :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    y = _normalised(y, fallback=_normalised(np.cross(x, helper), fallback=np.array([0.0, 1.0, 0.0])))
    return np.stack([x, y, np.cross(x, y)], axis=-2)


def _scaled(vector: Array) -> Array:
    """Scales rows to a length near 1 by a power of two, without rounding.

    Squares of huge numbers would overflow. The projection of a huge parallel row leaves only rounding error, which must
    not be used as a direction.
    """
    _, exponent = np.frexp(np.max(np.abs(vector), axis=-1, keepdims=True))
    return np.asarray(np.ldexp(vector, -exponent))


def _normalised(vector: Array, fallback: Array) -> Array:
    norm = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(np.where(norm > 1e-8, vector / np.maximum(norm, 1e-8), fallback))


def matrix_from_quaternion(quaternion_wxyz: ArrayLike) -> Array:
    """Converts quaternions (..., 4) wxyz -> (..., 3, 3)."""
    return np.asarray(Rotation.from_quat(np.asarray(quaternion_wxyz, dtype=np.float64), scalar_first=True).as_matrix())


def quaternion_from_matrix(matrix: ArrayLike) -> Array:
    """Converts one rotation (3, 3) -> (4,) wxyz with w >= 0; scipy takes 0.2 ms, and an object has dozens of poses."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(matrix, dtype=np.float64).tolist()
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)  # four times those of w, x, y, z
    largest = squares.index(max(squares))
    rows = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )
    quaternion = np.array(rows[largest])
    return np.asarray(quaternion / math.copysign(math.sqrt(quaternion @ quaternion), quaternion[0]))


def transform(position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> Array:
    """Returns a (4, 4) rigid transform from a position [m] and a (3, 3) rotation (identity if None)."""
    result = np.eye(4)
    result[:3, 3] = position
    if rotation is not None:
        result[:3, :3] = rotation
    return result


def rotation_vector_from_matrix(matrix: Array) -> Array:
    """Returns the rotation vector (3,) [rad] of one rotation (3, 3).

    Faster than scipy, which takes 0.3 ms to check and orthonormalise its input. Inverse kinematics calls this thousands
    of times per simulated second. The input must be a rotation.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    x, y, z = (h - f) / 2, (c - g) / 2, (d - b) / 2
    sine, cosine = math.sqrt(x * x + y * y + z * z), (a + e + i - 1) / 2
    if sine < HALF_TURN and cosine < 0:  # near half a turn the antisymmetric part vanishes
        return np.asarray(Rotation.from_matrix(matrix).as_rotvec())
    scale = math.atan2(sine, cosine) / sine if sine > 0 else 1.0
    return np.array((scale * x, scale * y, scale * z))


def matrix_from_rotation_vector(vector: Array) -> Array:
    """Returns the rotation (3, 3) of one rotation vector (3,) [rad], by Rodrigues' formula."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    # Series where the quotients are 0/0; exact to the last bit there.
    s = math.sin(angle) / angle if angle > SMALL_ANGLE else 1.0
    c = (1 - math.cos(angle)) / (angle * angle) if angle > SMALL_ANGLE else 0.5
    return np.array(
        (
            (1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y),
            (c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x),
            (c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)),
        )
    )


def rotation_about(axis: ArrayLike, angle: float) -> Array:
    """Returns the (3, 3) rotation by ``angle`` [rad] about ``axis`` (any length)."""
    direction = np.asarray(axis, dtype=np.float64)
    return matrix_from_rotation_vector(direction / np.linalg.norm(direction) * angle)


def rotation_with_x_along(axis: ArrayLike) -> Array:
    """Returns a (3, 3) rotation whose x axis points along ``axis`` (any length)."""
    vector = np.asarray(axis, dtype=np.float64)
    x = vector / np.linalg.norm(vector)
    helper = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    y = np.cross(helper, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def rotated_about_line(pose: Array, point: ArrayLike, axis: ArrayLike, angle: float) -> Array:
    """Returns ``pose`` (4, 4) turned by ``angle`` [rad] about the line through ``point`` [m] along ``axis``."""
    rotation = rotation_about(axis, angle)
    pivot = np.asarray(point, dtype=np.float64)
    return transform(rotation @ (pose[:3, 3] - pivot) + pivot, rotation @ pose[:3, :3])


def angle_between(first: ArrayLike, second: ArrayLike) -> float:
    """Returns the angle [rad] of the rotation that takes one (3, 3) rotation to the other."""
    relative = np.asarray(first).T @ np.asarray(second)
    return float(np.arccos(np.clip((np.trace(relative) - 1.0) / 2.0, -1.0, 1.0)))


def straight_path(start: Array, goal: Array, fractions: Array) -> Array:
    """Returns the (K, 4, 4) poses at ``fractions`` (K,) in [0, 1]: straight line for position, slerp for rotation."""
    turn = rotation_vector_from_matrix(start[:3, :3].T @ goal[:3, :3])
    angle = float(np.linalg.norm(turn))
    x, y, z = (turn / (angle or 1.0)).tolist()
    cross = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    turned = angle * fractions[:, None, None]
    path = np.zeros((len(fractions), 4, 4))
    # Rodrigues' formula.
    path[:, :3, :3] = start[:3, :3] @ (np.eye(3) + np.sin(turned) * cross + (1.0 - np.cos(turned)) * (cross @ cross))
    path[:, :3, 3] = start[:3, 3] + fractions[:, None] * (goal[:3, 3] - start[:3, 3])
    path[:, 3, 3] = 1.0
    return path


def quintic_duration(way: float, speed: float, acceleration: float) -> float:
    """Returns the least time [s] of a quintic over a way [m or rad] with these peaks, 15/8 d/T and 10/sqrt(3) d/T^2."""
    return max(1.875 * way / speed, math.sqrt(10 / math.sqrt(3) * way / acceleration))


def pose_vector(tcp_in_base: Array, gripper: float) -> NDArray[np.float32]:
    """Returns the (10,) pose of the contract: position [m], rotation 6D, gripper [0 closed, 1 open]."""
    rotation_6d = rotation_6d_from_matrix(tcp_in_base[:3, :3])
    return np.concatenate([tcp_in_base[:3, 3], rotation_6d, [gripper]]).astype(np.float32)


def pose_from_vector(vector: ArrayLike) -> tuple[Array, float]:
    """Returns ((4, 4) TCP pose, gripper opening) of a (10,) pose vector; the rotation is orthonormalised."""
    array = np.asarray(vector, dtype=np.float64)
    return transform(array[:3], matrix_from_rotation_6d(array[3:9])), float(array[9])
