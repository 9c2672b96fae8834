"""Rotations: round trips, the contract's 6D rows, and a Gram-Schmidt that no six numbers can break."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract import rotations

fast = settings(max_examples=60, deadline=None)
coordinates = arrays(np.float64, 3, elements=st.floats(-2, 2))
angles = st.floats(-3.1, 3.1)
finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def directions(draw: st.DrawFn) -> np.ndarray:
    vector = draw(arrays(np.float64, 3, elements=st.floats(-1, 1)))
    assume(np.linalg.norm(vector) > 1e-2)
    return vector / np.linalg.norm(vector)


@st.composite
def matrices(draw: st.DrawFn) -> np.ndarray:
    return rotations.rotation_about(draw(directions()), draw(angles))


poses = st.builds(rotations.transform, coordinates, matrices())


def assert_rotation(matrix: np.ndarray, tolerance: float = 1e-7) -> None:
    assert np.isfinite(matrix).all()
    np.testing.assert_allclose(
        matrix @ np.swapaxes(matrix, -1, -2), np.broadcast_to(np.eye(3), matrix.shape), atol=1e-7
    )
    np.testing.assert_allclose(np.linalg.det(matrix), 1.0, atol=tolerance)


def distance_to_line(point: np.ndarray, on_line: np.ndarray, axis: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(point - on_line, axis)))


@fast
@given(matrices())
def test_rotation_6d_is_the_first_two_rows_and_names_one_rotation(matrix: np.ndarray) -> None:
    vector = rotations.rotation_6d_from_matrix(matrix)
    assert np.array_equal(vector, np.concatenate([matrix[0], matrix[1]]))
    np.testing.assert_allclose(rotations.matrix_from_rotation_6d(vector), matrix, atol=1e-12)


@fast
@given(matrices(), st.floats(0.1, 10), st.floats(0.1, 10), st.floats(-5, 5))
def test_rows_that_are_scaled_or_sheared_name_the_same_rotation(
    matrix: np.ndarray, first: float, second: float, shear: float
) -> None:
    rows = np.concatenate([first * matrix[0], second * matrix[1] + shear * matrix[0]])
    np.testing.assert_allclose(rotations.matrix_from_rotation_6d(rows), matrix, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(arrays(np.float64, 6, elements=finite))
@example(np.zeros(6))
@example(np.array([0.0, 0, 0, 1, 0, 0]))
@example(np.array([0.3, 0.4, 0.5, 0.3, 0.4, 0.5]))
@example(1e10 * np.array([1.0, 2, 3, -2, -4, -6]))
@example(np.array([1e300, 1e300, 0, 1e300, -1e300, 1e-300]))
@example(np.array([5e-324, 0, 0, 0, 5e-324, 0]))
def test_any_six_finite_numbers_give_a_rotation(vector: np.ndarray) -> None:
    assert_rotation(rotations.matrix_from_rotation_6d(vector))


@fast
@given(directions(), st.floats(-4, 4), st.floats(0.5, 2))
def test_parallel_rows_keep_the_direction_they_share(axis: np.ndarray, factor: float, length: float) -> None:
    matrix = rotations.matrix_from_rotation_6d(np.concatenate([length * axis, factor * axis]))
    np.testing.assert_allclose(matrix[0], axis, atol=1e-12)
    assert_rotation(matrix)


def test_batches_are_converted_row_by_row() -> None:
    vectors = np.random.default_rng(0).normal(size=(2, 5, 6))
    vectors[1, 2] = 0
    matrices = rotations.matrix_from_rotation_6d(vectors)
    assert matrices.shape == (2, 5, 3, 3)
    for index in np.ndindex(2, 5):
        assert np.array_equal(matrices[index], rotations.matrix_from_rotation_6d(vectors[index]))
    assert rotations.rotation_6d_from_matrix(matrices).shape == (2, 5, 6)


@fast
@given(matrices())
def test_quaternions_round_trip_real_part_first_and_not_negative(matrix: np.ndarray) -> None:
    quaternion = rotations.quaternion_from_matrix(matrix)
    assert quaternion[0] >= 0
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    np.testing.assert_allclose(rotations.matrix_from_quaternion(quaternion), matrix, atol=1e-9)
    np.testing.assert_allclose(rotations.matrix_from_quaternion(-quaternion), matrix, atol=1e-9)


def test_the_unit_quaternion_is_wxyz() -> None:
    np.testing.assert_allclose(rotations.matrix_from_quaternion([1, 0, 0, 0]), np.eye(3))
    about_x = rotations.quaternion_from_matrix(rotations.rotation_about((2.0, 0, 0), np.pi / 2))
    np.testing.assert_allclose(about_x, [np.sqrt(0.5), np.sqrt(0.5), 0, 0], atol=1e-12)


@fast
@given(poses, st.floats(0, 1))
def test_a_pose_survives_the_contract_s_vector(pose: np.ndarray, gripper: float) -> None:
    vector = rotations.pose_vector(pose, gripper)
    assert vector.dtype == np.float32
    back, opening = rotations.pose_from_vector(vector)
    np.testing.assert_allclose(back, pose, atol=1e-6)
    assert opening == pytest.approx(gripper, abs=1e-6)
    assert_rotation(back[:3, :3])
    # What was recorded is what is commanded on replay.
    np.testing.assert_allclose(rotations.pose_vector(back, opening), vector, atol=2e-7)


@fast
@given(directions(), angles)
def test_a_rotation_turns_by_its_angle_and_leaves_its_axis(axis: np.ndarray, angle: float) -> None:
    matrix = rotations.rotation_about(3 * axis, angle)
    assert_rotation(matrix)
    np.testing.assert_allclose(matrix @ axis, axis, atol=1e-9)
    assert rotations.angle_between(np.eye(3), matrix) == pytest.approx(abs(angle), abs=1e-6)
    np.testing.assert_allclose(matrix @ rotations.rotation_about(axis, -angle), np.eye(3), atol=1e-9)


@fast
@given(poses, coordinates, directions(), angles, angles)
def test_turning_about_a_line_keeps_the_distance_to_it(
    pose: np.ndarray, point: np.ndarray, axis: np.ndarray, angle: float, more: float
) -> None:
    turned = rotations.rotated_about_line(pose, point, axis, angle)
    assert distance_to_line(turned[:3, 3], point, axis) == pytest.approx(distance_to_line(pose[:3, 3], point, axis))
    assert axis @ turned[:3, 3] == pytest.approx(axis @ pose[:3, 3], abs=1e-9)
    assert rotations.angle_between(pose[:3, :3], turned[:3, :3]) == pytest.approx(abs(angle), abs=1e-6)
    twice = rotations.rotated_about_line(turned, point, axis, more)
    np.testing.assert_allclose(twice, rotations.rotated_about_line(pose, point, axis, angle + more), atol=1e-9)
    elsewhere = rotations.rotated_about_line(pose, point + 0.7 * axis, axis, angle)
    np.testing.assert_allclose(elsewhere, turned, atol=1e-9)


def test_turns_follow_the_right_hand() -> None:
    turned = rotations.rotated_about_line(rotations.transform((2.0, 0, 0)), (1.0, 0, 0), (0, 0, 1.0), np.pi / 2)
    np.testing.assert_allclose(turned[:3, 3], [1.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(turned[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)


@fast
@given(poses, poses, st.floats(0, 1))
def test_interpolation_starts_and_ends_where_it_should_and_is_straight(
    start: np.ndarray, goal: np.ndarray, fraction: float
) -> None:
    whole = rotations.angle_between(start[:3, :3], goal[:3, :3])
    assume(whole < np.pi - 1e-3)
    first, between, last = rotations.straight_path(start, goal, np.array([0.0, fraction, 1.0]))
    np.testing.assert_allclose(first, start, atol=1e-9)
    np.testing.assert_allclose(last, goal, atol=1e-9)
    assert_rotation(between[:3, :3])
    np.testing.assert_allclose(between[:3, 3], (1 - fraction) * start[:3, 3] + fraction * goal[:3, 3], atol=1e-9)
    assert rotations.angle_between(start[:3, :3], between[:3, :3]) == pytest.approx(fraction * whole, abs=1e-5)
    assert rotations.angle_between(between[:3, :3], goal[:3, :3]) == pytest.approx((1 - fraction) * whole, abs=1e-5)


@fast
@given(directions(), st.sampled_from([0.0, 1e-9, 1e-6, 1e-4, 0.3, 2.0, 3.1, np.pi - 1e-6, np.pi]))
def test_rotation_vectors_are_scipys(axis: np.ndarray, angle: float) -> None:
    matrix = rotations.matrix_from_rotation_vector(angle * axis)
    np.testing.assert_allclose(matrix, Rotation.from_rotvec(angle * axis).as_matrix(), atol=1e-13)
    back = rotations.rotation_vector_from_matrix(matrix)
    assert np.linalg.norm(back) == pytest.approx(angle, abs=1e-7)
    np.testing.assert_allclose(rotations.matrix_from_rotation_vector(back), matrix, atol=1e-7)
