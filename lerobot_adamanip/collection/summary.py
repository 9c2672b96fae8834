"""What a run of `collect` did, and what the dataset holds."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.outcome import ItemReport
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, EpisodeSpec, manifest_path
from lerobot_adamanip.datasets.manifest import AttemptCounts, read_manifest
from lerobot_adamanip.datasets.reading import episode_table
from lerobot_adamanip.util import files


@dataclass(frozen=True)
class ItemResult:
    """What this run did for an item: its report, and the seconds its worker took."""

    item: EpisodeSpec
    report: ItemReport
    seconds: float


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
        attempted: episodes tried for it in all, kept or not, those of given-up items included.
        given_up: items without an episode.
        recorded: by this run; the others were there already.
        attempts: episodes this run tried.
        seconds: this run took, from start to finished dataset.
        recording_seconds: of those, spent recording.
        success_rate: successes over attempted, of the expert, or of the policy that it corrects.
        bytes: size of the dataset on disk.
        failures: lines about items that were given up; empty in a complete dataset.
        categories: by name, in the order of the dataset.
    """

    root: str
    episodes: int
    attempted: int
    given_up: int
    recorded: int
    attempts: int
    seconds: float
    recording_seconds: float
    success_rate: float
    bytes: int
    failures: tuple[str, ...] = ()
    categories: dict[str, CategorySummary] = field(default_factory=dict)

    @property
    def episodes_per_minute(self) -> float:
        """Returns the rate of this run's recording."""
        return 60.0 * self.recorded / self.recording_seconds if self.recorded else 0.0


def summarize(
    root: Path,
    spec: CollectionSpec,
    results: list[ItemResult],
    *,
    begin: float,
    recording: float = 0.0,
    failures: tuple[str, ...] = (),
) -> CollectSummary:
    """Returns the summary of a finished dataset and of this run's results.

    Args:
        root: of the dataset.
        spec: of the collection.
        results: of this run.
        begin: of this run, by `time.monotonic` [s].
        recording: time this run spent recording [s].
        failures: lines about items that were given up.
    """
    rows = episode_table(root).select(["object_id", "attempts", "length", "success"]).to_pylist()
    counts = read_manifest(manifest_path(root), spec.environment.assets).attempts or AttemptCounts(len(rows), 0, 0)
    return CollectSummary(
        root=str(root),
        episodes=len(rows),
        attempted=counts.attempted,
        given_up=counts.given_up,
        recorded=sum(result.report.kept for result in results),
        attempts=sum(len(result.report.attempts) for result in results),
        seconds=time.monotonic() - begin,
        recording_seconds=recording,
        success_rate=sum(row["success"] for row in rows) / max(1, counts.attempted),
        bytes=files.tree_bytes(root),
        failures=failures,
        categories={name: _of_category(name, rows, results) for name in spec.categories},
    )


def summarize_part(
    paths: CollectionPaths,
    items: list[EpisodeSpec],
    results: list[ItemResult],
    *,
    begin: float,
    recording: float,
    failures: tuple[str, ...],
) -> CollectSummary:
    """Returns the summary of a part: of its episode files and of this run's results; there is no dataset yet."""
    kept = sum((paths.episodes / item.file_name).exists() for item in items)
    attempts = sum(len(result.report.attempts) for result in results)
    succeeded = sum(attempt.success for result in results for attempt in result.report.attempts)
    return CollectSummary(
        root=str(paths.partial),
        episodes=kept,
        attempted=attempts,
        given_up=len(items) - kept,
        recorded=sum(result.report.kept for result in results),
        attempts=attempts,
        seconds=time.monotonic() - begin,
        recording_seconds=recording,
        success_rate=succeeded / max(1, attempts),
        bytes=files.tree_bytes(paths.partial),
        failures=failures,
    )


def _of_category(category: str, rows: list[dict[str, Any]], results: list[ItemResult]) -> CategorySummary:
    mine = [row for row in rows if category_of(row["object_id"]) == category]
    done = [result for result in results if category_of(result.item.object_id) == category]
    return CategorySummary(
        episodes=len(mine),
        attempts=sum(int(row["attempts"]) for row in mine),
        mean_key_frames=sum(int(row["length"]) - 1 for row in mine) / max(1, len(mine)),
        recorded=sum(each.report.kept for each in done),
        worker_seconds=sum(each.seconds for each in done),
    )
