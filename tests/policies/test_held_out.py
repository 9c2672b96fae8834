"""Held-out episodes shape nothing that a policy computes from its dataset, but their loss can be measured."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from toy_demos import REPO_ID, record_toy, toy_world

from lerobot_policy_adamanip.common.inputs import trained_episodes

MakePolicy = Callable[..., tuple[Any, ...]]
TRAINED = [0, 1, 2, 3]
CASES = [("dp3_adaptive", {"preset": "keyframe"}), ("sampling", {})]


@pytest.fixture(scope="module")
def part_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first episodes of the adaptive toy dataset alone."""
    worlds = [toy_world("bottle_000", seed) for seed in TRAINED]
    return record_toy(tmp_path_factory.mktemp("part") / "dataset", worlds, "adaptive")


@pytest.mark.parametrize("case", CASES, ids=str)
def test_what_is_fitted_is_that_of_the_trained_episodes_alone(
    make_toy_policy: MakePolicy,
    adaptive_toy_root: Path,
    part_root: Path,
    batch_of: Any,
    case: tuple[str, dict[str, Any]],
) -> None:
    method, options = case
    some, before, *_ = make_toy_policy(method, adaptive_toy_root, episodes=TRAINED, **options)
    part, *_ = make_toy_policy(method, part_root, **options)
    every, *_ = make_toy_policy(method, adaptive_toy_root, **options)
    fitted = [dict(policy.model.named_buffers()) for policy in (some, part, every)]
    assert fitted[0]
    assert all(torch.equal(value, fitted[1][name]) for name, value in fitted[0].items())
    assert not all(torch.equal(value, fitted[2][name]) for name, value in fitted[0].items())
    held_out = LeRobotDataset(REPO_ID, root=adaptive_toy_root, episodes=[4, 5])
    assert torch.isfinite(some.forward(batch_of(held_out, before))[0])


def test_the_dataset_of_metadata_is_found_wherever_it_is_kept(adaptive_toy_root: Path) -> None:
    kept = {"trainer": [LeRobotDataset(REPO_ID, root=adaptive_toy_root, episodes=each) for each in (None, [2], [0, 4])]}
    assert [trained_episodes(dataset.meta) for dataset in kept["trainer"]] == [None, [2], [0, 4]]


def test_metadata_of_no_dataset_say_that_nothing_is_held_out(
    adaptive_toy_root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert trained_episodes(LeRobotDatasetMetadata(REPO_ID, root=adaptive_toy_root)) is None
    assert "all of its episodes count as trained on" in caplog.text


LABELS = {"sampling": "contacts_of", "vat_mart": "plan_of", "adaafford": "candidates"}


@pytest.mark.parametrize("method", LABELS)
def test_labels_are_those_of_their_rows_also_where_other_files_were_not_downloaded(
    make_toy_policy: MakePolicy, adaptive_toy_root: Path, tmp_path: Path, method: str
) -> None:
    part = Path(shutil.copytree(adaptive_toy_root, tmp_path / "part"))
    for path in (part / "data").rglob("*.parquet"):
        rows = pq.read_table(path)
        pq.write_table(rows.filter(pc.greater_equal(rows["episode_index"], 3)), path)
    made, *_ = make_toy_policy(method, adaptive_toy_root)
    labelled = []
    for root in (adaptive_toy_root, part):
        dataset = LeRobotDataset(REPO_ID, root=root, episodes=[3, 4, 5])
        policy = type(made)(made.config, dataset_meta=dataset.meta)
        index = torch.as_tensor(dataset.hf_dataset.with_format("numpy")["index"][:])
        labelled.append(getattr(policy.labels, LABELS[method])[policy.rows_of({"index": index})] >= 0)
    assert labelled[0].any()
    assert torch.equal(*labelled)
