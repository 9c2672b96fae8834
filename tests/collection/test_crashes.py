"""Nothing that was finished is ever lost: a process killed at any moment leaves what the same call completes."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demos_fake_env import make_env, make_expert
from demos_helpers import InThisProcess, dies, dies_at, finished_shards, make_spec, same_bytes

from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.collection.record import Factories
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.util import files, jobs
from lerobot_adamanip.util.errors import DatasetError

SPEC = make_spec(episodes_per_object=2, image_size=16, keep_failed=True, seed=1)
OPTIONS = CollectOptions(max_attempts=25)
FACTORIES = Factories(make_env, make_expert)
RANDOM_MOMENTS = 20


pytestmark = pytest.mark.usefixtures("in_process")


def run(root: Path) -> None:
    collect(root, SPEC, FACTORIES, OPTIONS)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a collection that was never interrupted, and nothing else."""
    root = tmp_path_factory.mktemp("whole") / "dataset"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "WorkerPool", InThisProcess)
        run(root)
    assert sorted(path.name for path in root.parent.iterdir()) == ["dataset", "dataset-failed"]
    return root


def same_collection(whole: Path, root: Path) -> None:
    same_bytes(whole.parent, root.parent)


@contextmanager
def nothing_lost(root: Path) -> Iterator[None]:
    """Every episode file that is there before is there after, unless the dataset is."""
    before = finished_shards(root)
    yield
    if root.exists():
        Dataset(root)
    else:
        after = finished_shards(root)
        assert all(after.get(name) == content for name, content in before.items())


def test_a_death_at_each_point_in_turn_loses_nothing(tmp_path: Path, whole: Path) -> None:
    root = tmp_path / "dataset"
    for name in files.CRASH_POINTS:
        with nothing_lost(root):
            assert dies_at(lambda: run(root), name) or root.exists()
    run(root)
    same_collection(whole, root)


@pytest.mark.nightly
def test_twenty_random_deaths_lose_nothing(tmp_path: Path, whole: Path) -> None:
    begin = time.monotonic()
    assert not dies(lambda: run(tmp_path / "timed" / "dataset"), (tmp_path / "timed").mkdir)
    lasts = time.monotonic() - begin
    rng, deaths = np.random.default_rng(0), 0
    for number in range(RANDOM_MOMENTS):
        root = tmp_path / str(number) / "dataset"
        root.parent.mkdir()
        seconds = float(rng.uniform(0.0, lasts))

        def ready(seconds: float = seconds) -> None:
            threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGKILL)).start()

        with nothing_lost(root):
            deaths += dies(lambda: run(root), ready)  # noqa: B023 (run at once)
        run(root)
        same_collection(whole, root)
    assert deaths >= RANDOM_MOMENTS // 2


def test_shards_are_kept_if_the_dataset_cannot_be_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a faulty disk did to it between writing and reading is noticed while there is still something to mend it."""
    root = tmp_path / "dataset"

    def spoil(point: str) -> None:
        if point == "dataset synced":
            for folder in tmp_path.glob("*.partial/dataset"):
                (path,) = (folder / "videos").glob("*/*/*.mp4")
                path.write_bytes(path.read_bytes()[:-300])

    monkeypatch.setattr(files, "on_crash_point", spoil)
    with pytest.raises(DatasetError, match="damaged"):
        run(root)
    assert not root.exists()
    assert len(finished_shards(root)) == 4
    monkeypatch.setattr(files, "on_crash_point", None)
    run(root)
    assert len(Dataset(root)) == 4


def test_shards_are_kept_if_a_finished_dataset_is_found_damaged(tmp_path: Path, whole: Path) -> None:
    root = tmp_path / "dataset"
    assert dies_at(lambda: run(root), "dataset in place")
    (path,) = (root / "data").glob("*/*.parquet")
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(DatasetError, match="damaged"):
        run(root)
    assert len(finished_shards(root)) == 4


def test_everything_is_synced_before_anything_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The law behind the others, which only a power cut would show: files, folders, rename, parent, removal."""
    root, order = tmp_path / "dataset", list[tuple[str, Path]]()
    sync, replace, remove = os.fsync, os.replace, files.shutil.rmtree

    def fsync(descriptor: int) -> None:
        order.append(("sync", Path(os.readlink(f"/proc/self/fd/{descriptor}"))))
        sync(descriptor)

    def rename(source: Any, target: Any) -> None:
        order.append(("rename", Path(target)))
        replace(source, target)

    def rmtree(folder: Any, **options: Any) -> None:
        order.append(("remove", Path(folder)))
        remove(folder, **options)

    monkeypatch.setattr(files.os, "fsync", fsync)
    monkeypatch.setattr(files.os, "replace", rename)
    monkeypatch.setattr(files.shutil, "rmtree", rmtree)
    run(root)
    moved = order.index(("rename", root))
    building = CollectionPaths(root).building
    synced = {path for what, path in order[:moved] if what == "sync"}
    for path in root.rglob("*"):
        assert building / path.relative_to(root) in synced, path
    assert building in synced
    assert order[moved + 1] == ("sync", root.parent)
    gone = [
        place for place, (what, path) in enumerate(order) if what == "remove" and path.parent.name.endswith("partial")
    ]
    assert gone
    assert min(gone) > moved + 1
