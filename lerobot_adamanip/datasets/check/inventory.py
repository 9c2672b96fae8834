"""What is really there: which episodes have all their rows and all their frames, whatever the metadata counts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.datasets.check.layout import Episode, VideoPart
from lerobot_adamanip.datasets.check.reading import numeric

_PLACE = ("episode_index", "frame_index", "index", "task_index")


@dataclass(frozen=True)
class Run:
    """Rows of one episode as they lie in a data file.

    Attributes:
        number: their episode_index.
        file: path within the dataset.
        at: first of them in the file.
        length: how many.
        start: index of the first.
        tasks: their task_index, each once.
        whole: whether frames count from 0 and indices follow each other.
    """

    number: int
    file: str
    at: int
    length: int
    start: int
    tasks: tuple[int, ...]
    whole: bool


def runs_of(root: Path, name: str) -> list[Run] | None:
    """Returns the episodes in a data file, in its order; None if it cannot be read, or does not say."""
    try:
        table = pq.read_table(root / name, columns=list(_PLACE))
    except (OSError, pa.ArrowException):
        return None
    told: dict[str, Any] = {key: numeric(table, key) for key in _PLACE}
    if any(column is None for column in told.values()):
        return None
    episodes = told["episode_index"]
    starts = np.flatnonzero(np.r_[True, np.diff(episodes) != 0]).tolist()
    runs = []
    for start, end in zip(starts, [*starts[1:], len(episodes)], strict=True):
        frames, indices = told["frame_index"][start:end], told["index"][start:end]
        counts = np.arange(end - start)
        whole = bool((frames == counts).all() and (indices == indices[0] + counts).all())
        tasks = tuple(sorted(set(told["task_index"][start:end].tolist())))
        runs.append(Run(int(episodes[start]), name, start, end - start, int(indices[0]), tasks, whole))
    return runs


def data_files(root: Path) -> list[str]:
    """Returns the data files, in the order LeRobot writes them."""
    return [path.relative_to(root).as_posix() for path in sorted((root / "data").glob("*/*.parquet"))]


def frames_of(path: Path) -> int:
    """Returns how many frames of a video are there; 0 of one that cannot be opened."""
    import av

    frames = 0
    try:
        with av.open(str(path)) as container:
            for packet in container.demux(container.streams.video[0]):
                frames += packet.size > 0
    except (av.FFmpegError, IndexError, OSError):
        return frames  # up to where it is cut off
    return frames


@dataclass
class Videos:
    """Frames of a column's videos, file by file, and how many of them episodes have taken so far.

    Attributes:
        key: column.
        fps: frames per second.
        frames: file -> frames, in the order LeRobot writes them.
        taken: file -> frames that are episodes'.
    """

    key: str
    fps: int
    frames: dict[str, int]
    taken: dict[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, root: Path, key: str, fps: int) -> Videos:
        """Counts the frames of all videos of a column."""
        paths = sorted((root / "videos" / key).glob("*/*.mp4"))
        return cls(key, fps, {path.relative_to(root).as_posix(): frames_of(path) for path in paths})

    def take(self, part: VideoPart, length: int) -> bool:
        """Takes the frames that metadata names for an episode; whether they are there."""
        first = round(part.start * self.fps)
        if first + length > self.frames.get(part.file, 0) or first < self.taken.get(part.file, 0):
            return False
        self.taken[part.file] = first + length
        return True

    def find(self, length: int) -> VideoPart | None:
        """Takes the next frames for an episode without metadata: of the latest file, or of the one after it."""
        files = list(self.frames)
        latest = max((files.index(file) for file in self.taken), default=0)
        for file in files[latest : latest + 2]:
            first = self.taken.get(file, 0)
            if first + length <= self.frames[file]:
                self.taken[file] = first + length
                return VideoPart(file, first / self.fps, (first + length) / self.fps)
        return None


@dataclass(frozen=True)
class Found:
    """An episode that is there in full.

    Attributes:
        run: its rows.
        videos: column -> where its frames are.
        listed: whether its metadata is there.
    """

    run: Run
    videos: dict[str, VideoPart]
    listed: bool


def find_episodes(
    runs: Iterable[Run], listed: Mapping[int, Episode], videos: Mapping[str, Videos]
) -> tuple[list[Found], list[int]]:
    """Returns the episodes that are there in full, from the first on without a gap, and those that are so after it."""
    found: list[Found] = []
    later: list[int] = []
    end = 0
    for run in runs:
        episode = listed.get(run.number)
        whole = run.whole and (episode is None or _agree(run, episode))
        parts = _parts(run, episode, videos) if whole else None
        if parts is None:
            continue
        if run.number == len(found) and run.start == end and not later:
            found.append(Found(run, parts, episode is not None))
            end += run.length
        elif run.number >= len(found):
            later.append(run.number)
    return found, later


def _agree(run: Run, episode: Episode) -> bool:
    told = (episode.length, episode.start, episode.end, episode.file)
    return told == (run.length, run.start, run.start + run.length, run.file)


def _parts(run: Run, episode: Episode | None, videos: Mapping[str, Videos]) -> dict[str, VideoPart] | None:
    """Returns where an episode's frames are; None if any are not there."""
    parts = {}
    for key, video in videos.items():
        if episode is not None:
            part: VideoPart | None = episode.videos[key]
            if part is None or not video.take(part, run.length):
                return None
        else:
            part = video.find(run.length)
        if part is None:
            return None
        parts[key] = part
    return parts


def file_numbers(name: str) -> tuple[int, int]:
    """Returns chunk and file of ``.../chunk-000/file-001.parquet``."""
    path = Path(name)
    return int(path.parent.name.rpartition("-")[2]), int(path.stem.rpartition("-")[2])
