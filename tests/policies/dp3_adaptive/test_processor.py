"""What happens to samples before and to actions after the policy."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.datasets.io_utils import load_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.lerobot_types import TransitionKey
from lerobot.policies.factory import make_pre_post_processors
from lerobot.processor.converters import (
    batch_to_transition,
    policy_action_to_transition,
    transition_to_batch,
)
from toy_demos import REPO_ID

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import MirrorStep, OrthonormaliseStep

MakeTiny = Callable[..., tuple[Any, ...]]


@pytest.mark.parametrize("preset", ["keyframe", "dp3"])
def test_true_and_fixed_statistics_normalise_alike(make_tiny: MakeTiny, raw: dict[str, Any], preset: str) -> None:
    """Datasets of version 0.2 hold fixed ranges of rotation and gripper, newer ones the true statistics."""
    policy, *_, dataset = make_tiny(preset=preset)
    config, meta = policy.config, dataset.meta
    true = load_stats(meta.root)
    np.testing.assert_equal(meta.stats, true)  # a caller's metadata stay as they were
    made = [make_pre_post_processors(config, dataset_stats=each) for each in (true, schema.fix_pose_statistics(true))]
    (before, after), (before_fixed, after_fixed) = made
    batch, fixed = (step(copy.deepcopy(raw)) for step in (before, before_fixed))
    for key in (schema.STATE, schema.ACTION, schema.POINT_CLOUD):
        assert torch.equal(batch[key], fixed[key]), key
    assert torch.equal(after(batch[schema.ACTION].clone()), after_fixed(batch[schema.ACTION].clone()))
    torch.testing.assert_close(batch[schema.ACTION][..., 3:], raw[schema.ACTION][..., 3:], rtol=0, atol=1e-6)


@pytest.fixture
def raw(adaptive_toy_root: Path) -> dict[str, Any]:
    """A collated batch as a loader gives it, clouds as points: metres, two observation steps, seven actions."""
    steps = dict.fromkeys((schema.POINT_CLOUD, schema.STATE, schema.EFFORT), (-1, 0))
    steps[schema.ACTION] = tuple(range(-3, 4))
    stamps = {key: [step / schema.FPS for step in each] for key, each in steps.items()}
    dataset = LeRobotDataset(REPO_ID, root=adaptive_toy_root, delta_timestamps=stamps)
    batch = dict(torch.utils.data.default_collate([dataset[index] for index in (2, 5, 14, 20)]))
    return {**batch, schema.POINT_CLOUD: as_points(batch[schema.POINT_CLOUD])}


def _mirrored(raw: dict[str, Any], share: float) -> dict[str, Any]:
    return dict(transition_to_batch(MirrorStep(share)(batch_to_transition(raw))))


def _matrices(poses: torch.Tensor) -> torch.Tensor:
    return torch.from_numpy(matrix_from_rotation_6d(poses[..., 3:9].double().numpy()))


def _views(batch: dict[str, Any]) -> list[torch.Tensor]:
    """What does not depend on where the scene stands: everything as seen from the tool, and heights' differences."""
    cloud, state, action = batch[schema.POINT_CLOUD], batch[schema.STATE], batch[schema.ACTION]
    tool = _matrices(state[:, -1])
    origin = state[:, -1, :3].double()
    points = (cloud.double() - origin[:, None, None]).flatten(1, 2) @ tool
    actions = (action[..., :3].double() - origin[:, None]) @ tool
    # In the tool's frame: R_tool^T R_action.
    turns = tool.transpose(-1, -2)[:, None] @ _matrices(action)
    distances = torch.linalg.vector_norm(cloud.double() - state[..., None, :3].double(), dim=-1)
    gram = batch[schema.ACTION][..., 3:9].double().unflatten(-1, (2, 3))
    return [points, actions, turns, distances, gram @ gram.transpose(-1, -2), action[..., 9:], state[..., 9:]]


def test_a_mirrored_scene_is_the_same_scene_left_for_right(raw: dict[str, Any]) -> None:
    """Seen from the tool, all is where it was, but for the sign of y; turns about y keep theirs, others change it."""
    known = copy.deepcopy(raw)
    moved, across = _mirrored(raw, 1.0), torch.diag(torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64))
    found, wanted = _views(moved), _views(raw)
    torch.testing.assert_close(found[0], wanted[0] @ across, rtol=0, atol=1e-5)
    torch.testing.assert_close(found[1], wanted[1] @ across, rtol=0, atol=1e-5)
    torch.testing.assert_close(found[2], across @ wanted[2] @ across, rtol=0, atol=1e-5)
    for same_before, same_after in zip(wanted[3:], found[3:], strict=True):
        torch.testing.assert_close(same_after, same_before, rtol=0, atol=1e-5)
    torch.testing.assert_close(torch.linalg.det(_matrices(moved[schema.ACTION])), torch.ones(4, 7, dtype=torch.float64))
    torch.testing.assert_close(moved[schema.POINT_CLOUD][..., 1], -raw[schema.POINT_CLOUD][..., 1])
    torch.testing.assert_close(moved[schema.POINT_CLOUD][..., ::2], raw[schema.POINT_CLOUD][..., ::2])
    for key in (schema.EFFORT, "action_is_pad"):
        assert torch.equal(moved[key], raw[key]), key
    for key in (schema.POINT_CLOUD, schema.STATE, schema.ACTION):  # the given batch is not written to
        assert torch.equal(known[key], raw[key])


def test_a_share_of_the_samples_is_mirrored_whole(raw: dict[str, Any]) -> None:
    many = {
        key: value.repeat_interleave(50, 0) if hasattr(value, "repeat_interleave") else value
        for key, value in raw.items()
    }
    moved = _mirrored(many, 0.3)
    sides = []
    for key in (schema.POINT_CLOUD, schema.STATE, schema.ACTION):
        kept = (moved[key] == many[key]).flatten(1).all(dim=1)
        turned = (moved[key][..., 1] == -many[key][..., 1]).flatten(1).all(dim=1)
        assert bool((kept | turned).all())
        sides.append(kept)
    assert torch.equal(sides[0], sides[1])
    assert torch.equal(sides[0], sides[2])
    assert 0.2 < 1 - sides[0].double().mean() < 0.4


def test_nothing_is_mirrored_by_nothing_or_without_actions(raw: dict[str, Any]) -> None:
    transition = batch_to_transition(raw)
    assert MirrorStep()(transition) is transition
    running = batch_to_transition({**raw, schema.ACTION: None})
    assert MirrorStep(0.5)(running) is running


def test_a_cloud_of_a_dataset_is_mirrored_as_its_points(raw: dict[str, Any]) -> None:
    cloud = raw[schema.POINT_CLOUD]
    points, flat = (_mirrored({**raw, schema.POINT_CLOUD: each}, 1.0) for each in (cloud, cloud.flatten(-2)))
    assert torch.equal(points[schema.POINT_CLOUD], flat[schema.POINT_CLOUD])
    colours = torch.rand(*cloud.shape[:-1], 3)
    coloured = _mirrored({**raw, schema.POINT_CLOUD: torch.cat([cloud, colours], dim=-1)}, 1.0)
    assert torch.equal(coloured[schema.POINT_CLOUD][..., 3:], colours)


def test_any_ten_numbers_become_a_pose() -> None:
    degenerate = torch.zeros(4, 10)
    degenerate[1, 3:9] = torch.tensor([1.0, 2, 3, 2, 4, 6])
    degenerate[2, 3:6] = torch.tensor([1e-9, 0, 0])
    degenerate[3, 6:9] = torch.tensor([0.0, 0, 5])
    for actions in (torch.randn(50, 10) * 3, torch.randn(2, 4, 10), degenerate):
        whole = OrthonormaliseStep()(policy_action_to_transition(actions))[TransitionKey.ACTION]
        rows = whole[..., 3:9].unflatten(-1, (2, 3))
        torch.testing.assert_close(
            rows @ rows.transpose(-1, -2), torch.eye(2).expand(*rows.shape[:-2], 2, 2), rtol=0, atol=1e-5
        )
        assert torch.equal(whole[..., :3], actions[..., :3])
        assert torch.equal(whole[..., 9], actions[..., 9].clamp(0, 1))
        # As the environment's own reading of the command: the policy's step changes nothing about it.
        expected = matrix_from_rotation_6d(actions[..., 3:9].double().numpy())[..., :2, :]
        np.testing.assert_allclose(rows.numpy(), expected, atol=1e-4)
        again = OrthonormaliseStep()(policy_action_to_transition(whole))[TransitionKey.ACTION]
        torch.testing.assert_close(again, whole, rtol=0, atol=1e-6)
    joints = torch.randn(3, 7)
    assert OrthonormaliseStep()(policy_action_to_transition(joints))[TransitionKey.ACTION] is joints
