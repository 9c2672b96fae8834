"""LeRobot's own command deletes, splits and merges our data, mended here or patched there."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lerobot
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from demos_helpers import fakes, make_spec, patiently
from lerobot.datasets import aggregate, dataset_tools

from lerobot_adamanip import schema
from lerobot_adamanip.demos.collect import collect
from lerobot_adamanip.demos.editing.selection import selection_path
from lerobot_adamanip.demos.editing.source import Source
from lerobot_adamanip.demos.loading import read_back
from lerobot_adamanip.demos.merge import merge
from lerobot_adamanip.lerobot_editing import mend

ROOT = Path(__file__).resolve().parents[1]
UPSTREAM = ROOT / "docs" / "upstream"
MEND = "--discover_packages_path=lerobot_adamanip.lerobot_editing"
DELETED = (1, 4)


@pytest.fixture(autouse=True)
def _lerobot_as_before() -> Iterator[None]:
    mend.restore()
    yield
    mend.restore()


def command(*arguments: str, mended: bool = True) -> subprocess.CompletedProcess[str]:
    """Runs `lerobot-edit-dataset` itself."""
    words = [str(Path(sys.executable).with_name("lerobot-edit-dataset")), *([MEND] if mended else []), *arguments]
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path, "HF_HUB_OFFLINE": "1"}
    return subprocess.run(words, capture_output=True, text=True, check=False, env=environment)


def operation(kind: str, **options: Any) -> list[str]:
    """Returns the options of an operation."""
    given = [f"--operation.{name}={json.dumps(value)}" for name, value in options.items()]
    return [f"--operation.type={kind}", *given]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with pictures. Not to be written to."""
    root = tmp_path_factory.mktemp("whole") / "dataset"
    collect(root, make_spec(), fakes(), patiently())
    return root


@pytest.fixture(scope="module")
def edited(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command made of it: ``deleted``, ``split/train``, ``split/val`` and ``merged`` from both."""
    folder = tmp_path_factory.mktemp("edited")
    source = ["--repo_id=local/whole", f"--root={whole}"]
    delete = operation("delete_episodes", episode_indices=list(DELETED))
    split = operation("split", splits={"train": 0.5, "val": 0.5})
    roots = [str(folder / "split" / name) for name in ("train", "val")]
    parts = operation("merge", repo_ids=["local/train", "local/val"], roots=roots)
    for arguments in (
        [*source, "--new_repo_id=local/deleted", f"--new_root={folder / 'deleted'}", *delete],
        [*source, f"--new_root={folder / 'split'}", *split],
        ["--new_repo_id=local/merged", f"--new_root={folder / 'merged'}", *parts],
    ):
        done = command(*arguments)
        assert done.returncode == 0, done.stderr[-3000:]
    return folder


def rows(root: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(sorted((root / "data").glob("*/*.parquet"))).sort_by("index")
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


CASES = {
    "deleted": [0, 2, 3, 5],
    "split/train": [0, 1, 2],
    "split/val": [3, 4, 5],
    "merged": [0, 1, 2, 3, 4, 5],
}
"""Dataset -> episodes of the whole that it holds."""


@pytest.mark.parametrize("name", CASES)
def test_the_command_keeps_rows_and_what_it_does_not_know_of(whole: Path, edited: Path, name: str) -> None:
    made, chosen = edited / name, CASES[name]
    read_back(made)
    before, after = rows(whole), rows(made)
    kept = np.isin(before["episode_index"], chosen)
    for key, values in before.items():
        if key not in ("index", "episode_index"):
            np.testing.assert_array_equal(after[key], values[kept], err_msg=key)
    old, new = Source.open(whole).own_columns, Source.open(made).own_columns
    assert set(new.column_names) == set(old.column_names)
    for column in old.column_names:
        assert new[column].to_pylist() == [old[column][index].as_py() for index in chosen], column
    stats = json.loads((made / "meta" / "stats.json").read_text())
    for key in (schema.STATE, schema.ACTION):
        values = rows(made)[key]
        np.testing.assert_allclose(stats[key]["min"], values.min(axis=0), rtol=1e-5)
        np.testing.assert_allclose(stats[key]["mean"], values.mean(axis=0), atol=1e-5)
    assert (made / "meta" / "cameras.json").exists()


def test_parts_made_by_lerobot_find_together_in_our_merge(whole: Path, edited: Path, tmp_path: Path) -> None:
    merged = merge([edited / "split" / "val", edited / "split" / "train"], tmp_path / "again")
    assert (merged.parts_of_one, merged.whole) == (True, True)
    before, after = rows(whole), rows(tmp_path / "again")
    for key, values in before.items():
        np.testing.assert_array_equal(after[key], values, err_msg=key)
    for name in ("collection.json", "attempts.jsonl", "cameras.json"):
        assert (tmp_path / "again" / "meta" / name).read_bytes() == (whole / "meta" / name).read_bytes()
    assert selection_path(edited / "deleted").exists()


def test_merged_files_have_the_types_of_recorded_ones(whole: Path, edited: Path) -> None:
    (cloud,) = (
        pq.read_schema(path).field(schema.POINT_CLOUD) for path in (edited / "merged" / "data").rglob("*.parquet")
    )
    (recorded,) = (pq.read_schema(path).field(schema.POINT_CLOUD) for path in (whole / "data").rglob("*.parquet"))
    assert cloud.type == recorded.type
    assert pq.read_metadata(next((edited / "merged" / "data").rglob("*.parquet"))).num_row_groups == 6


@pytest.mark.nightly  # whether LeRobot still needs the mend
def test_without_the_mend_the_command_fails(whole: Path, tmp_path: Path) -> None:
    """Once it does not, the mend can go."""
    delete = operation("delete_episodes", episode_indices=[1])
    source = ["--repo_id=local/whole", f"--root={whole}"]
    done = command(*source, "--new_repo_id=local/x", f"--new_root={tmp_path / 'x'}", *delete, mended=False)
    assert done.returncode != 0
    assert "has no attribute 'v'" in done.stderr


def test_a_lerobot_it_was_not_tested_with_stays_as_it_is(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    changes = [(lerobot, "__version__", "0.6.2"), (mend, "TESTED", {"0.6.1": "0" * 16})]
    for target, name, value in changes:
        with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
            patch.setattr(target, name, value)
            caplog.clear()
            assert not mend.apply()
            assert "stays as it is" in caplog.text
        assert aggregate.pd is pd is dataset_tools.pd
    assert mend.apply()
    assert mend.apply()
    assert aggregate.pd is not pd
    mend.restore()
    assert aggregate.pd is pd is dataset_tools.pd
    assert aggregate.finalize_aggregation.__module__ == aggregate.__name__
    assert not hasattr(aggregate.finalize_aggregation, "__wrapped__")


def test_frames_without_arrays_are_written_as_lerobot_writes_them(tmp_path: Path) -> None:
    frame = pd.DataFrame({"episode_index": [0, 0, 1], "x": [1.0, 2.0, 3.0], "v": [np.ones(2, np.float32)] * 3})
    aggregate.to_parquet_one_row_group_per_episode(frame, tmp_path / "stock.parquet")
    mend.write_rows(frame, tmp_path / "mended.parquet")
    assert (tmp_path / "stock.parquet").read_bytes() == (tmp_path / "mended.parquet").read_bytes()


# Upstream ---------------------------------------------------------------------------------------------------------


def documented() -> tuple[str, list[str]]:
    """The reproduction, and what it prints without the patch and with it."""
    text = (UPSTREAM / "lerobot-edit-array-columns.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    return code, re.findall(r"```text\n(.*?)```", text, re.DOTALL)


@pytest.mark.nightly
@pytest.mark.parametrize("patched", [False, True])
def test_the_patch_applies_and_mends_what_the_reproduction_shows(tmp_path: Path, patched: bool) -> None:
    code, (failing, working) = documented()
    shutil.copytree(Path(lerobot.__file__).parent, tmp_path / "src" / "lerobot", ignore=shutil.ignore_patterns("__py*"))
    if patched:
        change = (UPSTREAM / "lerobot-edit-array-columns.patch").read_text(encoding="utf-8")
        for arguments in (["--check"], []):
            subprocess.run(["git", "apply", *arguments, "-"], input=change, text=True, check=True, cwd=tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "src"), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == (working if patched else "")
    for line in () if patched else failing.splitlines():
        assert line in done.stderr


def test_the_patch_is_against_the_version_that_is_mended() -> None:
    text = (UPSTREAM / "lerobot-edit-array-columns.md").read_text(encoding="utf-8")
    (version,) = mend.TESTED
    assert f"`lerobot` {version}" in text
