"""Collection of demonstrations: durable per episode, resumable, with the same data after any interruption."""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.assemble import Contents, assemble
from lerobot_adamanip.collection.partial import (
    Part,
    belongs,
    failed_attempts,
    given_up,
    is_own_partial,
    prepare_partial,
    require_finished,
)
from lerobot_adamanip.collection.ray_cluster import connected, require_usable
from lerobot_adamanip.collection.record import (
    Attempt,
    Factories,
    ItemOutcome,
    RecordingJob,
    recording_session,
    write_outcome,
    writing_session,
)
from lerobot_adamanip.collection.summary import CollectSummary, Results, summarize, summarize_part
from lerobot_adamanip.datasets.attempts import all_attempts, count
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, EpisodeSpec
from lerobot_adamanip.datasets.dataset import read_back
from lerobot_adamanip.datasets.manifest import Manifest
from lerobot_adamanip.datasets.output_folder import (
    COLLECTING,
    OutputFolder,
    lock_output,
    lock_path,
    owned_output,
    resolve_output,
)
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.shards import read_record
from lerobot_adamanip.util import files, jobs
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Listener = Callable[[str, int, int], None]
"""Progress callback: stage (``record``, ``record safe`` for one category, ``assemble``), finished and all episodes."""
_MIN_ROWS = 3
"""Minimum number of rows per episode."""


@dataclass(frozen=True)
class CollectOptions:
    """Options of a collection that do not change its data.

    Attributes:
        workers: processes with one simulator each, or actors of the cluster; 0 for one actor per CPU.
        worker_timeout: a worker without a heartbeat for this long is replaced; on a cluster, the limit per item [s].
        max_attempts: maximum number of seeds per episode.
        allow_missing: whether to make a dataset although some episodes were given up.
        repo_id: repository id in the dataset card; ``local/<folder name>`` by default.
        cluster: Ray cluster: ``HOST:PORT``, ``auto`` or ``local``; None for processes of this machine.
        insecure_cluster: whether to accept a cluster without a token.
        part: record only this part, and make no dataset; None for all episodes.
        adopt: root folders of parts to import first.
    """

    workers: int = 1
    worker_timeout: float = jobs.DEFAULT_TIMEOUT
    max_attempts: int = 5
    allow_missing: bool = False
    repo_id: str | None = None
    cluster: str | None = None
    insecure_cluster: bool = False
    part: Part | None = None
    adopt: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        require_repo_id(self.repo_id)
        if self.workers < (self.cluster is None) or self.max_attempts < 1 or not self.worker_timeout > 0:
            raise ConfigurationError(
                "An option is too small.",
                got=f"workers = {self.workers}, max_attempts = {self.max_attempts}, timeout = {self.worker_timeout}",
                allowed="1 or more, and a timeout above 0",
                hint="--workers 2 --max-attempts 5",
            )


def collect(
    root: Path,
    spec: CollectionSpec,
    factories: Factories,
    options: CollectOptions = CollectOptions(),
    listener: Listener = lambda stage, done, total: None,
) -> CollectSummary:
    """Records the episodes that ``root`` lacks and makes a LeRobotDataset of all episodes.

    Neither workers nor interruptions change the data. A complete dataset is not changed and may be read-only. Until
    then episodes are kept in ``<root>.partial``, which is removed only after the dataset has been read back.

    Args:
        root: root folder of the dataset.
        spec: specification of the collection.
        factories: factories of environments and experts.
        options: options that do not change the data.
        listener: progress callback.

    Raises:
        DatasetError: ``root`` has other content, another process collects there, or episodes were given up.
        WorkerError: a worker failed permanently.
    """
    begin = time.monotonic()
    if options.cluster is not None:
        require_usable(options.cluster, insecure=options.insecure_cluster)
    paths = CollectionPaths(resolve_output(root))

    def complete() -> CollectSummary:
        summary = summarize(paths.root, spec, [], seconds=time.monotonic() - begin, recording_seconds=0.0)
        return _with_all(summary, options)

    if paths.manifest.exists() and not (paths.partial.exists() or lock_path(paths.root).exists()):
        require_finished(paths.root, _manifest(spec, factories))
        return complete()
    with _claimed(paths, spec) as output:
        manifest = _manifest(spec, factories)
        if _is_complete(output, paths, manifest):
            return complete()
        job = RecordingJob(spec, factories, options.max_attempts, manifest.versions)
        prepare_partial(paths, manifest, options.adopt)
        results = _record(job, paths, options, listener)
        facts: dict[str, Any] = {
            "recording_seconds": time.monotonic() - begin,
            "failures": _require_all(results, options),
        }
        files.crash_point("all recorded")
        if options.part is not None:
            facts["seconds"] = time.monotonic() - begin
            return summarize_part(paths, options.part.of(spec.items()), results, **facts)
        _publish(paths, manifest, options, lambda done, total: listener("assemble", done, total))
        summary = summarize(paths.root, spec, results, seconds=time.monotonic() - begin, **facts)
        output.discard()
    return summary


def _manifest(spec: CollectionSpec, factories: Factories) -> Manifest:
    with contextlib.closing(factories.environment(spec.environment_of(spec.categories[0]))) as env:
        return Manifest.of(spec, env.software_versions())


# Folders --------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _claimed(paths: CollectionPaths, spec: CollectionSpec) -> Iterator[OutputFolder]:
    """Locks the output folders; checks that a missing dataset can be created there."""
    failed = lock_output(paths.failed) if spec.keep_failed else contextlib.nullcontext()
    with owned_output(paths.root, COLLECTING) as output, failed:
        if not paths.manifest.exists():
            output.require_free()
            # Lower bound: the point clouds, as episode files and as a dataset.
            output.require_room(2 * _MIN_ROWS * len(spec.items()) * spec.environment.num_points * 3 * 4)
        yield output


def _is_complete(output: OutputFolder, paths: CollectionPaths, manifest: Manifest) -> bool:
    """Returns whether the dataset is complete; reads it back before removing leftover episode files."""
    if not paths.manifest.exists():
        return False
    require_finished(paths.root, manifest)
    if paths.episodes.is_dir():
        read_back(paths.root)
    if is_own_partial(paths, manifest):
        output.discard()
    return True


# Recording ------------------------------------------------------------------------------------------------------------


def _record(job: RecordingJob, paths: CollectionPaths, options: CollectOptions, listener: Listener) -> Results:
    """Records the missing episodes; returns the results of this run, including items that a part gave up."""
    items = job.spec.items() if options.part is None else options.part.of(job.spec.items())
    missing = [item for item in items if read_record(paths.episodes / item.file_name) is None]
    # Items that a part gave up would fail again, because every attempt follows from its seed.
    results = given_up(paths, missing, options.max_attempts) if options.adopt else []
    missing = [item for item in missing if item not in {result.item for result in results}]
    # Sorted by category, because changing it costs a worker seconds. The dataset has another order.
    missing.sort(key=lambda item: job.spec.categories.index(category_of(item.object_id)))
    totals = Counter(category_of(item.object_id) for item in items)
    done = totals - Counter(category_of(item.object_id) for item in missing)
    for category, total in totals.items():
        listener(f"record {category}", done[category], total)
    listener("record", done.total(), len(items))
    with _recorder(job, paths, options, len(missing)) as run:
        for result in run(missing):
            crash = Attempt(0, None, False, f"its workers crashed ({result.death})", 0, False)
            outcome = result.value or ItemOutcome((crash,))
            if result.value is None or options.cluster is not None:
                outcome = write_outcome(paths, result.item, outcome)
            results.append(replace(result, value=outcome))
            category = category_of(result.item.object_id)
            done[category] += outcome.kept
            listener(f"record {category}", done[category], totals[category])
            listener("record", done.total(), len(items))
    return results


@contextlib.contextmanager
def _recorder(
    job: RecordingJob, paths: CollectionPaths, options: CollectOptions, items: int
) -> Iterator[Callable[[list[EpisodeSpec]], Iterator[jobs.JobResult[EpisodeSpec]]]]:
    """Yields a function that records items: in local processes, which also write, or on a cluster."""
    if options.cluster is None:
        writing = functools.partial(writing_session, job, paths)
        workers = min(options.workers, max(1, items))
        with jobs.WorkerPool[EpisodeSpec](writing, workers, timeout=options.worker_timeout) as pool:
            yield pool.run
        return
    with connected(options.cluster, workers=options.workers, insecure=options.insecure_cluster) as cpus:
        from lerobot_adamanip.collection.ray_executor import RayExecutor

        recording = functools.partial(recording_session, job)
        workers = max(1, min(options.workers or cpus, items))
        with RayExecutor[EpisodeSpec](recording, workers, timeout=options.worker_timeout) as executor:
            yield executor.run


def _with_all(summary: CollectSummary, options: CollectOptions) -> CollectSummary:
    """Returns the summary of a finished dataset; raises `DatasetError` if it lacks episodes that `options` want."""
    if summary.given_up and not options.allow_missing:
        raise DatasetError(
            "The dataset was finished with --allow-missing.",
            got=f"{summary.given_up} episodes were given up, {summary.episodes} are in {summary.root}",
            allowed="a dataset with all of them",
            hint="the same command with --allow-missing, or another folder and a larger --max-attempts",
        )
    return summary


def _require_all(results: Results, options: CollectOptions) -> tuple[str, ...]:
    """Returns why episodes were given up; raises `DatasetError` unless `options` allow missing ones."""
    failures = tuple(
        f"{result.item}: " + "; ".join(f"seed {attempt.seed}: {attempt.reason}" for attempt in result.value.attempts)
        for result in results
        if not result.value.kept
    )
    if failures and not options.allow_missing:
        raise DatasetError(
            f"{len(failures)} episodes could not be recorded.",
            got="\n           ".join(failures),
            allowed=f"a success within {options.max_attempts} attempts each",
            hint="the same command with a larger --max-attempts, or with --allow-missing",
        )
    return failures


# The dataset ----------------------------------------------------------------------------------------------------------


def _publish(
    paths: CollectionPaths, manifest: Manifest, options: CollectOptions, progress: Callable[[int, int], None]
) -> None:
    """Assembles the datasets of kept and failed episodes and moves both into place; the kept one last."""
    items = manifest.spec.items()
    shards = [path for item in items if (path := paths.episodes / item.file_name).exists()]
    records = [record for path in shards if (record := read_record(path)) is not None]
    attempts = all_attempts(paths, items, records)
    processors = tuple(sorted({str(record["versions"].get("cpu", "unknown")) for record in records}))
    if len(processors) > 1:
        logging.getLogger(__name__).warning(
            "Recorded on different processors (%s): on one of them alone, the last digits of numbers may differ.",
            ", ".join(processors),
        )
    counted = replace(manifest, attempts=count(attempts, len(items)), processors=processors)
    repo_id = options.repo_id or f"local/{paths.root.name}"
    workers = options.workers if options.cluster is None else os.cpu_count() or 1

    def build(folder: Path, root: Path, name: str, episodes: list[Path]) -> None:
        contents = Contents(episodes, manifest.spec.environment, name, counted, attempts)
        files.remove_tree(folder)
        built = assemble(folder, root.name, contents, progress, workers)
        if root == paths.failed:
            files.remove_tree(root)  # belongs to this collection, as `prepare_partial` has checked
        files.move_durably(built, root)

    failed = [
        path for item in items for path in failed_attempts(paths.failed_episodes, item) if belongs(path, manifest, item)
    ]
    if manifest.spec.keep_failed and failed:
        build(paths.building_failed, paths.failed, f"{repo_id}-failed", sorted(failed))
    build(paths.building, paths.root, repo_id, shards)
    files.crash_point("dataset in place")
