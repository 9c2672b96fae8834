"""The whole check of a dataset: reads everything once, in pieces, and changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.datasets.check.contract import check_features
from lerobot_adamanip.datasets.check.facts import (
    Collected,
    check_course,
    check_facts,
    count_labels,
    has_facts,
    read_collection,
)
from lerobot_adamanip.datasets.check.findings import CheckResult, Progress, Report
from lerobot_adamanip.datasets.check.layout import INFO, Episode, Layout, leftovers, read_layout, unlisted_files
from lerobot_adamanip.datasets.check.reading import batches, open_file, place
from lerobot_adamanip.datasets.check.statistics import (
    Stored,
    check_episode_statistics,
    check_statistics,
    stored_statistics,
)
from lerobot_adamanip.datasets.check.values import check_values
from lerobot_adamanip.datasets.check.videos import check_videos
from lerobot_adamanip.datasets.reading import missing_dataset, workspace_of
from lerobot_adamanip.util.errors import DatasetError


@dataclass
class _Checked:
    """What the checks of one dataset share."""

    layout: Layout
    collected: Collected | None
    workspace: Workspace
    stored: Stored
    report: Report
    progress: Progress
    rows: int = 0
    counted: dict[int, dict[str, int]] = field(default_factory=dict)


def check(
    root: str | Path,
    *,
    assets: Path | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> CheckResult:
    """Checks a dataset: files, columns, counts, rows, videos, statistics, and what it says of its collection.

    Memory does not grow with the dataset's rows. Nothing is written.

    Args:
        root: folder of a LeRobotDataset.
        assets: folder of external assets, if the dataset was recorded with any.
        progress: told of stage (``rows``, ``frames``), how much of it is done, and all.

    Raises:
        DatasetError: there is no dataset.
    """
    folder, report = require_dataset(root), Report()
    for path in leftovers(folder):
        report.add("leftover", "of a process that ended early", path.relative_to(folder).as_posix())
    layout = read_layout(folder, report)
    if layout is None:
        return _result(folder, report, 0, 0)
    collected = read_collection(folder, assets, report)
    check_features(layout.features, report, collected=collected is not None)
    workspace = workspace_of(folder, layout.features)
    shared = _Checked(layout, collected, workspace, stored_statistics(layout.table), report, progress)
    for name in unlisted_files(layout):
        report.add("unlisted", "no episode is in this file", name)
    for name, episodes in layout.by_data_file().items():
        _check_data(shared, name, episodes)
    frames = layout.rows * len(layout.video_keys)
    check_videos(layout, shared.stored, report, _counting(progress, "frames", frames))
    check_statistics(layout, shared.stored, report)
    check_facts(layout, collected, shared.counted, report)
    return _result(folder, report, len(layout.episodes), shared.rows)


def require_dataset(root: str | Path) -> Path:
    """Returns the folder of a dataset, whole or not; raises `DatasetError` if there is nothing of one."""
    folder = Path(root).absolute()
    if not folder.is_dir():
        raise missing_dataset(folder)
    if not (folder / INFO).exists() and not any(folder.glob("data/*/*.parquet")):
        raise DatasetError(
            "There is no dataset.",
            got=f"{folder}, without {INFO} and data/",
            allowed="the folder of a LeRobotDataset",
            hint="adamanip collect, or another folder",
        )
    return folder


def _check_data(shared: _Checked, name: str, episodes: list[Episode]) -> None:
    layout, report = shared.layout, shared.report
    file = open_file(layout, name, episodes[0], report)
    if file is None:
        return
    where = place(layout, name, file, episodes, report)
    if where is None:
        return
    recorded = has_facts(layout)
    for batch in batches(file, where, layout.data_keys, report):
        columns = check_values(batch, layout.features, shared.workspace, report)
        if recorded:
            check_course(batch, columns, report)
        report.damaged |= set(batch.where.episodes.tolist()) - set(layout.row_of)
        check_episode_statistics(batch, columns, shared.stored, layout.row_of, report)
        shared.counted.update(count_labels(batch, columns))
        shared.rows += len(batch.where)
        shared.progress("rows", shared.rows, layout.rows)


def _counting(progress: Progress, stage: str, total: int) -> Callable[[int], None]:
    done = 0

    def count(more: int) -> None:
        nonlocal done
        done += more
        progress(stage, done, total)

    return count


def _result(folder: Path, report: Report, episodes: int, rows: int) -> CheckResult:
    return CheckResult(str(folder), episodes, rows, tuple(report.findings), dict(report.counts))
