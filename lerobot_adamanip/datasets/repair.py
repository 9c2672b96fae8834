"""Repair a dataset after its recorder was killed.

Our robots' recorder (`lerobot_patches.durable_recording`) writes separate files for every episode, and counts the
episode in ``meta/info.json`` last. A repair keeps the counted episodes and moves everything else to
``<dataset>.before-repair``. It deletes nothing.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from lerobot_adamanip.datasets.check.dataset import CAMERAS, lacks_cameras, leftovers, read_metadata
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.check.statistics import check_statistics, repaired_statistics, stored_statistics
from lerobot_adamanip.datasets.dataset import STATS, Dataset
from lerobot_adamanip.datasets.opening import first_line, require_dataset
from lerobot_adamanip.datasets.output_folder import INFO, lock_output, resolve_output
from lerobot_adamanip.datasets.statistics import plain_statistics
from lerobot_adamanip.datasets.writing import camera_records, cameras_json
from lerobot_adamanip.util import files


@dataclass
class Repair:
    """Result of a repair.

    Attributes:
        root: folder of the dataset.
        backup: folder with the originals of all moved or changed files; absent if there are none.
        mended: one line per change, in order.
        left: one line per damage that remains.
    """

    root: Path
    backup: Path
    mended: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Returns the result as text."""
        lines = [f"repaired: {line}" for line in self.mended]
        lines += [f"not repaired: {line}" for line in self.left]
        if self.backup.exists():
            lines.append(f"originals: {self.backup}")
        return lines

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        backup = str(self.backup) if self.backup.exists() else None
        return {"mended": self.mended, "left": self.left, "backup": backup}

    def move_away(self, path: Path, why: str) -> None:
        """Moves a file or folder into the backup."""
        self._back_up(path, shutil.move)
        self._note(path, f"moved away, {why}")

    def replace(self, path: Path, content: Mapping[str, Any], what: str) -> None:
        """Writes a JSON file, after copying the old one into the backup."""
        if path.exists():
            self._back_up(path, shutil.copy2)
        files.write_atomically(path, (json.dumps(content, indent=4) + "\n").encode())
        self._note(path, what)

    def _back_up(self, path: Path, move: Callable[[Path, Path], object]) -> None:
        place = self.backup / path.relative_to(self.root)
        while place.exists():
            place = place.with_name(place.name + ".again")
        place.parent.mkdir(parents=True, exist_ok=True)
        move(path, place)
        files.crash_point("moved aside")

    def _note(self, path: Path, what: str) -> None:
        self.mended.append(f"{path.relative_to(self.root).as_posix()}: {what}")
        files.crash_point("partly mended")


def repair(root: str | Path) -> Repair:
    """Repairs a dataset whose recorder was killed. Can be interrupted and rerun.

    Raises:
        DatasetError: there is no dataset, or another command uses it.
    """
    folder = resolve_output(require_dataset(root))
    done = Repair(folder, folder.with_name(folder.name + ".before-repair"))
    with lock_output(folder, optional=True):
        for path in list(leftovers(folder)):
            done.move_away(path, "left by a process that ended early")
        report = Report()
        dataset = read_metadata(folder, report)
        if dataset is None or report.counts["metadata"]:
            done.left.append(str(next(each for each in report.findings if dataset is None or each.kind == "metadata")))
        elif not (counted := dataset.info["total_episodes"]):
            done.left.append(f"{INFO} counts no episode: none was saved")
        elif len(dataset.episodes) < counted:
            done.left.append(
                f"{INFO} counts {counted} episodes, and meta/episodes describes {len(dataset.episodes)} of them. No "
                "kill of this project's recorders does that; get the files of meta/episodes back from a copy"
            )
        else:
            _move_uncounted(done, dataset)
            _write_totals(done)
            _write_cameras(done, dataset)
    return done


def _move_uncounted(done: Repair, dataset: Dataset) -> None:
    described = {each.listed_in for each in dataset.episodes if each.number < dataset.info["total_episodes"]}
    kept = [each for each in dataset.episodes if each.listed_in in described]
    used = described | {each.file for each in kept} | {part.file for each in kept for part in each.videos.values()}
    for pattern in ("meta/episodes/*/*.parquet", "data/*/*.parquet", "videos/*/*/*.mp4"):
        for path in sorted(done.root.glob(pattern)):
            if path.relative_to(done.root).as_posix() not in used:
                done.move_away(path, "no saved episode is in it")


def _write_totals(done: Repair) -> None:
    dataset = read_metadata(done.root, Report())
    assert dataset is not None
    stored_totals = {name: dataset.info.get(name) for name in ("total_episodes", "total_frames", "total_tasks")}
    tasks = len(dataset.tasks) or stored_totals["total_tasks"]
    rows = sum(episode.length for episode in dataset.episodes)
    true = {"total_episodes": len(dataset.episodes), "total_frames": rows, "total_tasks": tasks}
    if stored_totals != true:
        info = {**dataset.info, **true, "splits": {"train": f"0:{len(dataset.episodes)}"}}
        done.replace(done.root / INFO, info, f"{len(dataset.episodes)} episodes, {rows} rows, counted again")
        dataset.info.update(true)
    report, stored = Report(), stored_statistics(dataset.statistics)
    check_statistics(dataset, stored, report)
    if report.counts:
        try:
            stats = repaired_statistics(dataset, stored)
        except (OSError, pa.ArrowException) as error:
            done.left.append(f"{STATS}: the rows cannot be read: {first_line(error)}")
            return
        done.replace(done.root / STATS, plain_statistics(stats), "computed again from the rows")


def _write_cameras(done: Repair, dataset: Dataset) -> None:
    """Writes lost parameters of cameras again, from the column of the episodes that has them."""
    if lacks_cameras(dataset) and (cameras := camera_records(dataset.table)):
        done.replace(done.root / CAMERAS, json.loads(cameras_json(cameras)), "written again from the episodes")
