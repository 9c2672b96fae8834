"""A small collection of the fake environment, and what it means for two datasets to be equal."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import demos_fake_env
import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq

from lerobot_adamanip.collection.collect import CollectOptions
from lerobot_adamanip.collection.record import Factories
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec
from lerobot_adamanip.datasets.encoding import preparing_session
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util import files
from lerobot_adamanip.util.jobs import JobResult, Session, WorkerPool

HERE = str(Path(__file__).parent)
ATTEMPTS = 25
OBJECTS = ("safe_000", "safe_001")
LATE = 0.5
_ENVIRONMENT = (
    "num_points", "image_size", "observe_images", "cloud_source", "poses", "mechanism_rules", "max_key_frames",
    "max_failed_tries", "hidden_overrides", "assets", "cameras",
)  # fmt: skip


def make_spec(**changes: Any) -> CollectionSpec:
    """A small collection, with changes of its or its environment's options."""
    environment = {"num_points": 8, "image_size": 64, "observe_images": True} | {
        k: changes.pop(k) for k in _ENVIRONMENT if k in changes
    }
    category = changes.pop("category", "safe")
    values = {"objects": OBJECTS, "episodes_per_object": 3, "late_starts": LATE, **changes}
    return CollectionSpec(EnvironmentOptions(category, objects=values["objects"][0], **environment), **values)


def fakes(**behaviour: Any) -> Factories:
    """Factories of the fake environment, which behaves as told."""
    return Factories(functools.partial(demos_fake_env.make_env, **behaviour), demos_fake_env.make_expert)


def corrected(**behaviour: Any) -> Factories:
    """As `fakes`, with a policy that is corrected."""
    made = fakes(**behaviour)
    return Factories(made.environment, made.expert, demos_fake_env.FakeActor)


def patiently(**options: Any) -> CollectOptions:
    """Many attempts, for an expert that fails often."""
    return CollectOptions(**{"max_attempts": ATTEMPTS, **options})


def same_bytes(first: Path, second: Path) -> None:
    """Asserts that two datasets are equal, byte for byte."""
    names = sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(second) for path in second.rglob("*") if path.is_file())
    for name in names:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


def another(root: Path, copy: Path) -> Path:
    """Copies a dataset so that it counts as another one: the same rows, with seeds of other scenes."""
    shutil.copytree(root, copy)
    for path in (copy / "meta" / "episodes").glob("*/*.parquet"):
        table = pq.read_table(path)
        place = table.column_names.index("seed")
        pq.write_table(table.set_column(place, table.field(place), pc.add(table["seed"], 1)), path)
    return copy


def same_content(first: Path, second: Path) -> None:
    """Asserts that two datasets hold the same rows, the same frames after decoding, and the same per-episode facts."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    tables = sorted(path.relative_to(first) for path in first.rglob("*.parquet"))
    assert tables == sorted(path.relative_to(second) for path in second.rglob("*.parquet"))
    for name in tables:
        assert pq.read_table(first / name).equals(pq.read_table(second / name)), name
    for name in ("meta/stats.json", "meta/info.json", "meta/cameras.json", "meta/collection.json"):
        assert json.loads((first / name).read_text()) == json.loads((second / name).read_text()), name
    one, other = (LeRobotDataset("local/x", root=root, video_backend="pyav") for root in (first, second))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a["observation.images.front"], b["observation.images.front"])


class InThisProcess:
    """Stands in for a pool of workers: runs the items in this process."""

    def __class_getitem__(cls, _: object) -> type[InThisProcess]:
        return cls

    def __init__(self, session: Session, count: int, **_: object) -> None:
        self._session = session

    def __enter__(self) -> InThisProcess:
        return self

    def __exit__(self, *_: object) -> None: ...

    def run(self, items: list[Any]) -> Iterator[JobResult[Any]]:
        with self._session() as work:
            for item in items:
                yield JobResult(item, work(item, lambda: None))


class Preparing(InThisProcess):
    """As `InThisProcess`, but processes prepare episodes for assembly."""

    def __class_getitem__(cls, item: object) -> Any:
        def made(session: Any, count: int, **options: Any) -> Any:
            kind = WorkerPool[Any] if session.func is preparing_session else InThisProcess
            return kind(session, count, **options)

        return made


class NoWorkers(InThisProcess):
    """Stands in for a pool where nothing may be left to record."""

    def run(self, items: list[Any]) -> Iterator[JobResult[Any]]:
        assert items == []
        return iter(())


KILLED = 9


def dies(run: Callable[[], object], ready: Callable[[], object]) -> bool:
    """Runs something in a forked process, which has everything imported; returns whether it was killed."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            ready()
            run()
            status = 0
        finally:
            os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in (0, KILLED, -signal.SIGKILL), status
    return status != 0


def dies_at(run: Callable[[], object], point: str) -> bool:
    """As `dies`: the process ends without a word when it first passes a crash point of `files`."""

    def ready() -> None:
        files.on_crash_point = lambda passed: os._exit(KILLED) if passed == point else None

    return dies(run, ready)


def finished_shards(root: Path) -> dict[str, bytes]:
    """Name -> content of each episode's file, before the dataset is written."""
    return {path.name: path.read_bytes() for path in CollectionPaths(root).episodes.glob("*.safetensors")}
