"""Episodes that ran out of key frames teach no standing still; a fine-tuning on other motions warns."""

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
from lerobot_policy_adamanip.common.motion_clusters import demonstrated_motions
from lerobot_policy_adamanip.common.recorded_rows import EPISODE, INDEX, IS_LABEL, read_recorded_rows
from lerobot_policy_adamanip.dp3_adaptive import modeling_dp3_adaptive, training_windows

MakeTiny = Callable[..., tuple[Any, ...]]
END = 10
"""Row of the first episode's final observation."""


@pytest.fixture
def make_unfinished(make_tiny: MakeTiny, monkeypatch: pytest.MonkeyPatch) -> MakeTiny:
    """As `make_tiny`, on a dataset whose first episode did not succeed."""

    def read(dataset_meta: Any) -> Any:
        recorded = read_recorded_rows(dataset_meta)
        recorded._on(torch.device("cpu"))[IS_LABEL][END] = False
        return recorded

    monkeypatch.setattr(training_windows, "read_recorded_rows", read)
    return make_tiny


def _losses(policy: Any, batch: dict[str, Any]) -> Any:
    torch.manual_seed(3)
    return policy.forward(batch, reduction="none")[0]


@pytest.mark.parametrize("head", ["diffusion", "anchors"])
def test_the_last_row_of_an_unfinished_episode_has_no_label(
    make_unfinished: MakeTiny, heads: dict[str, Any], batch_of: Any, head: str
) -> None:
    policy, before, _, dataset = make_unfinished(**heads[head], tcp_relative=False)
    policy.eval()
    each = _losses(policy, batch_of(dataset, before, END, 3))
    assert each[0] == 0
    assert each[1] > 0
    _, _, is_label = policy.training_window(batch_of(dataset, before, END - 2, END + 2))
    assert is_label[0].tolist() == ([True, True] + [False] * 2)[: policy.config.horizon]
    assert is_label[1].all()


@pytest.mark.parametrize("head", ["diffusion", "anchors"])
def test_the_last_row_of_a_success_is_learnt(
    make_tiny: MakeTiny, heads: dict[str, Any], batch_of: Any, head: str
) -> None:
    policy, before, _, dataset = make_tiny(**heads[head])
    assert (_losses(policy.eval(), batch_of(dataset, before, END, 3)) > 0).all()


def test_the_files_say_which_episodes_ended_without_success(tmp_path: Path) -> None:
    pose = np.array([0.5, 0, 0.7, 1, 0, 0, 0, 1, 0, 0], np.float32)
    columns = {INDEX: range(5), EPISODE: [0, 0, 1, 1, 1], schema.STATE: [pose] * 5, schema.ACTION: [pose] * 5}
    outcome = {schema.DONE: [False, True, False, True, False], schema.SUCCESS: [False, True, False, False, True]}
    (tmp_path / "data").mkdir()
    pq.write_table(pa.table({**columns, **outcome}), tmp_path / "data" / "a.parquet")
    for told, labels in ((outcome, [True, True, True, False, True]), ({schema.SUCCESS: 0}, [True] * 5)):
        recorded = read_recorded_rows(SimpleNamespace(root=tmp_path, features=[*columns, *told]))
        assert recorded.column(IS_LABEL, torch.arange(5)).tolist() == labels
        assert len(demonstrated_motions(recorded)) == sum(labels)


def test_fine_tuning_on_other_motions_warns(
    make_tiny: MakeTiny,
    heads: dict[str, Any],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    policy, *_, dataset = make_tiny(**heads["anchors"])
    policy.save_pretrained(tmp_path)
    again = type(policy).from_pretrained(tmp_path, dataset_meta=dataset.meta)
    assert "spreads from every anchor" not in caplog.text
    assert torch.equal(again.model.anchors, policy.model.anchors)
    monkeypatch.setattr(modeling_dp3_adaptive, "demonstrated_motions", lambda rows: demonstrated_motions(rows) + 1.0)
    type(policy).from_pretrained(tmp_path, dataset_meta=dataset.meta)
    assert "spreads from every anchor" in caplog.text
