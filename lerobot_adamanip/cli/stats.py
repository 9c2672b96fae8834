"""`adamanip stats`: statistics of a dataset."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.evaluation.failed_tries import failed_tries_text
from lerobot_adamanip.evaluation.text_format import interval_text, markdown_table

if TYPE_CHECKING:
    from lerobot_adamanip.datasets.stats import DatasetStats, GroupStats


@dataclass
class StatsCommand:
    """Counts the content of a dataset: episodes, key frames, tries, failed tries, recoveries, successes.

    Shows counts by category, object split and hidden value, episode lengths, and attempts that were not kept.
    """

    root: DatasetFolder
    """Folder of a LeRobotDataset."""

    json: bool = False
    """Print one JSON object instead of tables."""

    def run(self) -> int:
        """Counts and prints. Returns 0."""
        from lerobot_adamanip.datasets.stats import read_stats

        stats = read_stats(self.root)
        print_result(self.json, stats.to_json(), "\n".join(_lines(stats)))
        return 0


def _cells(group: GroupStats) -> Iterator[str]:
    yield str(group.episodes)
    yield f"{group.key_frames}, {group.key_frames / max(1, group.episodes):.1f} each"
    for tries in (group.tries, group.failed_tries):
        yield f"{tries}, {tries / group.labelled:.2f} each" if group.labelled else "-"
    yield "-" if not group.recovered.episodes else f"{group.recovered.count}/{group.recovered.episodes}"
    yield interval_text(group.success)


def _summary(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in values.items())


def _lines(stats: DatasetStats) -> Iterator[str]:
    titles = ("", "episodes", "key frames", "tries", "failed", "recovered", "success")
    yield markdown_table(titles, ([group.label, *_cells(values)] for group, values in stats.groups.items()), align=True)
    yield ""
    yield f"Key frames of an episode: {_summary(stats.length_summary())}"
    if stats.steps:
        yield f"Steps of an episode, at {stats.fps} Hz: {_summary(stats.step_summary())}"
    if stats.failures:
        yield f"Failed tries of an episode: {', '.join(f'{count} in {n}' for count, n in stats.failures.items())}"
    yield from (f"Failed tries by kind, {line}" for line in failed_tries_text(stats.failed_by_kind))
    if unlabelled := stats.overall.episodes - stats.overall.labelled:
        yield f"Without counts of tries, e.g. recorded on a robot: {unlabelled} episodes"
    yield f"Objects: {stats.objects}. Late starts: {stats.late}. Rows: {stats.rows}. Size: {stats.bytes / 1e6:.1f} MB"
    if stats.recovery is not None:
        yield f"Failed tries repeated unchanged: {interval_text(stats.recovery.repeated)}"
    if stats.attempts is not None:
        yield f"Attempts kept: {interval_text(stats.attempts.kept)}; given up: {stats.attempts.given_up}"
        if stats.attempts.kept.count < stats.attempts.kept.episodes:
            for label, (kept, tried) in stats.attempts.hidden.items():
                yield f"  {label}: {kept} of {tried}"
