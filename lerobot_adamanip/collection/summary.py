"""Summary of a `collect` run and of its dataset."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.datasets.attempts import attempts_path, read_attempts
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, EpisodeSpec, manifest_path
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.manifest import AttemptCounts, read_manifest
from lerobot_adamanip.util import files
from lerobot_adamanip.util.jobs import JobResult

Results = list[JobResult[EpisodeSpec]]
"""Results of items, with `ItemOutcome` values."""


@dataclass(frozen=True)
class CategorySummary:
    """A category's share of a dataset and of this run.

    Attributes:
        episodes: number in the dataset.
        attempts: number of attempted episodes, those of given-up items too.
        mean_key_frames: mean length of an episode, in key frames, or in steps at control rate.
        recorded: number recorded by this run.
        worker_seconds: worker time of this run, summed over workers.
    """

    episodes: int
    attempts: int
    mean_key_frames: float
    recorded: int
    worker_seconds: float

    @property
    def episodes_per_worker_minute(self) -> float:
        """Recorded episodes per worker minute."""
        return 60.0 * self.recorded / self.worker_seconds if self.recorded else 0.0


@dataclass(frozen=True)
class CollectSummary:
    """Summary of a `collect` run.

    Attributes:
        root: root folder of the dataset; for a part, the folder of its episode files.
        episodes: number in the dataset.
        attempted: number of all attempts, including those of given-up items.
        given_up: number of items without an episode.
        recorded: number recorded by this run.
        attempts: number of attempts in this run.
        seconds: duration of this run, up to the finished dataset.
        recording_seconds: recording time within it.
        success_rate: successes per attempt, of the expert or of the corrected policy.
        bytes: size of the dataset on disk.
        failures: one line per given-up item; empty for a complete dataset.
        categories: by name, in dataset order.
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
        """Recorded episodes per minute of recording."""
        return 60.0 * self.recorded / self.recording_seconds if self.recorded else 0.0


def summarize(root: Path, spec: CollectionSpec, results: Results, **facts: Any) -> CollectSummary:
    """Returns the summary of a run and its finished dataset.

    Args:
        root: root folder of the dataset.
        spec: specification of the collection.
        results: results of the run's items.
        facts: ``seconds``, ``recording_seconds`` and ``failures`` of the run.
    """
    rows = Dataset(root).table.select(["object_id", "length", "success"]).to_pylist()
    counts = read_manifest(manifest_path(root), spec.environment.assets).attempts or AttemptCounts(len(rows), 0, 0)
    attempted = Counter(category_of(each.object_id) for each in read_attempts(attempts_path(root)))
    return CollectSummary(
        **_run_counts(root, results),
        **facts,
        episodes=len(rows),
        attempted=counts.attempted,
        given_up=counts.given_up,
        success_rate=sum(row["success"] for row in rows) / max(1, counts.attempted),
        categories={name: _category_summary(name, rows, results, attempted[name]) for name in spec.categories},
    )


def summarize_part(paths: CollectionPaths, items: list[EpisodeSpec], results: Results, **facts: Any) -> CollectSummary:
    """Returns the summary of a run and a part's episode files, as `summarize`; a part has no dataset."""
    kept = sum((paths.episodes / item.file_name).exists() for item in items)
    counts = _run_counts(paths.partial, results)
    succeeded = sum(attempt.success for result in results for attempt in result.value.attempts)
    return CollectSummary(
        **counts,
        **facts,
        episodes=kept,
        attempted=counts["attempts"],
        given_up=len(items) - kept,
        success_rate=succeeded / max(1, counts["attempts"]),
    )


def _run_counts(folder: Path, results: Results) -> dict[str, Any]:
    return {
        "root": str(folder),
        "recorded": sum(result.value.kept for result in results),
        "attempts": sum(len(result.value.attempts) for result in results),
        "bytes": files.tree_bytes(folder),
    }


def _category_summary(category: str, rows: list[dict[str, Any]], results: Results, attempts: int) -> CategorySummary:
    rows = [row for row in rows if category_of(row["object_id"]) == category]
    results = [result for result in results if category_of(result.item.object_id) == category]
    return CategorySummary(
        episodes=len(rows),
        attempts=attempts,
        mean_key_frames=sum(int(row["length"]) - 1 for row in rows) / max(1, len(rows)),
        recorded=sum(result.value.kept for result in results),
        worker_seconds=sum(result.seconds for result in results),
    )
