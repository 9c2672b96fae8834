from __future__ import annotations

import pytest
import torch

from lerobot_policy_adamanip.common import encoders
from lerobot_policy_adamanip.common.encoders import (
    PointNet2Encoder,
    PointNetEncoder,
    SetAbstraction,
    ball_query,
)


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


@pytest.mark.parametrize("kind", [PointNetEncoder, PointNet2Encoder])
@pytest.mark.parametrize(("points", "in_dim"), [(4, 3), (32, 6), (200, 3)])
def test_clouds_become_features_and_every_weight_matters(kind: type, points: int, in_dim: int) -> None:
    encoder = kind(in_dim, (16, 24, 32), 8, *([points] if kind is PointNet2Encoder else []))
    cloud = (torch.rand(5, points, in_dim) * 0.5).requires_grad_()
    features = encoder(cloud)
    assert features.shape == (5, 8)
    assert torch.isfinite(features).all()
    (features * torch.randn(5, 8)).sum().backward()
    assert cloud.grad is not None
    assert torch.isfinite(cloud.grad).all()
    for row in range(5):  # samples are independent
        torch.testing.assert_close(encoder(cloud[row : row + 1]), features[row : row + 1], rtol=0, atol=1e-5)
    same = encoder(torch.full((2, points, in_dim), 0.3))
    assert torch.isfinite(same).all()
    assert not torch.allclose(same[0], features[0], atol=1e-3)
    silent = [name for name, weight in encoder.named_parameters() if weight.grad is None or not weight.grad.any()]
    assert not silent


def test_neighbours_are_the_nearest_within_the_radius_and_else_the_centre() -> None:
    xyz = torch.tensor([[[0.0, 0, 0], [0.05, 0, 0], [0.5, 0, 0], [0.08, 0, 0]]])
    index = ball_query(xyz[:, :3], xyz, radius=0.1, neighbours=3)
    assert index[0, 0].tolist() == [0, 1, 3]
    assert index[0, 1].tolist() == [1, 3, 0]
    assert index[0, 2].tolist() == [2, 2, 2]
    far = torch.rand(1, 200, 3) + 50  # a centre stands for itself far from the origin
    assert ball_query(far, far, radius=1e-4, neighbours=4)[0, :, 0].tolist() == list(range(200))


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


# Backward through the winners only -----------------------------------------------------------------------------------


def gradients(encoder: PointNetEncoder, points: torch.Tensor) -> list[torch.Tensor]:
    """What a loss of the encoder's features gives to every weight, and to the points; the features last."""
    points = points.clone().requires_grad_()
    features = encoder(points)
    weight = torch.linspace(-1, 1, features.numel(), dtype=features.dtype).reshape(features.shape)
    return [*torch.autograd.grad((features * weight).sum(), [*encoder.parameters(), points]), features.detach()]


@pytest.mark.parametrize(("dtype", "bound"), [(torch.float64, 1e-13), (torch.float32, 1e-5)], ids=str)
@pytest.mark.parametrize("shape", [(3, 50, 6), (1, 1, 3)], ids=str)
def test_winners_alone_have_the_gradient_of_the_plain_way(
    monkeypatch: pytest.MonkeyPatch, dtype: torch.dtype, bound: float, shape: tuple[int, int, int]
) -> None:
    torch.manual_seed(0)
    encoder, points = PointNetEncoder(shape[-1], (16, 32), 8).to(dtype), torch.randn(shape, dtype=dtype)
    found = gradients(encoder, points)
    monkeypatch.setattr(PointNetEncoder, "_maximum_of_winners", lambda own, cloud: own.mlp(cloud).amax(dim=-2))
    for one, other in zip(found, gradients(encoder, points), strict=True):
        assert (one - other).norm() <= bound * other.norm()
