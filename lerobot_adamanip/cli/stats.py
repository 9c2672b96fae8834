"""`adamanip stats`: statistics of a dataset."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
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

        found = read_stats(self.root)
        print_result(self.json, found.to_json(), "\n".join(_lines(found)))
        return 0


def _cells(found: GroupStats) -> Iterator[str]:
    yield str(found.episodes)
    yield f"{found.key_frames}, {found.key_frames / max(1, found.episodes):.1f} each"
    for tries in (found.tries, found.failed_tries):
        yield f"{tries}, {tries / found.labelled:.2f} each" if found.labelled else "-"
    yield "-" if not found.recovered.episodes else f"{found.recovered.count}/{found.recovered.episodes}"
    yield interval_text(found.success)


def _lines(found: DatasetStats) -> Iterator[str]:
    titles = ("", "episodes", "key frames", "tries", "failed", "recovered", "success")
    yield markdown_table(titles, ([group.label, *_cells(each)] for group, each in found.groups.items()), align=True)
    yield ""
    lengths = found.length_summary()
    told = ", ".join(f"{name} {value:.4g}" for name, value in lengths.items())
    yield f"Key frames of an episode: {told}"
    if found.failures:
        yield f"Failed tries of an episode: {', '.join(f'{count} in {n}' for count, n in found.failures.items())}"
    if unlabelled := found.overall.episodes - found.overall.labelled:
        yield f"Recorded on a robot, without labels of tries: {unlabelled} episodes"
    yield f"Objects: {found.objects}. Late starts: {found.late}. Rows: {found.rows}. Size: {found.bytes / 1e6:.1f} MB"
    if found.recovery is not None:
        yield f"Failed tries repeated unchanged: {interval_text(found.recovery.repeated)}"
    if found.attempts is not None:
        yield f"Attempts kept: {interval_text(found.attempts.kept)}; given up: {found.attempts.given_up}"
        if found.attempts.kept.count < found.attempts.kept.episodes:
            for label, (kept, tried) in found.attempts.hidden.items():
                yield f"  {label}: {kept} of {tried}"
