"""Check a whole dataset in one pass, one file at a time. Writes nothing."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

from lerobot_adamanip.assets.source import require_directory
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.check.facts import check_facts, has_facts, read_collection
from lerobot_adamanip.datasets.check.features import check_features, contract_of
from lerobot_adamanip.datasets.check.findings import Progress, Report
from lerobot_adamanip.datasets.check.rows import check_course, check_values, read_rows
from lerobot_adamanip.datasets.check.statistics import (
    Stored,
    check_episode_statistics,
    check_statistics,
    stored_statistics,
)
from lerobot_adamanip.datasets.check.videos import check_videos
from lerobot_adamanip.datasets.dataset import Dataset, Episode
from lerobot_adamanip.datasets.opening import (
    OtherFormatError,
    UntrustedValueError,
    conversion_command,
    require_dataset,
)
from lerobot_adamanip.datasets.output_folder import INFO
from lerobot_adamanip.util.errors import DatasetError

CAMERAS = "meta/cameras.json"
_FRAME = 1e-3
"""Largest difference of equal times [s]; LeRobot stores them as sums of durations."""


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
        ConfigurationError: there is no folder ``assets``.
    """
    if assets is not None:
        require_directory(assets)
    folder = require_dataset(root)
    report = Report(str(folder))
    for path in leftovers(folder):
        report.add("leftover", "of a process that ended early", path.relative_to(folder).as_posix())
    dataset = read_metadata(folder, report)
    if dataset is None:
        return report
    report.episodes = len(dataset.episodes)
    collected = read_collection(folder, assets, report)
    if lacks_cameras(dataset):
        report.add("cameras", "parameters of the cameras", CAMERAS)
    check_features(dataset.features, report, collected=collected is not None)
    stored = stored_statistics(dataset.statistics)
    for name in _unlisted_files(dataset):
        report.add("unlisted", "no episode is in this file", name)
    successes = _check_rows(dataset, stored, report, progress)
    frames, done = _count_rows(dataset) * len(dataset.keys_of("video")), itertools.count(1)
    check_videos(dataset, stored, report, lambda: progress("frames", next(done), frames))
    check_statistics(dataset, stored, report)
    check_facts(dataset, collected, successes, report)
    return report


def lacks_cameras(dataset: Dataset) -> bool:
    """Returns whether the dataset names a file with the cameras' parameters that does not exist."""
    named = any("cameras" in (feature.get("info") or {}) for feature in dataset.features.values())
    return named and not (dataset.root / CAMERAS).exists()


def _check_rows(dataset: Dataset, stored: Stored, report: Report, progress: Progress) -> dict[int, bool]:
    """Checks the data files; returns each episode's success."""
    successes: dict[int, bool] = {}
    total, workspace, ours = _count_rows(dataset), dataset.workspace, contract_of(dataset.features)
    by_file: dict[str, list[Episode]] = {}
    for episode in dataset.episodes:
        by_file.setdefault(episode.file, []).append(episode)
    for name, episodes in by_file.items():
        content = read_rows(dataset, name, episodes, report)
        if content is None:
            continue
        where, table = content
        columns = check_values(where, table, dataset.features, workspace, report)
        if has_facts(dataset):
            check_course(where, columns, report)
        report.damaged |= set(where.episodes.tolist()) - set(dataset.row_of)
        check_episode_statistics(where, columns, stored, dataset.row_of, report, ours=ours)
        if schema.SUCCESS in columns:
            successes |= {number: bool(columns[schema.SUCCESS][rows].any()) for number, rows in where.runs()}
        report.rows += len(where)
        progress("rows", report.rows, total)
    return successes


def read_metadata(root: Path, report: Report) -> Dataset | None:
    """Opens a dataset and checks its metadata; returns None, with a finding, if it cannot be opened."""
    try:
        dataset = Dataset(root, on_damage=report.add)
    except DatasetError as error:
        cause = error.__cause__ or error
        if isinstance(cause, FileNotFoundError):
            report.add("missing", "the description of the dataset", INFO)
        elif isinstance(cause, OtherFormatError):
            report.add("metadata", f"{cause}; {conversion_command(root)} converts v2.1", INFO)
        else:
            kind = "untrusted" if isinstance(cause, UntrustedValueError) else "unreadable"
            report.add(kind, str(cause)[:200], INFO)
        return None
    _check_counts(dataset, report)
    _check_order(dataset, report)
    return dataset


def _check_counts(dataset: Dataset, report: Report) -> None:
    info, tasks, listed, rows = dataset.info, dataset.tasks, len(dataset.table), _count_rows(dataset)
    if not listed and not report.counts["unreadable"]:
        report.add("missing", "metadata of the episodes", "meta/episodes")
    if info["total_episodes"] != listed:
        report.add("count", f"total_episodes = {info['total_episodes']}, but there is metadata of {listed}", INFO)
    elif info["total_frames"] != rows and len(dataset.episodes) == listed:
        report.add("count", f"total_frames = {info['total_frames']}, but the episodes have {rows} rows", INFO)
    if tasks and info.get("total_tasks") != len(tasks):
        report.add("count", f"total_tasks = {info.get('total_tasks')}, but there are {len(tasks)}", INFO)


def _count_rows(dataset: Dataset) -> int:
    return sum(episode.length for episode in dataset.episodes)


def _check_order(dataset: Dataset, report: Report) -> None:
    """Checks that episodes and their rows are consecutive, and that lengths match the ranges of rows."""
    row = 0
    for expected, episode in enumerate(dataset.episodes):
        place = episode.listed_in, episode.number
        if episode.number != expected:
            missing = "is there twice" if episode.number < expected else f"follows episode {expected - 1}"
            report.add("metadata", f"episode {episode.number} {missing}", *place)
            return
        span = f"rows {episode.start} to {episode.end}, length {episode.length}"
        if episode.end - episode.start != episode.length or episode.length == 0:
            report.add("metadata", span, *place)
        elif episode.start != row:
            report.add("metadata", f"{span}, where row {row} is the next", *place)
        row = episode.end
        for key, part in episode.videos.items():
            if abs(part.end - part.start - episode.length / dataset.fps) > _FRAME:
                lengths = f"{part.end - part.start:.3f} s of {key} for {episode.length} rows at {dataset.fps}/s"
                report.add("video-length", lengths, *place)


def leftovers(root: Path) -> Iterator[Path]:
    """Yields temporary files and folders of a killed process."""
    yield from sorted(root.rglob(".*.tmp"))
    yield from sorted(path for path in root.glob("tmp*") if path.is_dir())  # LeRobot encodes videos there
    if any(path.is_file() for path in (root / "images").rglob("*")):  # LeRobot always leaves it, but empty
        yield root / "images"


def _unlisted_files(dataset: Dataset) -> Iterator[str]:
    """Yields Parquet and video files that belong to no episode."""
    known = {episode.file for episode in dataset.episodes}
    known |= {part.file for episode in dataset.episodes for part in episode.videos.values()}
    for pattern in ("data/*/*.parquet", "videos/*/*/*.mp4"):
        names = (path.relative_to(dataset.root).as_posix() for path in sorted(dataset.root.glob(pattern)))
        yield from (name for name in names if name not in known)
