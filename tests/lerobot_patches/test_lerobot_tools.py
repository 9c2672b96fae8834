"""LeRobot's own tools on our data, as they are installed: editing, streaming and the viewer."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import lerobot
import numpy as np
import pyarrow.parquet as pq
import pytest
from demos_helpers import fakes, make_spec, patiently

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.check.dataset import CAMERAS, check
from lerobot_adamanip.datasets.dataset import STATS, Dataset, open_dataset, read_back

ROOT = Path(__file__).resolve().parents[2]
UPSTREAM = ROOT / "docs" / "upstream"
DELETED = (1, 4)


def command(name: str, *arguments: str) -> None:
    """Runs a command of LeRobot in a process of its own, which sees nothing of this project."""
    words = [str(Path(sys.executable).with_name(name)), *arguments]
    environment = {**os.environ, "PYTHONPATH": "", "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr[-3000:]


def operation(kind: str, **options: Any) -> list[str]:
    """Returns the options of an operation."""
    given = [f"--operation.{name}={json.dumps(value)}" for name, value in options.items()]
    return [f"--operation.type={kind}", *given]


# A test of each: with pictures it takes minutes, for videos are encoded again.
KINDS = [False, pytest.param(True, marks=pytest.mark.nightly)]


@pytest.fixture(scope="module", params=KINDS, ids=lambda images: "pictures" if images else "clouds")
def whole(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """A dataset, with and without pictures. Not to be written to."""
    root = tmp_path_factory.mktemp("whole") / "dataset"
    collect(root, make_spec(observe_images=request.param), fakes(), patiently())
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
        command("lerobot-edit-dataset", *arguments)
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


@pytest.mark.nightly
@pytest.mark.parametrize("name", CASES)
def test_the_command_keeps_rows_and_statistics(whole: Path, edited: Path, name: str) -> None:
    made, chosen = edited / name, CASES[name]
    read_back(made)
    before, after = rows(whole), rows(made)
    kept = np.isin(before["episode_index"], chosen)
    for key, values in before.items():
        if key not in ("index", "episode_index"):
            np.testing.assert_array_equal(after[key], values[kept], err_msg=key)
    stats = json.loads((made / "meta" / "stats.json").read_text())
    for key in (schema.STATE, schema.ACTION):
        np.testing.assert_allclose(stats[key]["min"], after[key].min(axis=0), rtol=1e-5)
        np.testing.assert_allclose(stats[key]["mean"], after[key].mean(axis=0), atol=1e-5)
    found = {(each.kind, each.file) for each in check(made).findings if each.kind not in check(whole).counts}
    assert found <= {("averaged", STATS), ("cameras", CAMERAS)}  # the command drops it, see the next test


@pytest.mark.nightly
@pytest.mark.parametrize("name", CASES)
def test_the_command_drops_what_it_does_not_know_of(whole: Path, edited: Path, name: str) -> None:
    """docs/datasets.md says so. Once it keeps them, so can the page."""
    assert Dataset(whole).own_columns.column_names
    assert not Dataset(edited / name).own_columns.column_names
    assert not [path.name for path in (edited / name / "meta").iterdir() if path.name.startswith(("coll", "cam"))]


def test_lerobots_streaming_reader_gives_the_same_rows(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.datasets import streaming_dataset, video_utils
    from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset

    def decode(path: str, times: list[float], tolerance: float, **_: object) -> Any:
        return video_utils.decode_video_frames_pyav(path, times, tolerance)

    # It decodes by torchcodec alone, which wants libraries of FFmpeg that not every machine has.
    monkeypatch.setattr(streaming_dataset, "decode_video_frames_torchcodec", decode)
    plain = open_dataset(whole)
    streamed = {int(item["index"]): item for item in StreamingLeRobotDataset("local/whole", root=whole, shuffle=False)}
    assert sorted(streamed) == list(range(len(plain)))
    for index in range(len(plain)):
        for key in (schema.POINT_CLOUD, schema.STATE, schema.ACTION, schema.OUTCOME):
            assert (streamed[index][key] == plain[index][key]).all(), key


@pytest.mark.nightly
def test_lerobots_viewer_writes_a_recording(whole: Path, tmp_path: Path) -> None:
    source = ["--repo-id=local/whole", f"--root={whole}"]
    command("lerobot-dataset-viz", *source, "--episode-index=1", "--save=1", f"--output-dir={tmp_path}")
    (made,) = tmp_path.glob("*.rrd")
    assert made.stat().st_size > 1000


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
    if patched:
        its_test = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "--noconftest",
            "-p",
            "no:cacheprovider",
            str(tmp_path / "tests"),
        ]
        done = subprocess.run(its_test, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stdout[-2000:]
