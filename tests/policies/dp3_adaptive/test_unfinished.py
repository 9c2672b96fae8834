"""An episode's final observation teaches no standing still; a fine-tuning on other motions warns."""

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
from lerobot_policy_adamanip.dp3_adaptive import modeling_dp3_adaptive

MakeTiny = Callable[..., tuple[Any, ...]]


@pytest.mark.parametrize("preset", ["fast", "diffusion", "dp3"])
def test_the_last_row_of_an_episode_has_no_label(make_tiny: MakeTiny, batch_of: Any, preset: str) -> None:
    policy, before, _, dataset = make_tiny(preset=preset)
    policy.eval()
    end = next(row for row in range(len(dataset)) if dataset[row][schema.DONE])
    each, _ = policy.forward(batch_of(dataset, before, end, 3), reduction="none")
    assert each[0] == 0
    assert each[1] > 0
    _, _, is_label = policy.training_window(batch_of(dataset, before, end - 2, end + 2))
    assert is_label[0].tolist() == ([True, True] + [False] * 2)[: policy.config.horizon]
    assert is_label[1].all()


def test_the_files_say_where_episodes_end(tmp_path: Path) -> None:
    pose = np.array([0.5, 0, 0.7, 1, 0, 0, 0, 1, 0, 0.3], np.float32)
    columns = {INDEX: range(5), EPISODE: [0, 0, 1, 1, 1], schema.STATE: [pose] * 5, schema.ACTION: [pose] * 5}
    ends = {schema.DONE: [False, True, False, True, True]}
    (tmp_path / "data").mkdir()
    pq.write_table(pa.table({**columns, **ends}), tmp_path / "data" / "a.parquet")
    for extra, labels in ((ends, [True, False, True, False, False]), ({}, [True] * 5)):
        recorded = read_recorded_rows(SimpleNamespace(root=tmp_path, features=[*columns, *extra]))
        assert recorded.column(IS_LABEL, torch.arange(5)).tolist() == labels
        motions, openings = demonstrated_motions(recorded)
        torch.testing.assert_close(motions, torch.tensor([0.0] * 6 + [0.3]).expand(sum(labels), 7))
        assert openings.tolist() == [np.float32(0.3)] * sum(labels)


def test_fine_tuning_on_other_motions_warns(
    make_tiny: MakeTiny, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, *_, dataset = make_tiny(preset="fast")
    policy.save_pretrained(tmp_path)
    again = type(policy).from_pretrained(tmp_path, dataset_meta=dataset.meta)
    assert "spreads from every anchor" not in caplog.text
    assert torch.equal(again.model.motions.anchors, policy.model.motions.anchors)
    other = demonstrated_motions(policy._windows.recorded)[0] + 1.0
    monkeypatch.setattr(modeling_dp3_adaptive, "demonstrated_motions", lambda _: (other, other[:, 6]))
    type(policy).from_pretrained(tmp_path, dataset_meta=dataset.meta)
    assert "spreads from every anchor" in caplog.text
