"""Check a whole dataset in one pass, one file at a time. Writes nothing."""

from __future__ import annotations

import itertools
from pathlib import Path

from lerobot_adamanip.datasets.check.contract import check_features, contract_of
from lerobot_adamanip.datasets.check.facts import check_course, check_facts, count_labels, has_facts, read_collection
from lerobot_adamanip.datasets.check.findings import Progress, Report
from lerobot_adamanip.datasets.check.layout import (
    CAMERAS,
    Layout,
    check_texts,
    leftovers,
    read_layout,
    unlisted_files,
)
from lerobot_adamanip.datasets.check.reading import read_rows
from lerobot_adamanip.datasets.check.statistics import (
    Stored,
    check_episode_statistics,
    check_statistics,
    stored_statistics,
)
from lerobot_adamanip.datasets.check.values import check_values
from lerobot_adamanip.datasets.check.videos import check_videos
from lerobot_adamanip.datasets.reading import is_dataset, missing_dataset, workspace_of


def check(
    root: str | Path,
    *,
    assets: Path | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> Report:
    """Checks a dataset: files, columns, counts, rows, videos, statistics and collection files.

    Args:
        root: folder of a LeRobotDataset.
        assets: folder of external assets, if they were used.
        progress: called with stage (``rows``, ``frames``), number done and total number.

    Raises:
        DatasetError: there is no dataset.
    """
    folder = require_dataset(root)
    report = Report(str(folder))
    for path in leftovers(folder):
        report.add("leftover", "of a process that ended early", path.relative_to(folder).as_posix())
    layout = read_layout(folder, report)
    if layout is None:
        return report
    report.episodes = len(layout.episodes)
    check_texts(layout, report)
    collected = read_collection(folder, assets, report)
    if lacks_cameras(layout):
        report.add("cameras", "parameters of the cameras", CAMERAS)
    check_features(layout.features, report, collected=collected is not None)
    stored = stored_statistics(layout.table)
    for name in unlisted_files(layout):
        report.add("unlisted", "no episode is in this file", name)
    counted = _check_rows(layout, stored, report, progress)
    frames, done = layout.rows * len(layout.keys_of("video")), itertools.count(1)
    check_videos(layout, stored, report, lambda: progress("frames", next(done), frames))
    check_statistics(layout, stored, report)
    check_facts(layout, collected, counted, report)
    return report


def lacks_cameras(layout: Layout) -> bool:
    """Returns whether the dataset names a file with the cameras' parameters that does not exist."""
    named = any("cameras" in (feature.get("info") or {}) for feature in layout.features.values())
    return named and not (layout.root / CAMERAS).exists()


def require_dataset(root: str | Path) -> Path:
    """Returns the folder of a dataset, complete or not; raises `DatasetError` if there is none."""
    folder = Path(root).absolute()
    if not is_dataset(folder):
        raise missing_dataset(folder)
    return folder


def _check_rows(layout: Layout, stored: Stored, report: Report, progress: Progress) -> dict[int, dict[str, int]]:
    """Checks the data files; returns episode -> label counts."""
    counted: dict[int, dict[str, int]] = {}
    workspace, ours = workspace_of(layout.root, layout.features), contract_of(layout.features)
    for name, episodes in layout.by_data_file().items():
        found = read_rows(layout, name, episodes, report)
        if found is None:
            continue
        where, table = found
        columns = check_values(where, table, layout.features, workspace, report)
        if has_facts(layout):
            check_course(where, columns, report)
        report.damaged |= set(where.episodes.tolist()) - set(layout.row_of)
        check_episode_statistics(where, columns, stored, layout.row_of, report, ours=ours)
        counted.update(count_labels(where, columns))
        report.rows += len(where)
        progress("rows", report.rows, layout.rows)
    return counted
