"""Collecting demonstrations: durable per episode, resumable, the same data whatever interrupts it."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.assemble import Contents, assemble
from lerobot_adamanip.collection.executors import ExecutorFactory, open_executors
from lerobot_adamanip.collection.fingerprint import collection_fingerprint
from lerobot_adamanip.collection.folder_identity import is_own_partial, prepare_partial, require_finished
from lerobot_adamanip.collection.outcome import Attempt, ItemOutcome, ItemReport, write_given_up, write_outcome
from lerobot_adamanip.collection.parts import Part, adopt, belongs, failed_attempts, given_up
from lerobot_adamanip.collection.ray_cluster import require_usable
from lerobot_adamanip.collection.record import Factories, RecordingJob
from lerobot_adamanip.collection.summary import CollectSummary, ItemResult, summarize, summarize_part
from lerobot_adamanip.datasets.attempts import all_attempts, count
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, EpisodeSpec
from lerobot_adamanip.datasets.manifest import Manifest
from lerobot_adamanip.datasets.output_folder import (
    COLLECTING,
    OutputFolder,
    lock_output,
    lock_path,
    owned_output,
    resolve_output,
)
from lerobot_adamanip.datasets.reading import read_back
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.shards import read_record
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.jobs import DEFAULT_TIMEOUT, JobResult

Listener = Callable[[str, int, int], None]
"""Told of progress: stage (``record``, ``record safe`` for a category's share, ``assemble``), episodes done, in all."""
_LEAST_ROWS = 3
"""Rows that an episode has at least."""


@dataclass(frozen=True)
class CollectOptions:
    """How a collection is made; nothing of it changes the data.

    Attributes:
        workers: processes, each with a simulator of its own; or actors of the cluster, 0 for one per CPU of it.
        worker_timeout: a worker without a heartbeat for so long is replaced [s]; on a cluster, one whose item takes
            longer.
        max_attempts: seeds to try per episode until the expert succeeds.
        allow_missing: make a dataset even if some episodes were given up.
        repo_id: written into the dataset card; ``local/<folder name>`` by default.
        cluster: Ray cluster that records: ``HOST:PORT``, ``auto`` or ``local``; None for processes of this machine.
        insecure_cluster: whether that may do without a token.
        part: of the episodes that alone is recorded, without making a dataset; None for all.
        adopt: roots of parts whose episodes are taken over first.
    """

    workers: int = 1
    worker_timeout: float = DEFAULT_TIMEOUT
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
                "Too small.",
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
    """Records the episodes that ``root`` still lacks and makes a LeRobotDataset of them all.

    Neither workers nor interruptions change the data. A complete one is left as it is, and may be read-only; until then
    episodes are kept in ``<root>.partial``; nothing there is removed before the dataset is synced and read back.

    Args:
        root: of the dataset.
        spec: what to collect.
        factories: of environments and experts.
        options: how.
        listener: told of progress.

    Raises:
        DatasetError: if ``root`` holds something else, another collection of it is running, or episodes were given up.
        WorkerError: if a worker failed for good.
    """
    begin = time.monotonic()
    _require_cluster(options)
    paths = CollectionPaths(resolve_output(root))
    if paths.manifest.exists() and not (paths.partial.exists() or lock_path(paths.root).exists()):
        require_finished(paths.root, Manifest.of(spec, _fingerprint(spec, factories)))
        return summarize(paths.root, spec, [], begin=begin)
    with _claimed(paths, spec) as output:
        manifest = Manifest.of(spec, _fingerprint(spec, factories))
        if _is_complete(output, paths, manifest):
            return summarize(paths.root, spec, [], begin=begin)
        prepare_partial(paths, manifest)
        job = RecordingJob(spec, factories, options.max_attempts, manifest.fingerprint)
        summary = _collected(job, paths, manifest, options, listener=listener, begin=begin)
        if options.part is None:
            output.discard()
    return summary


def _require_cluster(options: CollectOptions) -> None:
    if options.cluster is not None:
        require_usable(options.cluster, insecure=options.insecure_cluster)


def _collected(
    job: RecordingJob,
    paths: CollectionPaths,
    manifest: Manifest,
    options: CollectOptions,
    *,
    listener: Listener,
    begin: float,
) -> CollectSummary:
    """Records what is missing; publishes the dataset, unless this is a part of it."""
    with _executors(options) as executors:
        adopt(paths, manifest, options.adopt)
        results = _record(job, paths, options, executors, listener)
        recording = time.monotonic() - begin
        failures = _require_all(results, options)
        files.crash_point("all recorded")
        if options.part is not None:
            mine = options.part.of(job.spec.items())
            return summarize_part(paths, mine, results, begin=begin, recording=recording, failures=failures)
        _publish(paths, manifest, options, executors, lambda done, total: listener("assemble", done, total))
    return summarize(paths.root, job.spec, results, begin=begin, recording=recording, failures=failures)


def _fingerprint(spec: CollectionSpec, factories: Factories) -> dict[str, str]:
    env = factories.environment(spec.environment_of(spec.categories[0]))
    try:
        return collection_fingerprint(env)
    finally:
        env.close()


@contextlib.contextmanager
def _claimed(paths: CollectionPaths, spec: CollectionSpec) -> Iterator[OutputFolder]:
    """Locks the output folders; where no dataset is yet, one can be put there."""
    failed = lock_output(paths.failed) if spec.keep_failed else contextlib.nullcontext()
    with owned_output(paths.root, COLLECTING) as output, failed:
        if not paths.manifest.exists():
            output.require_free()
            output.require_room(_least_bytes(spec))
        yield output


def _is_complete(output: OutputFolder, paths: CollectionPaths, manifest: Manifest) -> bool:
    """Returns whether the dataset is there.

    Where its episode files are still beside it, it is read back once more before they are removed.
    """
    if not paths.manifest.exists():
        return False
    require_finished(paths.root, manifest)
    if paths.episodes.is_dir():
        read_back(paths.root)
    if is_own_partial(paths, manifest):
        output.discard()
    return True


def _least_bytes(spec: CollectionSpec) -> int:
    """Returns a lower bound for the size of the clouds of a collection, as episode files and as a dataset."""
    return 2 * _LEAST_ROWS * len(spec.items()) * spec.environment.num_points * 3 * 4


def _executors(options: CollectOptions) -> contextlib.AbstractContextManager[ExecutorFactory]:
    return open_executors(
        options.workers, options.worker_timeout, cluster=options.cluster, insecure=options.insecure_cluster
    )


def _record(
    job: RecordingJob, paths: CollectionPaths, options: CollectOptions, executors: ExecutorFactory, listener: Listener
) -> list[ItemResult]:
    items = job.spec.items() if options.part is None else options.part.of(job.spec.items())
    missing = [item for item in items if not _is_recorded(paths, item)]
    # What a part has given up would fail again: every attempt follows from its seed.
    results = given_up(paths, missing, options.max_attempts) if options.adopt else []
    missing = [item for item in missing if item not in {result.item for result in results}]
    # Category by category, because changing it costs a worker seconds. The dataset's order is another one.
    missing.sort(key=lambda item: job.spec.categories.index(category_of(item.object_id)))
    totals = Counter(category_of(item.object_id) for item in items)
    done = totals - Counter(category_of(item.object_id) for item in missing)
    for category, total in totals.items():
        listener(f"record {category}", done[category], total)
    with executors.recording(job, paths, len(missing)) as executor:
        for outcome in executor.run(missing):
            results.append(_result(paths, outcome))
            category = category_of(outcome.item.object_id)
            done[category] += results[-1].report.kept
            listener(f"record {category}", done[category], totals[category])
            listener("record", done.total(), len(items))
    return results


def _result(paths: CollectionPaths, outcome: JobResult[EpisodeSpec]) -> ItemResult:
    if isinstance(outcome.value, ItemReport):
        return ItemResult(outcome.item, outcome.value, outcome.seconds)
    if isinstance(outcome.value, ItemOutcome):
        write_outcome(paths, outcome.item, outcome.value)
        return ItemResult(outcome.item, outcome.value.report, outcome.seconds)
    lost = Attempt(0, None, False, f"its worker died twice ({outcome.death})", 0, False)
    write_given_up(paths, outcome.item, [lost])
    return ItemResult(outcome.item, ItemReport((lost,)), outcome.seconds)


def _is_recorded(paths: CollectionPaths, item: EpisodeSpec) -> bool:
    path = paths.episodes / item.file_name
    return path.exists() and read_record(path) is not None


def _reasons(result: ItemResult) -> str:
    reasons = "; ".join(f"seed {attempt.seed}: {attempt.reason}" for attempt in result.report.attempts)
    return f"{result.item}: {reasons}"


def _require_all(results: list[ItemResult], options: CollectOptions) -> tuple[str, ...]:
    """Returns why episodes were given up; raises `DatasetError` if any was and `options` allow none."""
    failures = tuple(_reasons(each) for each in results if not each.report.kept)
    if failures and not options.allow_missing:
        raise DatasetError(
            f"{len(failures)} episodes could not be recorded.",
            got="\n           ".join(failures),
            allowed=f"a success within {options.max_attempts} attempts each",
            hint="the same command with a larger --max-attempts, or --allow-missing to do without",
        )
    return failures


def _publish(
    paths: CollectionPaths,
    manifest: Manifest,
    options: CollectOptions,
    executors: ExecutorFactory,
    progress: Callable[[int, int], None],
) -> None:
    """Assembles the dataset, and that of failed episodes, and puts both in place; the kept one last."""
    items = manifest.spec.items()
    shards = [path for item in items if (path := paths.episodes / item.file_name).exists()]
    records = [record for path in shards if (record := read_record(path)) is not None]
    attempts = all_attempts(paths, items, records)
    counted = replace(manifest, attempts=count(attempts, len(items)))
    repo_id = options.repo_id or f"local/{paths.root.name}"
    if manifest.spec.keep_failed and (failed := _failed(paths, manifest)):
        contents = Contents(counted, failed, attempts, f"{repo_id}-failed")
        files.remove_tree(paths.building_failed)
        built = assemble(paths.building_failed, paths.failed.name, contents, progress, executors)
        # What an interrupted run has put there: `prepare_partial` has seen that it is of this collection.
        files.remove_tree(paths.failed)
        files.move_durably(built, paths.failed)
    files.remove_tree(paths.building)
    built = assemble(paths.building, paths.root.name, Contents(counted, shards, attempts, repo_id), progress, executors)
    files.move_durably(built, paths.root)
    files.crash_point("dataset in place")


def _failed(paths: CollectionPaths, manifest: Manifest) -> list[Path]:
    """Returns the files of failed attempts at items of this collection."""
    return sorted(
        path
        for item in manifest.spec.items()
        for path in failed_attempts(paths.failed_episodes, item)
        if belongs(path, manifest, item)
    )
