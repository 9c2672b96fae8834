"""`adamanip check`: checks a dataset against its metadata."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.cli.progress import Progress, show_progress
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from lerobot_adamanip.datasets.check.findings import Report

TOLERANCE = 1e-4
"""Maximum difference of a replay in any column, in the column's unit (m, rad, rad/s, N m)."""
_SHOWN = 20
"""Maximum printed findings per kind; `--json` has more."""
_STAGES = {"rows": "rows checked", "frames": "frames decoded", "replay": "episodes replayed"}


@dataclass
class CheckCommand:
    """Checks a dataset: files, columns, counts, rows, videos, statistics and collection metadata.

    Exit status: 0 without findings or with warnings only, 1 with findings, 2 without a dataset. Only --repair changes
    the dataset.
    """

    root: DatasetFolder
    """Folder of a LeRobotDataset."""

    repair: bool = False
    """Repair the dataset after a crash, then check again. Every completely saved episode is kept. Removed files are
    moved into DIR.before-repair."""

    replay: int = 0
    """Number of episodes to replay in the simulator, spread over the dataset, for example 3."""

    assets: Path | None = None
    """Folder of external assets, if the dataset was recorded with any."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Checks the dataset. Returns 0 without findings."""
        if self.replay < 0:
            raise ConfigurationError("Nothing to replay.", got=self.replay, allowed=">= 0", hint="--replay 3")
        from lerobot_adamanip.datasets.check.dataset import check
        from lerobot_adamanip.datasets.repair import repair

        repaired: dict[str, Any] = {}
        lines: list[str] = []
        with show_progress(_STAGES) as progress:
            if self.repair:
                changes = repair(self.root)
                repaired, lines = {"repair": changes.to_json()}, list(changes.lines())
            result = check(self.root, assets=self.assets, progress=progress)
            if self.replay and result.clean:
                result = self._with_replays(result, progress)
        print_result(self.json, {**result.to_json(), **repaired}, "\n".join([*lines, *_lines(result)]))
        return 0 if result.clean else 1

    def _with_replays(self, result: Report, progress: Progress) -> Report:
        from lerobot_adamanip.collection.replay import check_replays
        from lerobot_env_adamanip.make_environment import make_environment

        count = min(self.replay, result.episodes)
        chosen = [number * result.episodes // count for number in range(count)]
        report = check_replays(
            self.root, chosen, make_environment, tolerance=TOLERANCE, assets=self.assets, progress=progress
        )
        return replace(result, findings=result.findings + report.findings, counts=result.counts + report.counts)


def _lines(result: Report) -> Iterator[str]:
    for kind, count in result.counts.items():
        of_kind = [finding for finding in result.findings if finding.kind == kind]
        yield from map(str, of_kind[:_SHOWN])
        if count > _SHOWN:
            yield f"{kind}: {count - _SHOWN} more"
    total, warnings = result.total(fails=True), result.total(fails=False)
    verdict = f"{total} finding{'s' * (total != 1)}" if total else "clean"
    verdict += f", {warnings} warning{'s' * (warnings != 1)}" if warnings else ""
    yield f"{result.root}: {result.episodes} episodes, {result.rows} rows: {verdict}"
