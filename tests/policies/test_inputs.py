"""Histories and labels are looked up by a row's index: right on every reader, for whichever episodes were read."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from toy_demos import REPO_ID

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.inputs import EPISODE, INDEX, RecordedRows, read_recorded_rows

MakePolicy = Callable[..., tuple[Any, ...]]
SHAPES: list[dict[str, Any]] = [
    {"preset": "keyframe", "n_action_history_steps": 16},
    {"preset": "dp3", "n_action_history_steps": 8, "horizon": 4},
    {"preset": "dp3", "n_action_history_steps": 0, "horizon": 4, "n_obs_steps": 2},
]


@pytest.fixture(scope="module")
def corrected_root(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy dataset as if a policy had driven: what was executed is never the label."""
    root = tmp_path_factory.mktemp("corrected") / "dataset"
    shutil.copytree(toy_root, root)
    for path in (root / "data").rglob("*.parquet"):
        table = pq.read_table(path)
        executed = np.stack(table[schema.EXECUTED].to_numpy()) + np.float32(0.25)
        place = table.column_names.index(schema.EXECUTED)
        column = type(table[schema.EXECUTED].chunk(0)).from_arrays(executed.ravel(), executed.shape[1])
        pq.write_table(table.set_column(place, table.schema.field(place), column), path)
    return root


def _wanted(root: Path, row: int, past: int, horizon: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States before a row, executed actions and labels around it, and what is in its episode: one by one."""
    table = pq.read_table(root / "data").sort_by("index")
    episode, columns = table["episode_index"].to_pylist(), (schema.EXECUTED, schema.ACTION, schema.STATE)
    executed, action, state = (np.stack(table[key].to_numpy()) for key in columns)
    own = [other for other, number in enumerate(episode) if number == episode[row]]
    steps = [row + step for step in range(-past, horizon)]
    inside = np.array([own[0] <= step <= own[-1] for step in steps])
    held = [min(max(step, own[0]), own[-1]) for step in steps]
    actions = [executed[at] if step < row else action[at] for step, at in zip(steps, held, strict=True)]
    return state[held[:past]], np.stack(actions), inside


def _batches(dataset: Any, workers: int) -> Any:
    context = {"multiprocessing_context": "spawn"} if workers else {}
    return torch.utils.data.DataLoader(dataset, batch_size=7, num_workers=workers, **context)


@pytest.mark.parametrize(("shape", "episodes", "workers"), [(0, None, 1), (1, [3], 0), (2, [1, 4], 0)], ids=str)
def test_every_window_is_that_of_the_files(
    make_toy_policy: MakePolicy, corrected_root: Path, shape: int, episodes: list[int] | None, workers: int
) -> None:
    policy, _, _, dataset = make_toy_policy("dp3_adaptive", corrected_root, episodes=episodes, **SHAPES[shape])
    past, horizon = policy.config.n_action_history_steps, policy.config.horizon
    recorded, seen = policy.recorded, 0
    for batch in _batches(dataset, workers):  # spawned ones too
        rows = recorded.rows(batch["index"])
        before, valid = recorded.around(rows, range(-past, 0))
        ahead, exists = recorded.around(rows, range(horizon))
        actions = torch.cat([recorded.column(schema.EXECUTED, before), recorded.column(schema.ACTION, ahead)], dim=1)
        inside = torch.cat([valid, exists], dim=1)
        for place, row in enumerate(batch["index"].tolist()):
            states, wanted, wanted_inside = _wanted(corrected_root, row, past, horizon)
            assert np.array_equal(actions[place].numpy(), wanted)
            assert np.array_equal(inside[place].numpy(), wanted_inside)
            assert np.array_equal(recorded.column(schema.STATE, before)[place].numpy(), states)
            seen += 1
    assert seen == len(dataset)


def test_files_of_some_episodes_are_enough(toy_root: Path, tmp_path: Path) -> None:
    """As after a download of `--dataset.episodes`: rows are told by their index, not by their place."""
    meta = LeRobotDataset(REPO_ID, root=toy_root).meta
    table = pq.read_table(toy_root / "data").sort_by("index")
    kept = [row for row, episode in enumerate(table["episode_index"].to_pylist()) if episode in (2, 4)]
    (tmp_path / "data").mkdir()
    pq.write_table(table.take(kept), tmp_path / "data" / "a.parquet")
    meta.root = tmp_path
    recorded = read_recorded_rows(meta)
    index = torch.tensor(kept)
    actions = np.stack(table[schema.ACTION].to_numpy())
    assert np.array_equal(recorded.column(schema.ACTION, recorded.rows(index)).numpy(), actions[kept])
    missing = next(row for row in range(len(table)) if row not in kept)
    with pytest.raises(ConfigurationError, match=f"index {missing}"):
        recorded.rows(torch.tensor([missing]))
    with pytest.raises(ConfigurationError, match=f"index {len(table) + 5}"):
        recorded.rows(torch.tensor([len(table) + 5]))


def test_an_episode_of_one_row_is_all_its_window() -> None:
    columns = {INDEX: np.arange(3), EPISODE: np.array([0, 1, 2]), "value": np.array([5.0, 6.0, 7.0])}
    recorded = RecordedRows(columns)
    around, inside = recorded.around(recorded.rows(torch.tensor([[1]])), range(-2, 2))
    assert recorded.column("value", around).tolist() == [[6.0] * 4]
    assert inside.tolist() == [[False, False, True, False]]


def test_a_batch_of_another_dataset_is_refused(
    make_toy_policy: MakePolicy, toy_root: Path, adaptive_toy_root: Path
) -> None:
    policy, before, _, dataset = make_toy_policy("dp3_adaptive", toy_root, **SHAPES[0])
    other = LeRobotDataset(REPO_ID, root=adaptive_toy_root)
    batches = [before(torch.utils.data.default_collate([each[row] for row in (3, 9)])) for each in (other, dataset)]
    with pytest.raises(ConfigurationError, match="does not belong to the dataset"):
        policy.forward(batches[0])
    assert torch.isfinite(policy.forward(batches[1])[0])


def test_a_batch_without_its_observed_steps_is_refused(make_toy_policy: MakePolicy, toy_root: Path) -> None:
    policy, before, *_ = make_toy_policy("dp3_adaptive", toy_root, **SHAPES[2])
    single = LeRobotDataset(REPO_ID, root=toy_root)
    with pytest.raises(ConfigurationError, match=r"(?s)observed steps.*1 steps.*n_obs_steps=2.*delta_timestamps"):
        policy.forward(before(torch.utils.data.default_collate([single[row] for row in (3, 9)])))


def test_an_augmentation_that_the_checkpoints_processor_lacks_is_refused(
    make_toy_policy: MakePolicy, toy_root: Path
) -> None:
    """LeRobot loads the processor as it was saved, whatever --policy.augmentation_* say."""
    policy, before, _, dataset = make_toy_policy("dp3_adaptive", toy_root, **SHAPES[0])
    policy.config.augmentation_mirror = 0.5
    with pytest.raises(ConfigurationError, match="augmentation of a checkpoint cannot be changed"):
        policy.forward(before(torch.utils.data.default_collate([dataset[row] for row in (3, 9)])))


@pytest.mark.parametrize("shape", SHAPES[:2], ids=["keyframe", "dp3"])
def test_history_and_labels_are_mirrored_with_the_scene(
    make_toy_policy: MakePolicy, corrected_root: Path, shape: dict[str, Any]
) -> None:
    """What is looked up equals what the same pipeline makes of a whole window, draw for draw."""
    policy, before, _, dataset = make_toy_policy("dp3_adaptive", corrected_root, **shape, augmentation_mirror=0.5)
    past, horizon = policy.config.n_action_history_steps, policy.config.horizon
    batch = torch.utils.data.default_collate([dataset[row] for row in range(0, 40, 3)])
    whole = {key: value.clone() if isinstance(value, torch.Tensor) else value for key, value in batch.items()}
    wanted = [_wanted(corrected_root, row, past, horizon) for row in batch["index"].tolist()]
    whole[schema.ACTION] = torch.from_numpy(np.stack([actions for _, actions, _ in wanted]))
    before_it = torch.from_numpy(np.stack([states for states, *_ in wanted]))
    whole[schema.POINT_CLOUD] = batch[schema.POINT_CLOUD][:, None]
    whole[schema.STATE] = torch.cat([before_it, batch[schema.STATE][:, None]], dim=1)
    prepared = []
    for each in (whole, batch):
        torch.manual_seed(4)
        prepared.append(before(each))
    window, labels, _ = policy.training_window(prepared[1])
    assert torch.equal(torch.cat([window.history, labels], dim=1), prepared[0][schema.ACTION])
    observed = window.observations[schema.STATE]
    assert torch.equal(observed, prepared[0][schema.STATE][:, -observed.shape[1] :])
