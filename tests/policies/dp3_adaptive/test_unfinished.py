"""Episodes that ran out of key frames teach no standing still; checkpoints say what their anchors do not know."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from lerobot_adamanip.contract import schema
from lerobot_policy_adamanip.common import demonstrations, motion_clusters
from lerobot_policy_adamanip.common.demonstrations import unfinished_ends

MakeTiny = Callable[..., tuple[Any, ...]]
END = 8
"""Row of the first episode's final observation."""
HEADS: list[dict[str, Any]] = [
    {"preset": "diffusion", "tcp_relative": False, "history_noise_std": 0.0},
    {"preset": "fast", "num_anchors": 6, "memory_dim": 16, "trunk_dim": 32, "n_action_history_steps": 4,
     "training_points": 24, "coarse_points": 32, "num_points": 48, "refinement_points": 16, "num_refinements": 0},
]  # fmt: skip


@pytest.fixture
def make_unfinished(make_tiny: MakeTiny, monkeypatch: pytest.MonkeyPatch) -> MakeTiny:
    """As `make_tiny`, on a dataset whose first episode did not succeed."""
    for module in (demonstrations, motion_clusters):
        monkeypatch.setattr(module, "unfinished_ends", lambda _: np.array([END]))
    return make_tiny


def _losses(policy: Any, batch: dict[str, Any], **options: Any) -> Any:
    torch.manual_seed(3)
    return policy.forward(batch, **options)[0]


def _with_label(policy: Any, batch: dict[str, Any], sample: int, step: int) -> None:
    """Gives the policy another label at a step of the horizon."""
    window, labels, real = policy.training_window(batch)
    labels = labels.clone()
    labels[sample, step, :3] += 0.3
    policy.training_window = lambda _: (window, labels, real)


@pytest.mark.parametrize("head", HEADS, ids=["diffusion", "anchors"])
def test_the_last_row_of_an_unfinished_episode_has_no_label(
    make_unfinished: MakeTiny, batch_of: Any, head: dict[str, Any]
) -> None:
    policy, before, _, dataset = make_unfinished(**head)
    policy.eval()
    assert int(dataset[END]["index"]) == END
    batch = batch_of(dataset, before, END, 3)
    each = _losses(policy, batch, reduction="none")
    assert each[0] == 0
    assert each[1] > 0
    mean = _losses(policy, batch)
    _with_label(policy, batch, 0, 0)
    if policy.config.head == "anchors":  # the U-Net sees what it is not to learn, so that its prediction may differ
        assert torch.equal(_losses(policy, batch), mean)
    assert torch.equal(_losses(policy, batch, reduction="none"), each)


def test_nor_has_it_one_where_it_ends_a_chunk(make_unfinished: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_unfinished(**HEADS[0])
    seen: list[torch.Tensor] = []
    loss = policy.head.loss
    policy.head.loss = lambda model, window, actions, real: seen.append(real) or loss(model, window, actions, real)
    policy.forward(batch_of(dataset, before, END - 2, END + 2))
    assert seen[0][0].tolist() == [True, True] + [False] * (policy.config.horizon - 2)
    assert seen[0][1].all()


@pytest.mark.parametrize("head", HEADS, ids=["diffusion", "anchors"])
def test_an_episode_that_succeeded_is_learnt_as_before(
    make_tiny: MakeTiny, batch_of: Any, head: dict[str, Any]
) -> None:
    policy, before, _, dataset = make_tiny(**head)
    policy.eval()
    assert (_losses(policy, batch_of(dataset, before, END, 3), reduction="none") > 0).all()


def _dataset(root: Path, **columns: list[Any]) -> Any:
    (root / "data").mkdir(parents=True)
    pq.write_table(
        pa.table({"index": list(range(len(next(iter(columns.values()))))), **columns}), root / "data/a.parquet"
    )
    return SimpleNamespace(root=root, features=["index", *columns])


def test_unfinished_ends_are_read_from_the_files(tmp_path: Path) -> None:
    done, success = [False, True, False, True, False], [False, True, False, False, True]
    assert unfinished_ends(_dataset(tmp_path / "a", **{schema.DONE: done, schema.SUCCESS: success})).tolist() == [3]
    assert not len(unfinished_ends(_dataset(tmp_path / "b", **{schema.SUCCESS: success})))  # does not tell
    assert not len(
        unfinished_ends(SimpleNamespace(root=tmp_path / "c", features=[schema.DONE, schema.SUCCESS, "index"]))
    )


def test_a_motion_that_was_not_sent_makes_no_anchor(tmp_path: Path) -> None:
    poses = np.tile(np.array([0.5, 0, 0.7, 1, 0, 0, 0, 1, 0, 0], np.float32), (3, 1))
    columns = {schema.STATE: list(poses), schema.ACTION: list(poses)}
    meta = _dataset(tmp_path / "a", **columns, **{schema.DONE: [False, False, True], schema.SUCCESS: [False] * 3})
    assert len(motion_clusters.demonstrated_motions(meta)) == 2


def test_fine_tuning_on_other_motions_warns(
    make_tiny: MakeTiny, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, *_, dataset = make_tiny(**HEADS[1])
    policy.save_pretrained(tmp_path / "checkpoint")
    again = type(policy).from_pretrained(tmp_path / "checkpoint", dataset_meta=dataset.meta)
    assert "spreads from every anchor" not in caplog.text
    assert torch.equal(again.model.anchors, policy.model.anchors)
    far = motion_clusters.demonstrated_motions(dataset.meta) + 1.0
    monkeypatch.setattr(motion_clusters, "demonstrated_motions", lambda _: far)
    type(policy).from_pretrained(tmp_path / "checkpoint", dataset_meta=dataset.meta)
    assert "spreads from every anchor" in caplog.text
