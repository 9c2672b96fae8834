"""Collecting demonstrations: durable per episode, resumable, the same data whatever interrupts it."""

from __future__ import annotations

import contextlib
import fcntl
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot_adamanip.demos.assemble import assemble
from lerobot_adamanip.demos.collection import (
    CollectionPaths,
    CollectionSpec,
    EpisodeSpec,
    read_manifest,
    require_same,
    write_manifest,
)
from lerobot_adamanip.demos.pool import WorkerPool
from lerobot_adamanip.demos.shards import read_record
from lerobot_adamanip.demos.worker import Report
from lerobot_adamanip.errors import ConfigurationError, DatasetError

Listener = Callable[[str, int, int], None]
"""Told of progress: stage (``record``, ``record safe`` for a category's share, ``assemble``), episodes done, in all."""


@dataclass(frozen=True)
class CategorySummary:
    """A category's share of a dataset, and what this run did for it.

    Attributes:
        episodes: in the dataset.
        attempts: episodes the expert tried for them.
        mean_key_frames: of an episode.
        recorded: by this run.
        worker_seconds: spent on it by this run, all workers together.
    """

    episodes: int
    attempts: int
    mean_key_frames: float
    recorded: int
    worker_seconds: float

    @property
    def episodes_per_worker_minute(self) -> float:
        """Returns the rate of one worker."""
        return 60.0 * self.recorded / self.worker_seconds if self.recorded else 0.0


@dataclass(frozen=True)
class CollectSummary:
    """What a run of `collect` did.

    Attributes:
        root: of the dataset.
        episodes: in the dataset.
        recorded: by this run; the others were there already.
        attempts: episodes this run tried for them.
        seconds: this run took, from start to finished dataset.
        recording_seconds: of those, spent recording.
        expert_success_rate: successes over attempts of all episodes in the dataset.
        bytes: size of the dataset on disk.
        failures: lines about items that were given up; empty in a complete dataset.
        categories: by name, in the order of the dataset.
    """

    root: str
    episodes: int
    recorded: int
    attempts: int
    seconds: float
    recording_seconds: float
    expert_success_rate: float
    bytes: int
    failures: tuple[str, ...] = ()
    categories: dict[str, CategorySummary] = field(default_factory=dict)

    @property
    def episodes_per_minute(self) -> float:
        """Returns the rate of this run's recording."""
        return 60.0 * self.recorded / self.recording_seconds if self.recorded else 0.0


def collect(
    root: Path,
    options: CollectionSpec,
    *,
    workers: int = 1,
    repo_id: str | None = None,
    max_attempts: int = 5,
    allow_missing: bool = False,
    listener: Listener | None = None,
) -> CollectSummary:
    """Records the episodes that ``root`` still lacks and makes a LeRobotDataset of them all.

    Neither ``workers`` nor interruptions change the data. A complete dataset is left as it is.

    Args:
        root: of the dataset. Until it is complete, episodes are kept in ``<root>.partial``.
        options: what to collect.
        workers: processes, each with a simulator of its own.
        repo_id: written into the dataset card; ``local/<folder name>`` by default.
        max_attempts: seeds to try per episode until the expert succeeds.
        allow_missing: make a dataset even if some episodes were given up.
        listener: told of progress.

    Raises:
        DatasetError: if ``root`` holds something else, another collection of it is running, or episodes were given up.
        WorkerError: if a worker failed for good.
    """
    if workers < 1 or max_attempts < 1:
        raise ConfigurationError(
            "Too small.",
            got=f"workers = {workers}, max_attempts = {max_attempts}",
            allowed="1 or more",
            hint="--workers 2 --max-attempts 5",
        )
    begin = time.monotonic()
    folders = CollectionPaths(root.absolute())
    tell = listener or (lambda stage, done, total: None)
    if _is_complete(folders, options):
        folders.clean()
        return _summary(folders.root, options, [], begin=begin)
    with _prepared(folders, options):
        reports = _record(folders, options, workers, max_attempts, tell)
        recording = time.monotonic() - begin
        failures = tuple(_describe(report) for report in reports if not report.recorded)
        if failures and not allow_missing:
            raise DatasetError(
                f"{len(failures)} episodes could not be recorded.",
                got="\n           ".join(failures),
                allowed=f"a success within {max_attempts} attempts each",
                hint="the same command with a larger --max-attempts, or --allow-missing to do without",
            )
        shards = [path for item in options.items() if (path := folders.episodes / item.file_name).exists()]
        assemble(folders, options, shards, repo_id or f"local/{root.name}", lambda i, n: tell("assemble", i, n))
        summary = _summary(folders.root, options, reports, begin=begin, recording=recording, failures=failures)
        folders.clean()
    return summary


def _is_complete(folders: CollectionPaths, options: CollectionSpec) -> bool:
    if folders.manifest.exists():
        require_same(read_manifest(folders.manifest), options, folders.root)
        return True
    if folders.root.is_file() or (folders.root.is_dir() and any(folders.root.iterdir())):
        raise DatasetError(
            "There is something else at the root of the dataset.",
            got=folders.root,
            allowed="a folder that does not exist, is empty, or was made by `adamanip collect`",
            hint="another --root",
        )
    return False


@contextlib.contextmanager
def _prepared(folders: CollectionPaths, options: CollectionSpec) -> Iterator[None]:
    """Makes the partial folder, or checks the one there, and keeps other collections out of it meanwhile."""
    folders.episodes.mkdir(parents=True, exist_ok=True)
    with open(folders.partial / "lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise DatasetError(
                "Another collection is at work here.",
                got=folders.partial,
                allowed="one at a time",
                hint="--workers 2 for more speed, or another --root",
            ) from error
        if any(folders.episodes.glob("*.safetensors")) and folders.partial_manifest.exists():
            require_same(read_manifest(folders.partial_manifest), options, folders.partial)
        else:
            write_manifest(folders.partial_manifest, options)
        yield


def _record(
    folders: CollectionPaths,
    options: CollectionSpec,
    workers: int,
    max_attempts: int,
    tell: Callable[[str, int, int], None],
) -> list[Report]:
    items = options.items()
    missing = [item for item in items if not _is_recorded(folders, item)]
    # Category by category, because changing it costs a worker seconds. The dataset's order is another one.
    order = {name: place for place, name in enumerate(dict.fromkeys(map(options.category_of, options.objects)))}
    missing.sort(key=lambda item: order[options.category_of(item.object_id)])
    totals = Counter(options.category_of(item.object_id) for item in items)
    done = totals - Counter(options.category_of(item.object_id) for item in missing)
    for category, total in totals.items():
        tell(f"record {category}", done[category], total)
    reports = []
    with WorkerPool(min(workers, max(1, len(missing))), options, folders.episodes, max_attempts) as pool:
        for report in pool.run(missing):
            reports.append(report)
            assert report.item is not None
            category = options.category_of(report.item.object_id)
            done[category] += report.recorded
            tell(f"record {category}", done[category], totals[category])
            tell("record", done.total(), len(items))
    return reports


def _is_recorded(folders: CollectionPaths, item: EpisodeSpec) -> bool:
    path = folders.episodes / item.file_name
    return path.exists() and read_record(path) is not None


def _describe(report: Report) -> str:
    assert report.item is not None
    reasons = "; ".join(f"seed {failure['seed']}: {failure['reason']}" for failure in report.failures)
    return f"{report.item.object_id}, episode {report.item.slot}: {reasons}"


def _summary(
    root: Path,
    options: CollectionSpec,
    reports: list[Report],
    *,
    begin: float,
    recording: float = 0.0,
    failures: tuple[str, ...] = (),
) -> CollectSummary:
    from lerobot_adamanip.demos.loading import episode_table

    rows = episode_table(root).select(["object_id", "attempts", "length"]).to_pylist()
    tried = [int(row["attempts"]) for row in rows]
    return CollectSummary(
        root=str(root),
        episodes=len(tried),
        recorded=sum(report.recorded for report in reports),
        attempts=sum(report.attempts for report in reports),
        seconds=time.monotonic() - begin,
        recording_seconds=recording,
        expert_success_rate=len(tried) / sum(tried) if tried else 0.0,
        bytes=sum(path.stat().st_size for path in root.rglob("*") if path.is_file()),
        failures=failures,
        categories=_by_category(options, rows, reports),
    )


def _by_category(
    options: CollectionSpec, rows: list[dict[str, Any]], reports: list[Report]
) -> dict[str, CategorySummary]:
    summaries = {}
    for category in dict.fromkeys(options.category_of(name) for name in options.objects):
        mine = [row for row in rows if options.category_of(row["object_id"]) == category]
        done = [each for each in reports if each.item and options.category_of(each.item.object_id) == category]
        summaries[category] = CategorySummary(
            episodes=len(mine),
            attempts=sum(int(row["attempts"]) for row in mine),
            mean_key_frames=sum(int(row["length"]) for row in mine) / max(1, len(mine)),
            recorded=sum(each.recorded for each in done),
            worker_seconds=sum(each.seconds for each in done),
        )
    return summaries
