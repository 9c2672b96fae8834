"""Networks and plans that the point-level policies share."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.keyframes import PRE_GRASP
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d, rotation_6d_from_matrix
from lerobot_policy_adamanip import VatMartConfig
from lerobot_policy_adamanip.affordance.demonstrations import find_contacts
from lerobot_policy_adamanip.affordance.losses import valid_rows, weighted_mean
from lerobot_policy_adamanip.affordance.networks import (
    ConditionalVAE,
    PlaceFeatures,
    Score,
    mean_of_best,
    point_near,
    points_away,
    scores_of_points,
)
from lerobot_policy_adamanip.affordance.plans import (
    PlanQueue,
    approach,
    decode_grasp,
    encode_grasp,
    holds_something,
    let_go,
    stacked,
    taking_hold,
)
from lerobot_policy_adamanip.common.geometry import backed_off, with_gripper


def some_poses(count: int, gripper: float = 1.0) -> torch.Tensor:
    turns = rotation_6d_from_matrix(Rotation.random(count, random_state=3).as_matrix())
    position = np.random.default_rng(3).normal(size=(count, 3))
    return torch.from_numpy(np.concatenate([position, turns, np.full((count, 1), gripper)], axis=1)).float()


def places_of(context_points: int) -> PlaceFeatures:
    sizes = {"num_points": 60, "encoder_dims": (16, 24), "feature_dim": 12, "patch_radius": 0.1, "patch_points": 8}
    return PlaceFeatures(VatMartConfig(device="cpu", push_to_hub=False, context_points=context_points, **sizes))


# Networks -----------------------------------------------------------------------------------------------------------


def test_features_of_a_place_stay_when_cloud_and_place_are_shifted() -> None:
    features = places_of(32)
    cloud, places, shift = torch.rand(2, 60, 3), torch.rand(2, 5, 3), torch.tensor([0.4, -1.0, 0.3])
    found = features(cloud, places)
    assert found.shape == (2, 5, 12)
    torch.testing.assert_close(features(cloud + shift, places + shift), found, rtol=0, atol=1e-4)
    assert not torch.allclose(features(cloud + shift, places), found, atol=1e-2)
    rest = torch.cat([torch.randperm(32), 32 + torch.randperm(28)])
    torch.testing.assert_close(features(cloud[:, rest], places), found, rtol=0, atol=1e-5)  # points have no order
    score = Score(0, 12)
    each = scores_of_points(lambda clouds, places: score(features(clouds, places)), cloud)
    torch.testing.assert_close(each, score(features(cloud, cloud)), rtol=0, atol=1e-5)


def test_a_place_is_known_by_what_is_around_it() -> None:
    features = places_of(20)
    cloud, place = torch.rand(1, 60, 3), torch.full((1, 1, 3), 0.5)
    other = cloud.clone()
    other[0, 40] = torch.tensor([0.5, 0.5, 0.51])  # none of the first 20, which tell what the cloud is
    assert not torch.allclose(features(other, place), features(cloud, place), atol=1e-3)
    other[0, 40] = torch.tensor([0.5, 0.5, 0.8])
    cloud[0, 40] = torch.tensor([0.5, 0.5, 0.9])  # farther than what is around
    torch.testing.assert_close(features(other, place), features(cloud, place))


def test_proposals_are_drawn_for_each_place_and_follow_the_noise() -> None:
    made = ConditionalVAE(7, 5, 3)
    given = torch.randn(2, 4, 5)
    found = made.proposals(given, 6)
    assert found.shape == (2, 4, 6, 7)
    assert found.std(dim=2).min() > 0
    noise = torch.randn(2, 4, 6, 3)
    torch.testing.assert_close(made.proposals(given, 6, noise)[1, 2, 4], made.decode(noise[1, 2, 4], given[1, 2]))
    torch.nn.init.zeros_(made.encoder[-1].weight)
    torch.nn.init.zeros_(made.encoder[-1].bias)
    _, divergence = made(torch.randn(4, 7), torch.randn(4, 5))
    torch.testing.assert_close(divergence, torch.zeros(4))  # a posterior that is the prior


def test_means_are_of_the_best_and_of_what_has_weight() -> None:
    scores = torch.tensor([[0.1, 0.9, 0.5], [0.2, 0.0, 0.4]])
    torch.testing.assert_close(mean_of_best(scores, 2), torch.tensor([0.7, 0.3]))
    torch.testing.assert_close(mean_of_best(scores, 9), scores.mean(dim=1))
    torch.testing.assert_close(
        weighted_mean(torch.tensor([1.0, 5.0, 9.0]), torch.tensor([1.0, 0, 1])), torch.tensor(5.0)
    )
    assert weighted_mean(torch.ones(3), torch.zeros(3)) == 0
    assert valid_rows(torch.tensor([False, True, True])).tolist() == [1, 2]
    assert valid_rows(torch.zeros(3, dtype=torch.bool)).tolist() == [0]


def test_points_are_drawn_near_and_away() -> None:
    cloud, place = torch.rand(40, 50, 3), torch.full((40, 3), 0.5)
    near = point_near(cloud, place, 0.3)
    distance = (cloud - place[:, None]).norm(dim=-1)
    within = distance.amin(dim=1) <= 0.3
    assert within.any()
    assert ((near - place).norm(dim=-1)[within] <= 0.3).all()
    torch.testing.assert_close((point_near(cloud, place, 0.0) - place).norm(dim=-1), distance.amin(dim=1))
    places = torch.stack([place, torch.zeros_like(place)], dim=1)
    away = points_away(cloud, places, 0.3, 4)
    assert away.shape == (40, 4, 3)
    assert (torch.cdist(away, places) > 0.3).all()


# Grasps and key frames ----------------------------------------------------------------------------------------------


def test_a_grasp_relative_to_a_place_is_the_grasp_again() -> None:
    grasp, place = some_poses(20), torch.randn(20, 3)
    torch.testing.assert_close(decode_grasp(encode_grasp(grasp, place), place), grasp, rtol=0, atol=1e-5)
    pose = decode_grasp(3 * torch.randn(50, 10), torch.zeros(50, 3))  # any numbers are a grasp
    matrices = matrix_from_rotation_6d(pose[:, 3:9].numpy())
    np.testing.assert_allclose(rotation_6d_from_matrix(matrices), pose[:, 3:9], atol=1e-4)
    assert set(pose[:, 9].tolist()) <= {0.0, 1.0}


def test_a_grasp_is_approached_along_the_tools_z_axis_and_then_closed() -> None:
    grasp = some_poses(10)
    before, there, closed = approach(grasp).unbind(dim=1)
    axis = matrix_from_rotation_6d(grasp[:, 3:9].numpy())[:, :, 2]
    np.testing.assert_allclose(there[:, :3] - before[:, :3], PRE_GRASP * axis, atol=1e-5)
    torch.testing.assert_close(before[:, 3:], grasp[:, 3:], rtol=0, atol=1e-5)
    assert torch.equal(there, grasp)
    assert torch.equal(closed[:, :9], grasp[:, :9])
    assert not closed[:, 9].any()


def test_a_part_is_grasped_or_pushed_by_a_hand_that_has_let_go() -> None:
    grasp, pushed = some_poses(2)
    held, empty = some_poses(1, gripper=0.3)[0], some_poses(1)[0]
    for opening in (0.0, 0.04, 0.3, 0.6, 1.0):  # neither shut nor open
        assert holds_something(with_gripper(empty, opening)) is (opening in (0.3, 0.6))
    torch.testing.assert_close(taking_hold(empty, grasp, pushed), approach(grasp))
    torch.testing.assert_close(taking_hold(held, grasp, pushed), torch.cat([let_go(held), approach(grasp)]))
    closed = with_gripper(grasp, 0.0)
    torch.testing.assert_close(
        taking_hold(empty, closed, pushed), torch.stack([backed_off(closed, PRE_GRASP), closed, pushed])
    )


def test_a_push_is_a_contact_whose_first_motion_is_the_push() -> None:
    """As demonstrations are read: no key frame in which nothing moves is remembered as an interaction."""
    closed, pushed = with_gripper(some_poses(2), 0.0)
    sent = taking_hold(some_poses(1)[0], closed, pushed).numpy()
    felt = np.concatenate([some_poses(1).numpy(), sent[:-1]])
    (contact,) = find_contacts(felt, sent)
    assert (contact.first, contact.end) == (2, 3)


def test_plans_of_several_episodes_end_at_different_times() -> None:
    long, short = some_poses(5), some_poses(2)
    torch.testing.assert_close(stacked([long, short]), torch.stack([long, short[[0, 1, 1, 1, 1]]]))
    queue = PlanQueue()
    assert queue.finished(2) == [0, 1]
    first, second = torch.arange(20.0).reshape(2, 10), torch.arange(100.0, 110.0).reshape(1, 10)
    queue.append(0, first)
    queue.append(1, second)
    assert queue.finished(2) == []
    torch.testing.assert_close(queue.pop(), torch.stack([first[0], second[0]]))
    assert queue.finished(2) == [1]
    queue.append(1, second + 1)
    torch.testing.assert_close(queue.pop(), torch.stack([first[1], second[0] + 1]))
    queue.append(0, first)
    queue.clear()
    assert queue.finished(2) == [0, 1]
