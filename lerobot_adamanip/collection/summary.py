"""Summary of a `collect` run and of its dataset."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
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
        attempts: number of attempted episodes.
        mean_key_frames: mean length of an episode.
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


@dataclass(frozen=True)
class Run:
    """A `collect` run.

    Attributes:
        begin: start time, from `time.monotonic` [s].
        results: results of its items.
        recording_seconds: recording time.
        failures: one line per given-up item.
    """

    begin: float
    results: Results = field(default_factory=list)
    recording_seconds: float = 0.0
    failures: tuple[str, ...] = ()

    def summarize(self, root: Path, spec: CollectionSpec) -> CollectSummary:
        """Returns the summary of this run and a finished dataset."""
        rows = Dataset(root).table.select(["object_id", "attempts", "length", "success"]).to_pylist()
        counts = read_manifest(manifest_path(root), spec.environment.assets).attempts or AttemptCounts(len(rows), 0, 0)
        return CollectSummary(
            **self._facts(root),
            episodes=len(rows),
            attempted=counts.attempted,
            given_up=counts.given_up,
            success_rate=sum(row["success"] for row in rows) / max(1, counts.attempted),
            categories={name: _of_category(name, rows, self.results) for name in spec.categories},
        )

    def summarize_part(self, paths: CollectionPaths, items: list[EpisodeSpec]) -> CollectSummary:
        """Returns the summary of this run and a part's episode files; a part has no dataset."""
        kept = sum((paths.episodes / item.file_name).exists() for item in items)
        facts = self._facts(paths.partial)
        succeeded = sum(attempt.success for result in self.results for attempt in result.value.attempts)
        return CollectSummary(
            **facts,
            episodes=kept,
            attempted=facts["attempts"],
            given_up=len(items) - kept,
            success_rate=succeeded / max(1, facts["attempts"]),
        )

    def _facts(self, folder: Path) -> dict[str, Any]:
        return {
            "root": str(folder),
            "recorded": sum(result.value.kept for result in self.results),
            "attempts": sum(len(result.value.attempts) for result in self.results),
            "seconds": time.monotonic() - self.begin,
            "recording_seconds": self.recording_seconds,
            "bytes": files.tree_bytes(folder),
            "failures": self.failures,
        }


def _of_category(category: str, rows: list[dict[str, Any]], results: Results) -> CategorySummary:
    mine = [row for row in rows if category_of(row["object_id"]) == category]
    done = [result for result in results if category_of(result.item.object_id) == category]
    return CategorySummary(
        episodes=len(mine),
        attempts=sum(int(row["attempts"]) for row in mine),
        mean_key_frames=sum(int(row["length"]) - 1 for row in mine) / max(1, len(mine)),
        recorded=sum(each.value.kept for each in done),
        worker_seconds=sum(each.seconds for each in done),
    )
