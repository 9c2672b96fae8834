"""Rotations in torch, batched and differentiable. Rotation 6D is a matrix' first two rows, as in the contract."""

from __future__ import annotations

import torch
from torch import Tensor


def orthonormal_6d(rotation_6d: Tensor) -> Tensor:
    """Returns a rotation's first two rows by Gram-Schmidt. (..., 6) -> (..., 6).

    Zero or parallel rows are replaced by unit axes, as in `contract.rotations`.
    """
    first, second = rotation_6d[..., :3], rotation_6d[..., 3:]
    axes = torch.eye(3, dtype=rotation_6d.dtype, device=rotation_6d.device)
    first = _unit(first, axes[0].expand_as(first))
    helper = torch.where(first[..., :1].abs() < 0.9, axes[0], axes[1])
    spare = _unit(torch.linalg.cross(first, helper), axes[1].expand_as(first))
    second = _unit(second - (first * second).sum(-1, keepdim=True) * first, spare)
    return torch.cat([first, second], dim=-1)


def matrix_from_6d(rotation_6d: Tensor) -> Tensor:
    """Converts rotation 6D (..., 6) to rotation matrices (..., 3, 3)."""
    rows = orthonormal_6d(rotation_6d)
    first, second = rows[..., :3], rows[..., 3:]
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-2)


def angle_between(first_6d: Tensor, second_6d: Tensor) -> Tensor:
    """Returns the angle [rad] between two rotations 6D. (..., 6), (..., 6) -> (...); its gradient is finite."""
    first, second = matrix_from_6d(first_6d), matrix_from_6d(second_6d)
    cosine = ((first * second).sum(dim=(-2, -1)) - 1) / 2
    return cosine.clamp(-1 + SMALL, 1 - SMALL).acos()


def rotation_vector(matrix: Tensor) -> Tensor:
    """Converts rotation matrices (..., 3, 3) to axis times angle (..., 3) [rad], with an angle of at most pi.

    Uses the quaternion, from its largest component, which is accurate near pi too.
    """
    m = matrix
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    diagonal = torch.stack([trace, m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], dim=-1)
    # Four times the products of the quaternion's (w, x, y, z) with each of its components.
    square = 1 - trace[..., None] + 2 * diagonal
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 2, 0] + m[..., 0, 2], m[..., 2, 1] + m[..., 1, 2]
    products = torch.stack(
        [
            torch.stack([1 + trace, wx, wy, wz], dim=-1),
            torch.stack([wx, square[..., 1], xy, xz], dim=-1),
            torch.stack([wy, xy, square[..., 2], yz], dim=-1),
            torch.stack([wz, xz, yz, square[..., 3]], dim=-1),
        ],
        dim=-2,
    )
    largest = diagonal.argmax(dim=-1)[..., None, None].expand(*diagonal.shape[:-1], 1, 4)
    quaternion = products.gather(-2, largest).squeeze(-2)
    quaternion = quaternion / quaternion.norm(dim=-1, keepdim=True)
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = quaternion[..., 1:].norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, quaternion[..., :1])
    return quaternion[..., 1:] * torch.where(sine > SMALL, angle / sine.clamp(min=SMALL), 2.0)


SMALL = 1e-6
"""Sine below which sine and angle are equal."""


def matrix_from_rotation_vector(vector: Tensor) -> Tensor:
    """Converts axis times angle (..., 3) [rad] to rotation matrices (..., 3, 3)."""
    x, y, z = vector.unbind(dim=-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).reshape(*x.shape, 3, 3)
    # Rodrigues' formula: sin(a) / a and (1 - cos(a)) / a^2 by sinc, which is defined at zero.
    turns = vector.norm(dim=-1)[..., None, None] / torch.pi
    same = torch.eye(3, dtype=vector.dtype, device=vector.device)
    return same + torch.sinc(turns) * cross + 0.5 * torch.sinc(turns / 2).square() * (cross @ cross)


def _unit(vector: Tensor, fallback: Tensor) -> Tensor:
    norm = vector.norm(dim=-1, keepdim=True)
    return torch.where(norm > 1e-6, vector / norm.clamp(min=1e-6), fallback)
