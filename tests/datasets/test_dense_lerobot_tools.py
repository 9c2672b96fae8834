"""LeRobot's own tools on datasets at control rate, as they are installed: editing, loading and viewing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demos_helpers import InThisProcess
from dense_episodes import FULL, collect_dense

from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.check.dataset import CAMERAS, check
from lerobot_adamanip.datasets.dataset import STATS, Dataset, open_dataset, read_back
from lerobot_adamanip.util import jobs

AFTER_EDITING = {("averaged", STATS), ("cameras", CAMERAS)}
"""What docs/checking.md says of every dataset that LeRobot's tools have edited."""


@pytest.fixture(scope="module")
def dense(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "WorkerPool", InThisProcess)
        return collect_dense(tmp_path_factory.mktemp("dense") / "demos", hidden_overrides={"locked": True}, **FULL)


def command(name: str, *arguments: str) -> None:
    """Runs a command of LeRobot in a process of its own, which sees nothing of this project."""
    environment = {**os.environ, "PYTHONPATH": "", "HF_HUB_OFFLINE": "1"}
    words = [str(Path(sys.executable).with_name(name)), *arguments]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr[-3000:]


def edit(kind: str, *arguments: str, **options: Any) -> None:
    values = [f"--operation.{name}={json.dumps(value)}" for name, value in options.items()]
    command("lerobot-edit-dataset", *arguments, f"--operation.type={kind}", *values)


def test_lerobot_loads_chunks_of_actions_as_policies_ask_for_them(dense: Path) -> None:
    fps, rows = 10, Dataset(dense).columns(Dataset(dense).episode(1))
    windows = {schema.ACTION: [step / fps for step in range(8)], schema.STATE: [-1 / fps, 0.0]}
    first = Dataset(dense).episode(1).start
    loaded = open_dataset(dense, delta_timestamps=windows, video_backend="pyav")[first + 1]
    np.testing.assert_array_equal(loaded[schema.ACTION][:2], rows[schema.ACTION][1:3])
    np.testing.assert_array_equal(loaded[schema.STATE], rows[schema.STATE][:2])
    assert loaded[schema.FRONT_IMAGE].shape[0] == 3


@pytest.mark.nightly
def test_lerobots_editor_keeps_rows_and_the_viewer_reads_them(dense: Path, tmp_path: Path) -> None:
    source, before = ["--repo_id=local/demos", f"--root={dense}"], Dataset(dense)
    edit(
        "delete_episodes", *source, f"--new_root={tmp_path / 'fewer'}", "--new_repo_id=local/fewer", episode_indices=[1]
    )
    edit("split", *source, f"--new_root={tmp_path / 'parts'}", splits={"train": 0.5, "val": 0.5})
    roots = [str(tmp_path / "parts" / name) for name in ("train", "val")]
    names = [f"local/{name}" for name in ("train", "val")]
    edit("merge", f"--new_root={tmp_path / 'all'}", "--new_repo_id=local/all", repo_ids=names, roots=roots)
    for name, kept in (("fewer", [0, 2, 3]), ("parts/train", [0, 1]), ("parts/val", [2, 3]), ("all", [0, 1, 2, 3])):
        read_back(tmp_path / name)
        assert {(each.kind, each.file) for each in check(tmp_path / name).findings} <= AFTER_EDITING
        after = Dataset(tmp_path / name)
        for number, origin in enumerate(kept):
            one, other = after.columns(after.episode(number)), before.columns(before.episode(origin))
            for key in {*before.features} & {*other} - {"index", "episode_index"}:
                np.testing.assert_array_equal(one[key], other[key], err_msg=key)
    shown = ["--repo-id=local/demos", f"--root={dense}", "--episode-index=1"]
    command("lerobot-dataset-viz", *shown, "--save=1", f"--output-dir={tmp_path}")
    assert len(list(tmp_path.glob("*.rrd"))) == 1
