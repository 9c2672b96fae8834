"""Mending what a kill leaves behind. Every episode whose saving had ended stays; nothing recorded is deleted.

A dataset ends somewhere: up to an episode everything is there, rows, frames, metadata; after it lies what a process was
writing when it died. The first part is kept and described anew where its description is missing, the second part is
moved into ``<dataset>.before-repair``. Where episodes are whole *after* a damaged one no kill has done it, and nothing
is changed.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_adamanip.datasets.check.dataset import require_dataset
from lerobot_adamanip.datasets.check.findings import Progress, Report, listed
from lerobot_adamanip.datasets.check.flat_clouds import flatten_clouds
from lerobot_adamanip.datasets.check.inventory import Found, Run, Videos, data_files, find_episodes, frames_of, runs_of
from lerobot_adamanip.datasets.check.layout import INFO, STATS, TASKS, Episode, Layout, leftovers, read_layout
from lerobot_adamanip.datasets.check.rebuild import (
    episode_row,
    guessed_info,
    next_episode_file,
    write_episode_rows,
    write_info,
    write_statistics,
    write_tasks,
)
from lerobot_adamanip.datasets.check.salvage import salvage
from lerobot_adamanip.datasets.check.statistics import aggregated, check_statistics, stored_statistics
from lerobot_adamanip.datasets.check.trim import keep_frames, keep_rows
from lerobot_adamanip.datasets.output_folder import lock_output, require_not_written, resolve_output
from lerobot_adamanip.datasets.reading import read_info
from lerobot_adamanip.datasets.statistics import write_episodes
from lerobot_adamanip.util import files


@dataclass
class Repair:
    """What was done.

    Attributes:
        root: of the dataset.
        backup: where what was taken out, or changed, lies as it was; used only if something was.
        mended: lines, in order.
        left: lines about what cannot be mended.
    """

    root: Path
    backup: Path
    mended: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Returns what a person is told."""
        told = [f"mended: {line}" for line in self.mended] + [f"cannot be mended: {line}" for line in self.left]
        return told + ([f"what was there before: {self.backup}"] if self.backup.exists() else [])

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        backup = str(self.backup) if self.backup.exists() else None
        return {"mended": self.mended, "left": self.left, "backup": backup}

    def did(self, line: str) -> None:
        """Notes what was mended."""
        self.mended.append(line)
        files.crash_point("partly mended")

    def keep(self, name: str, *, move: bool) -> None:
        """Puts a file or folder of the dataset, as it is, into the backup, unless one of that name is there already."""
        source, target = self.root / name, self.backup / name
        if not source.exists():
            return
        while target.exists():
            target = target.with_name(target.name + ".again")
        target.parent.mkdir(parents=True, exist_ok=True)
        if move:
            shutil.move(source, target)
        elif source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copy2(source, target)
        files.crash_point("moved aside")


def repair(root: str | Path, *, progress: Progress = lambda stage, done, total: None) -> Repair:
    """Mends a dataset that a process which died has left.

    It can be interrupted, and run again. What no kill does it leaves as it is: see `Repair.left`.

    Args:
        root: of the dataset.
        progress: told of stage ``rows``, data files looked at, and all.

    Raises:
        DatasetError: there is no dataset, or a process is writing it.
    """
    folder = resolve_output(require_dataset(root))
    done = Repair(folder, folder.with_name(folder.name + ".before-repair"))
    with lock_output(folder, optional=True):
        require_not_written(folder)
        _repair(done, progress)
    return done


def _repair(done: Repair, progress: Progress) -> None:
    _move_leftovers(done)
    layout = _described(done)
    if layout is not None:
        _keep_whole_episodes(done, layout, progress)
        _flatten(done)


def _keep_whole_episodes(done: Repair, layout: Layout, progress: Progress) -> None:
    runs: list[Run] = []
    names = data_files(done.root)
    for number, name in enumerate(names, start=1):
        runs += _runs(done, layout, name)
        progress("rows", number, len(names))
    listed_ones = {episode.number: episode for episode in layout.episodes}
    videos = {key: Videos.of(done.root, key, layout.fps) for key in layout.video_keys}
    found, later = find_episodes(runs, listed_ones, videos)
    if later:
        damaged, whole = len(found), listed(later)
        done.left.append(
            f"episode {damaged} is damaged and episodes after it ({whole}) are whole: no kill does that. "
            "Take it out with `adamanip filter`, or get its file back"
        )
        return
    if not found:
        done.left.append("no episode is there in full")
        return
    _mend(done, layout, found, runs)


def _flatten(done: Repair) -> None:
    try:
        if flatten_clouds(done.root, lambda name: done.keep(name, move=False)):
            done.did(f"{POINT_CLOUD}: rows of 3 N numbers, where they were of (N, 3)")
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException) as error:
        done.left.append(f"{POINT_CLOUD}: its clouds (N, 3) cannot be stored as rows of 3 N numbers: {error}")


def _move_leftovers(done: Repair) -> None:
    for path in list(leftovers(done.root)):
        name = path.relative_to(done.root).as_posix()
        done.keep(name, move=True)
        done.did(f"{name}: moved away")


def _described(done: Repair) -> Layout | None:
    """Returns what the metadata say, with ``meta/info.json`` made again if it is lost."""
    try:
        read_info(done.root)
    except (OSError, ValueError) as error:
        guesses = (guessed_info(done.root, name) for name in data_files(done.root))
        info = next((guess for guess in guesses if guess is not None), None)
        if info is None:
            done.left.append(f"{INFO}: {error}; its columns are not the contract's alone, so they cannot be guessed")
            return None
        done.keep(INFO, move=False)
        write_info(done.root, info, 0, 0, 0)
        done.did(f"{INFO}: made again from the columns of the data")
    return read_layout(done.root, Report())


def _runs(done: Repair, layout: Layout, name: str) -> list[Run]:
    """Returns the episodes in a data file, which is given its lost end first."""
    runs = runs_of(done.root, name)
    if runs is not None:
        return runs
    saved = salvage(done.root / name, layout.features)
    if saved is None:
        return []
    done.keep(name, move=False)
    files.write_atomically(done.root / name, saved[0])
    done.did(f"{name}: {saved[1]} rows before the cut can be read again")
    return runs_of(done.root, name) or []


def _mend(done: Repair, layout: Layout, found: list[Found], runs: list[Run]) -> None:
    tasks = _tasks(done, layout, found)
    if tasks is None:
        return
    _cut_data(done, found, runs)
    _cut_videos(done, layout, found)
    _write_episodes(done, layout, found, tasks)
    _write_totals(done, layout, found, tasks)


def _tasks(done: Repair, layout: Layout, found: list[Found]) -> dict[int, str] | None:
    """Returns the texts of tasks, made again from the episodes' if they are lost; None if some cannot be."""
    by_number: Mapping[int, Episode] = {episode.number: episode for episode in layout.episodes}
    tasks, needed = dict(layout.tasks), {index for each in found for index in each.run.tasks}
    for each in found:
        episode = by_number.get(each.run.number)
        if episode is not None and len(episode.tasks) == len(each.run.tasks) == 1:
            tasks.setdefault(each.run.tasks[0], episode.tasks[0])
    if lost := sorted(needed - set(tasks)):
        done.left.append(f"{TASKS}: the text of task {listed(lost)} is lost")
        return None
    if tasks != layout.tasks or not layout.tasks:
        done.keep(TASKS, move=False)
        write_tasks(done.root, tasks)
        done.did(f"{TASKS}: made again from the episodes")
    return tasks


def _cut_data(done: Repair, found: list[Found], runs: list[Run]) -> None:
    """Takes out the rows after the last whole episode."""
    ends: dict[str, int] = {}
    for each in found:
        ends[each.run.file] = each.run.at + each.run.length
    for name in data_files(done.root):
        rows = sum(run.length for run in runs if run.file == name)
        if name not in ends:
            done.keep(name, move=True)
            done.did(f"{name}: moved away, no whole episode is in it")
        elif ends[name] < rows:
            done.keep(name, move=False)
            keep_rows(done.root / name, ends[name])
            done.did(f"{name}: {rows - ends[name]} rows after the last whole episode taken out")


def _cut_videos(done: Repair, layout: Layout, found: list[Found]) -> None:
    """Takes out the frames after those of the last whole episode."""
    for key in layout.video_keys:
        ends: dict[str, int] = {}
        for each in found:
            part = each.videos[key]
            ends[part.file] = max(ends.get(part.file, 0), round(part.end * layout.fps))
        for path in sorted((done.root / "videos" / key).glob("*/*.mp4")):
            name = path.relative_to(done.root).as_posix()
            if name not in ends:
                done.keep(name, move=True)
                done.did(f"{name}: moved away, no whole episode is in it")
            elif (after := frames_of(path) - ends[name]) > 0:
                done.keep(name, move=False)
                if keep_frames(path, ends[name]):
                    done.did(f"{name}: {after} frames after the last whole episode taken out")
                else:
                    done.left.append(f"{name}: {after} frames after the last episode cannot be cut off")


def _write_episodes(done: Repair, layout: Layout, found: list[Found], tasks: Mapping[int, str]) -> None:
    """Drops metadata of episodes that are not there, and writes that of those that have none."""
    kept = {each.run.number for each in found if each.listed}
    listed_in = set(layout.table["listed_in"].to_pylist()) if len(layout.table) else set()
    for path in sorted((done.root / "meta" / "episodes").glob("*/*.parquet")):
        name = path.relative_to(done.root).as_posix()
        mine = layout.table.filter(pc.equal(layout.table["listed_in"], name)) if name in listed_in else None
        gone = None if mine is None else [number for number in mine["episode_index"].to_pylist() if number not in kept]
        if mine is None or len(gone or ()) == len(mine):
            done.keep(name, move=True)
            done.did(f"{name}: moved away, it tells of no whole episode")
        elif gone:
            done.keep(name, move=False)
            left = mine.filter(pc.is_in(mine["episode_index"], pa.array(sorted(kept), pa.int64())))
            write_episodes(path, left.drop_columns(["listed_in"]))
            done.did(f"{name}: metadata of episode {listed(gone)}, which is not there in full, taken out")
    new = [each for each in found if not each.listed]
    if new:
        place = next_episode_file(done.root)
        rows = [episode_row(done.root, each, layout.features, tasks, place) for each in new]
        write_episode_rows(done.root, rows, place, layout.table.slice(0, 0) if kept else pa.table({}))
        done.did(f"{place}: metadata of {len(new)} episodes made again from their rows")


def _write_totals(done: Repair, layout: Layout, found: list[Found], tasks: Mapping[int, str]) -> None:
    rows = sum(each.run.length for each in found)
    told = tuple(layout.info.get(name) for name in ("total_episodes", "total_frames", "total_tasks"))
    if told != (len(found), rows, len(tasks)):
        done.keep(INFO, move=False)
        write_info(done.root, layout.info, len(found), rows, len(tasks))
        done.did(f"{INFO}: {len(found)} episodes, {rows} rows, where it said {told[0]} and {told[1]}")
    report = Report()
    again = read_layout(done.root, Report())
    if again is None:
        return
    stored = stored_statistics(again.table)
    check_statistics(again, stored, report)
    if not report.clean:
        done.keep(STATS, move=False)
        write_statistics(done.root, aggregated(stored, again.picture_keys))
        done.did(f"{STATS}: computed again from the episodes")
