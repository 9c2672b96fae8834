"""A repair keeps the episodes that `meta/info.json` counts, and moves away what a killed recorder has left."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from dense_helpers import STOPS, add, begun, dense_episode, dense_features, frames
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_adamanip import lerobot_patches
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.repair import repair
from lerobot_adamanip.hardware.features import recorded_features
from lerobot_adamanip.util import files

EPISODE = dense_episode(STOPS[:2])


class KilledError(Exception):
    """Stands for the end of the process: the folder is looked at as it is then."""


def die(*_: Any, **__: Any) -> Any:
    raise KilledError


def die_at(name: str) -> Callable[..., None]:
    write = files.write_atomically
    return lambda path, content: die() if path.name == name else write(path, content)


def durable(root: Path) -> Any:
    """A recording of our robot with one saved episode, and a second one whose rows are added."""
    dataset = begun(root)
    for _ in range(2):
        add(dataset, EPISODE)
        if not dataset.num_episodes:
            dataset.save_episode(parallel_encoding=False)
    return dataset


KILLS: dict[str, Callable[[pytest.MonkeyPatch, Any], object]] = {
    "in an episode": lambda patch, dataset: patch.setattr(dataset, "save_episode", die),
    "before its rows are whole": lambda patch, dataset: patch.setattr(dataset.writer, "close_writer", die),
    "before its videos": lambda patch, dataset: patch.setattr(dataset.writer, "_save_episode_video", die),
    "before its metadata": lambda patch, dataset: patch.setattr(dataset.meta, "save_episode", die),
    "before its metadata are whole": lambda patch, dataset: patch.setattr(dataset.meta, "_close_writer", die),
    "before its metadata are synced": lambda patch, dataset: patch.setattr(dataset.meta, "_sync_latest", die),
    "before it is counted": lambda patch, dataset: patch.setattr(files, "write_atomically", die_at("info.json")),
}


@pytest.fixture
def patched(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv(lerobot_patches.NO_PATCHES, raising=False)
    lerobot_patches.apply()
    yield
    lerobot_patches.restore()


@pytest.mark.usefixtures("patched")
@pytest.mark.parametrize("kill", KILLS)
def test_every_saved_episode_is_kept_and_recording_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kill: str
) -> None:
    dataset = durable(tmp_path / "recording")
    with monkeypatch.context() as patch:
        KILLS[kill](patch, dataset)
        with pytest.raises(KilledError):
            dataset.save_episode(parallel_encoding=False)
    root = Path(shutil.copytree(tmp_path / "recording", tmp_path / "killed"))  # as it is at this moment
    dataset.writer._lock.close()
    assert not check(root).clean
    done = repair(root)
    assert done.left == []
    assert done.backup.is_dir()
    assert check(root).findings == []
    assert repair(root).mended == []
    again = LeRobotDataset.resume("local/dense", root=root)
    add(again, EPISODE)
    again.save_episode(parallel_encoding=False)
    again.finalize()
    assert check(root).findings == []
    rows = pq.read_table(sorted((root / "data").glob("*/*.parquet")))[schema.ACTION].to_pylist()
    actions = [frame["action"] for frame in frames(EPISODE, recorded_features(dense_features()))]
    np.testing.assert_array_equal(np.array(rows, np.float32), np.concatenate([actions] * 2))


def test_what_no_recorder_of_ours_leaves_is_named_and_left_alone(finished: Path, tmp_path: Path) -> None:
    info, described = "meta/info.json", "meta/episodes/chunk-000/file-000.parquet"
    for name, said in (
        (info, "unreadable: meta/info.json"),
        (described, "counts 6 episodes, and meta/episodes describes 0"),
    ):
        root = Path(shutil.copytree(finished, tmp_path / Path(name).parent.name))
        (root / name).write_bytes((root / name).read_bytes()[:-20])
        before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
        done = repair(root)
        assert said in done.left[0]
        assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before
        assert not done.backup.exists()
