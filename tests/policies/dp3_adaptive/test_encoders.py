from __future__ import annotations

import pytest
import torch

from lerobot_policy_adamanip import encoders
from lerobot_policy_adamanip.encoders import PointNet2Encoder, PointNetEncoder, SetAbstraction, ball_query, make_encoder


@pytest.mark.parametrize("in_dim", [3, 6])
def test_the_order_of_points_does_not_matter_to_the_pointnet(in_dim: int) -> None:
    encoder = PointNetEncoder(in_dim, (16, 32), 8)
    points = torch.randn(3, 50, in_dim)
    torch.testing.assert_close(encoder(points[:, torch.randperm(50)]), encoder(points), rtol=0, atol=1e-5)
    # Nor does a point that is there twice: clouds with too few points are repeated.
    torch.testing.assert_close(encoder(torch.cat([points, points[:, :20]], dim=1)), encoder(points), rtol=0, atol=1e-5)


def test_the_order_after_the_centres_does_not_matter_to_the_pointnet2() -> None:
    encoder = PointNet2Encoder(3, (16, 24), 8, 64)
    points = torch.rand(2, 64, 3)
    order = torch.cat([torch.arange(16), 16 + torch.randperm(48)])
    torch.testing.assert_close(encoder(points[:, order]), encoder(points), rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["mlp", "pointnet2"])
@pytest.mark.parametrize("points", [4, 32, 200])
@pytest.mark.parametrize("in_dim", [3, 6])
def test_clouds_become_features_and_every_weight_matters(name: str, points: int, in_dim: int) -> None:
    encoder = make_encoder(name, in_dim, (16, 24, 32), 8, points)
    cloud = (torch.rand(5, points, in_dim) * 0.5).requires_grad_()
    features = encoder(cloud)
    assert features.shape == (5, 8)
    assert torch.isfinite(features).all()
    (features * torch.randn(5, 8)).sum().backward()
    assert cloud.grad is not None
    assert torch.isfinite(cloud.grad).all()
    silent = [name for name, weight in encoder.named_parameters() if weight.grad is None or not weight.grad.any()]
    assert not silent


@pytest.mark.parametrize("name", ["mlp", "pointnet2"])
def test_samples_of_a_batch_are_independent_in_training_too(name: str) -> None:
    encoder = make_encoder(name, 3, (16, 24), 8, 40).train()
    cloud = torch.rand(4, 40, 3)
    whole = encoder(cloud)
    for row in range(4):
        torch.testing.assert_close(encoder(cloud[row : row + 1]), whole[row : row + 1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["mlp", "pointnet2"])
@pytest.mark.parametrize("cloud", [torch.zeros(2, 40, 3), torch.ones(2, 1, 3).expand(2, 40, 3) * 0.3])
def test_a_cloud_of_one_point_repeated_has_finite_features(name: str, cloud: torch.Tensor) -> None:
    encoder = make_encoder(name, 3, (16, 24), 8, 40)
    features = encoder(cloud)
    assert torch.isfinite(features).all()
    features.square().sum().backward()
    assert all(torch.isfinite(weight.grad).all() for weight in encoder.parameters() if weight.grad is not None)


@pytest.mark.parametrize("name", ["mlp", "pointnet2"])
def test_different_clouds_have_different_features(name: str) -> None:
    encoder = make_encoder(name, 3, (16, 24), 8, 40)
    cloud = torch.rand(1, 40, 3)
    assert not torch.allclose(encoder(cloud), encoder(cloud + 0.1), atol=1e-3)


def test_neighbours_are_the_nearest_within_the_radius_and_else_the_centre() -> None:
    xyz = torch.tensor([[[0.0, 0, 0], [0.05, 0, 0], [0.5, 0, 0], [0.08, 0, 0]]])
    index = ball_query(xyz[:, :3], xyz, radius=0.1, neighbours=3)
    assert index[0, 0].tolist() == [0, 1, 3]
    assert index[0, 1].tolist() == [1, 3, 0]
    assert index[0, 2].tolist() == [2, 2, 2]


def test_a_centre_stands_for_itself_far_from_the_origin() -> None:
    xyz = torch.rand(1, 200, 3) + 50
    assert ball_query(xyz, xyz, radius=1e-4, neighbours=4)[0, :, 0].tolist() == list(range(200))


def test_a_query_in_parts_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    xyz = torch.rand(5, 60, 3)
    whole = ball_query(xyz[:, :20], xyz, 0.3, 8)
    monkeypatch.setattr(encoders, "MAX_DISTANCES", 20 * 60 * 2)
    assert torch.equal(ball_query(xyz[:, :20], xyz, 0.3, 8), whole)


def test_what_is_out_of_reach_of_every_centre_is_not_seen() -> None:
    level = SetAbstraction(4, 0.1, 8, 3, (8, 8))
    xyz = torch.rand(1, 30, 3) * 0.2
    changed = torch.cat([xyz, torch.full((1, 3, 3), 5.0)], dim=1)
    torch.testing.assert_close(level(changed, changed)[1], level(xyz, xyz)[1], rtol=0, atol=1e-6)
