"""A dataset whose statistics leave rotation and gripper unscaled: LeRobot's policies then train on them as they are."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from doc_data import collect_fake_demos
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies.factory import make_policy_config, make_pre_post_processors
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.schema import Statistics
from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled, unscaled_poses


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Not to be written to."""
    root = tmp_path_factory.mktemp("measured") / "outputs" / "demos"
    collect_fake_demos(root)
    return root


@pytest.fixture
def root(measured: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(measured, tmp_path / "demos"))


def meta(root: Path) -> LeRobotDatasetMetadata:
    return LeRobotDatasetMetadata("local/demos", root=root)


def normalized(stats: Statistics, features: dict[str, dict[str, object]], kind: str) -> dict[str, torch.Tensor]:
    """State and action as a training of a policy of LeRobot sees them."""
    config = make_policy_config(kind, device="cpu")
    kept = dataset_to_policy_features(features)
    config.input_features, config.output_features = (
        {schema.STATE: kept[schema.STATE]},
        {schema.ACTION: kept[schema.ACTION]},
    )
    before, _ = make_pre_post_processors(config, dataset_stats=stats)
    draw = torch.Generator().manual_seed(3)
    widths = {schema.STATE: schema.STATE_DIM, schema.ACTION: schema.ACTION_DIM}
    batch = before({key: torch.randn(5, width, generator=draw) for key, width in widths.items()})
    return {key: torch.as_tensor(batch[key]) for key in widths}


@pytest.mark.parametrize("kind", ["act", "diffusion"])
def test_policies_of_lerobot_see_rotation_and_gripper_as_they_are(measured: Path, root: Path, kind: str) -> None:
    before, features = meta(measured).stats, meta(measured).features
    leave_poses_unscaled(root)
    seen = normalized(meta(root).stats, features, kind)
    in_memory = normalized(unscaled_poses(before, features), features, kind)
    scaled = normalized(before, features, kind)
    draw = torch.Generator().manual_seed(3)
    raw = {key: torch.randn(5, seen[key].shape[-1], generator=draw) for key in seen}
    for key, values in seen.items():
        assert torch.equal(values, in_memory[key])
        assert torch.equal(values[:, :3], scaled[key][:, :3])
        torch.testing.assert_close(values[:, 3:10], raw[key][:, 3:10], rtol=0, atol=1e-6)
        assert (scaled[key][:, 3:10] - raw[key][:, 3:10]).abs().min() > 0


def test_nothing_but_those_ranges_changes(measured: Path, root: Path) -> None:
    leave_poses_unscaled(root)
    once = (root / "meta" / "stats.json").read_bytes()
    leave_poses_unscaled(str(root))
    assert (root / "meta" / "stats.json").read_bytes() == once
    before, after = (json.loads((each / "meta" / "stats.json").read_text()) for each in (measured, root))
    assert list(before) == list(after)
    changed = {key for key in before if before[key] != after[key]}
    assert changed == {schema.STATE, schema.ACTION}
    for key in changed:
        kept = [dim for dim in range(len(before[key]["min"])) if dim not in schema.FIXED_RANGE_DIMS]
        for name, values in before[key].items():
            np.testing.assert_array_equal(
                np.take(values, kept[: len(values)]), np.take(after[key][name], kept[: len(values)])
            )
    for path in (path for path in measured.rglob("*") if path.is_file() and path.name != "stats.json"):
        assert (root / path.relative_to(measured)).read_bytes() == path.read_bytes()
