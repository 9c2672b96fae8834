"""Rotations in torch, held against scipy's; what the tool sees, and what it remembers of what it did."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d, rotation_6d_from_matrix
from lerobot_policy_adamanip.common.contacts import Past
from lerobot_policy_adamanip.common.geometry import (
    absolute_poses,
    angle_between,
    constant,
    matrix_from_rotation_vector,
    mirrored_motions,
    mirrored_poses,
    motion_between,
    points_seen,
    pose_after,
    relative_poses,
    rotation_vector,
    upwards,
)


def _poses(count: int, seed: int) -> torch.Tensor:
    draw = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=seed).as_matrix()
    parts = [draw.normal(size=(count, 3)), rotation_6d_from_matrix(turns), draw.uniform(size=(count, 1))]
    return torch.from_numpy(np.concatenate(parts, axis=1)).float()


def _moved(poses: torch.Tensor, turn: Rotation, shift: np.ndarray) -> torch.Tensor:
    position = turn.apply(poses[:, :3].numpy()) + shift
    rotation = turn.as_matrix() @ matrix_from_rotation_6d(poses[:, 3:9].numpy())
    return torch.from_numpy(
        np.concatenate([position, rotation_6d_from_matrix(rotation), poses[:, 9:].numpy()], axis=1)
    ).float()


def test_a_mirrored_arm_sees_mirrored_motions_and_points() -> None:
    tool, goal = _poses(60, 1), _poses(60, 2)
    found = motion_between(mirrored_poses(goal), mirrored_poses(tool))
    wanted = mirrored_motions(motion_between(goal, tool))
    # Half a turn is the same about an axis and its opposite: compared as where they lead.
    torch.testing.assert_close(pose_after(found, tool), pose_after(wanted, tool), rtol=0, atol=5e-4)
    cloud = torch.randn(60, 30, 3)
    across = torch.tensor([1.0, -1.0, 1.0])
    seen = points_seen(cloud * across, mirrored_poses(tool))
    torch.testing.assert_close(seen, points_seen(cloud, tool) * across, rtol=0, atol=1e-4)
    assert torch.equal(mirrored_poses(mirrored_poses(tool)), tool)


def test_a_motion_leads_where_it_was_seen_to_lead() -> None:
    tool, goal = _poses(60, 1), _poses(60, 2)
    motion = motion_between(goal, tool)
    assert motion.shape == (60, 7)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(motion_between(goal, tool), motion)  # half precision would blur positions
    both = motion_between(goal, torch.stack([tool, goal]))  # of several tools at once
    assert torch.equal(both[0], motion)
    torch.testing.assert_close(both[1, :, :6], torch.zeros(60, 6), rtol=0, atol=1e-3)  # staying is no motion
    torch.testing.assert_close(pose_after(motion, tool), goal, rtol=0, atol=2e-4)
    torch.testing.assert_close(absolute_poses(relative_poses(goal, tool), tool), goal, rtol=0, atol=1e-5)
    torch.testing.assert_close(relative_poses(goal, tool)[:, :3], motion[:, :3])
    distance = (goal[:, :3] - tool[:, :3]).norm(dim=-1)
    torch.testing.assert_close(motion[:, :3].norm(dim=-1), distance, rtol=0, atol=1e-5)


def test_what_is_seen_does_not_depend_on_where_everything_stands() -> None:
    tool, goal = _poses(30, 4), _poses(30, 5)
    cloud = torch.from_numpy(np.random.default_rng(6).normal(size=(30, 11, 3))).float()
    turn, shift = Rotation.from_rotvec([0.3, -1.0, 2.0]), np.array([0.5, -0.2, 0.8])
    there = [_moved(poses, turn, shift) for poses in (tool, goal)]
    moved_cloud = torch.from_numpy(turn.apply(cloud.reshape(-1, 3).numpy()) + shift).float().reshape(30, 11, 3)
    torch.testing.assert_close(motion_between(there[1], there[0]), motion_between(goal, tool), rtol=0, atol=1e-3)
    torch.testing.assert_close(points_seen(moved_cloud, there[0]), points_seen(cloud, tool), rtol=0, atol=1e-5)
    # Only gravity tells a fallen scene from an upright one.
    assert not torch.allclose(upwards(there[0]), upwards(tool), atol=0.1)
    upright = _moved(tool, Rotation.from_rotvec([0, 0, 1.2]), shift)
    torch.testing.assert_close(upwards(upright), upwards(tool), rtol=0, atol=1e-6)


def test_an_event_tells_what_was_left_undone() -> None:
    poses = _poses(3, 9)[None]
    reached = Past(poses[:, 1:], poses, torch.ones(1, 2, dtype=torch.bool)).events()
    torch.testing.assert_close(reached[0, :, 7:14], torch.zeros(2, 7), rtol=0, atol=0.05)
    assert reached[..., -1].all()
    commands = poses[:, 1:].clone()
    commands[0, 0, 9] += 0.5
    commands[0, 1, :3] += 0.007 * matrix_first_axis(poses[0, 2])
    stopped = Past(commands, poses, torch.ones(1, 2, dtype=torch.bool)).events()
    torch.testing.assert_close(stopped[0, 0, 13], torch.tensor(0.5), rtol=0, atol=1e-5)
    torch.testing.assert_close(stopped[0, 1, 7:10], torch.tensor([0.7, 0.0, 0.0]), rtol=0, atol=1e-3)


def matrix_first_axis(pose: torch.Tensor) -> torch.Tensor:
    """The tool's x axis in the base frame."""
    return torch.from_numpy(matrix_from_rotation_6d(pose[3:9].numpy())[:, 0]).float()


def test_what_was_before_the_start_leaves_no_trace() -> None:
    valid = torch.tensor([[False, False, True]])
    poses, commands = _poses(4, 10)[None], _poses(3, 11)[None]
    rows = Past(commands, poses, valid).events()
    assert not rows[0, :2].any()
    other_poses, other_commands = poses.clone(), commands.clone()
    other_poses[:, :2] += 1.0
    other_commands[:, :2] -= 1.0
    assert torch.equal(Past(other_commands, other_poses, valid).events(), rows)


def test_a_constant_made_at_run_time_can_be_trained_with() -> None:
    weight = torch.ones(2, requires_grad=True)
    with torch.inference_mode():
        made = constant((2.0, 3.0), weight)
    assert made is constant((2.0, 3.0), weight)
    assert constant((2.0, 3.0), weight.double()).dtype == torch.float64
    (weight * constant((2.0, 3.0), weight)).sum().backward()
    assert weight.grad is not None
    assert weight.grad.tolist() == [2.0, 3.0]


# Rotations ----------------------------------------------------------------------------------------------------------

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
