"""Rotations in torch, held against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.rotations import rotation_6d_from_matrix
from lerobot_policy_adamanip.common.torch_rotations import (
    angle_between,
    matrix_from_6d,
    matrix_from_rotation_vector,
    rotation_vector,
)

HALF_TURNS = np.pi * np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [0.0, -0.6, 0.8]])


def _vectors(kind: str) -> np.ndarray:
    draw = np.random.default_rng(3)
    axes = draw.normal(size=(200, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = {"any": draw.uniform(0, np.pi - 0.01, 200), "small": 10.0 ** draw.uniform(-9, -2, 200),
              "nearly half a turn": np.pi - 10.0 ** draw.uniform(-5, -2, 200)}  # fmt: skip
    return axes * angles[kind][:, None]


@pytest.mark.parametrize("kind", ["any", "small", "nearly half a turn"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_vector_becomes_a_matrix_and_comes_back(kind: str, dtype: torch.dtype) -> None:
    vectors = _vectors(kind)
    matrices = matrix_from_rotation_vector(torch.from_numpy(vectors).to(dtype))
    exact = dtype is torch.float64
    wanted = Rotation.from_rotvec(vectors)
    np.testing.assert_allclose(matrices.numpy(), wanted.as_matrix(), atol=1e-12 if exact else 3e-6)
    back = rotation_vector(matrices).double().numpy()
    # As rotations: in single precision half a turn and a little less are the same, and either axis will do.
    missed = (Rotation.from_rotvec(back).inv() * wanted).magnitude()
    np.testing.assert_allclose(missed, 0.0, atol=1e-9 if exact else 1e-5)
    if kind != "nearly half a turn":
        np.testing.assert_allclose(back, vectors, atol=1e-9 if exact else 1e-5)


def test_half_a_turn_has_an_axis() -> None:
    matrices = torch.from_numpy(Rotation.from_rotvec(HALF_TURNS).as_matrix()).float()
    found = rotation_vector(matrices).double().numpy()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.pi, atol=1e-5)
    np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), matrices.numpy(), atol=1e-5)


def test_the_angle_between_rotations_is_the_turn_between_them() -> None:
    first = Rotation.random(10, random_state=1)
    for angle in (0.0, 0.3, 3.0):
        second = Rotation.from_rotvec(angle * np.eye(3)[1]) * first
        one, other = (torch.from_numpy(rotation_6d_from_matrix(each.as_matrix())) for each in (first, second))
        found = angle_between(one.requires_grad_(), other)
        np.testing.assert_allclose(found.detach(), np.full(10, angle), atol=2e-3)
        (gradient,) = torch.autograd.grad(found.sum(), one)
        assert torch.isfinite(gradient).all()


def test_rotation_6d_is_a_matrix_again() -> None:
    matrices = Rotation.random(50, random_state=1).as_matrix()
    six = torch.from_numpy(rotation_6d_from_matrix(matrices))
    np.testing.assert_allclose(matrix_from_6d(six).numpy(), matrices, atol=1e-12)
