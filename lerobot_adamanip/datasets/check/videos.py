"""Check videos: decode every frame; compare number and times with the rows, and colours with the statistics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.check.layout import Episode, Layout
from lerobot_adamanip.datasets.check.statistics import Stored

CONTENT = 0.08
"""Largest difference of an episode's mean colour from the recorded one, of 1: coding is lossy."""


Frame = tuple[float, NDArray[np.float64], tuple[int, int]]
"""Time [s], mean colour (3,) of 0 to 1, height and width [px]."""


def _decoded(path: Path) -> Iterator[Frame]:
    """Yields the frames of a video; raises OSError where decoding fails."""
    import av

    av.logging.set_libav_level(av.logging.FATAL)
    try:
        with av.open(str(path)) as container:
            for frame in container.decode(video=0):
                picture = frame.to_ndarray(format="rgb24")
                colour = picture.reshape(-1, 3).mean(axis=0) / 255.0
                yield float(frame.time or 0.0), colour, (picture.shape[0], picture.shape[1])
    except (av.FFmpegError, IndexError, ValueError) as error:
        raise OSError(f"cannot be decoded: {error}") from error


def check_videos(layout: Layout, stored: Stored, report: Report, progress: Callable[[], None]) -> None:
    """Checks every video that an episode is in.

    Args:
        layout: of the dataset.
        stored: statistics of the episodes.
        report: takes the findings.
        progress: called after each frame.
    """
    for (key, file), episodes in layout.by_video_file().items():
        path = layout.root / file
        if not path.is_file():
            report.add("missing", f"{key} of the episode, and of what follows in this file", file, episodes[0].number)
            continue
        video = _Video(layout, key, file, sorted(episodes, key=lambda each: each.videos[key].start), report)
        video.read(path, progress)
        means = stored.get(key, {}).get("mean")
        if means is not None and means.shape[1] == 3:
            video.compare(means, layout.row_of)


class _Video:
    """A video file, and the mean colour of each of its episodes."""

    def __init__(self, layout: Layout, key: str, file: str, episodes: Sequence[Episode], report: Report) -> None:
        self._key, self._file, self._fps, self._report = key, file, layout.fps, report
        feature = layout.features[key]
        self._size = tuple(feature["shape"][:2])
        self._is_depth = bool((feature.get("info") or {}).get("is_depth_map", False))
        self._episodes = list(episodes)
        starts = [round(each.videos[key].start * layout.fps) for each in episodes]
        self._spans = [(start, start + each.length) for start, each in zip(starts, episodes, strict=True)]
        self._sums = np.zeros((len(episodes), 3))
        self._counts = np.zeros(len(episodes), np.int64)

    def read(self, path: Path, progress: Callable[[], None]) -> None:
        """Decodes the file and checks number, size and times of its frames."""
        total, broken = 0, ""
        try:
            for time, colour, size in _decoded(path):
                if total == 0 and size != self._size:
                    told = f"{self._key} has frames of {size}, not {self._size}"
                    self._report.add("schema", told, self._file, self._episodes[0].number)
                self._take(total, time, colour)
                total += 1
                progress()
        except OSError as error:
            broken = str(error)[:200]
        self._check_length(total, broken)

    def _take(self, number: int, time: float, colour: NDArray[np.float64]) -> None:
        place = next((at for at, (start, end) in enumerate(self._spans) if start <= number < end), None)
        if place is None:
            return
        self._sums[place] += colour
        self._counts[place] += 1
        if abs(time - number / self._fps) > 1e-3 and self._episodes[place].number not in self._report.damaged:
            first = self._spans[place][0]
            told = f"a frame of {self._key} is shown at {time:.3f} s, not {number / self._fps:.3f}"
            self._report.add("timestamp", told, self._file, self._episodes[place].number, number - first)

    def _check_length(self, total: int, broken: str) -> None:
        cut = [(each, span) for each, span in zip(self._episodes, self._spans, strict=True) if span[1] > total]
        if broken:
            where = cut[0] if cut else None
            frame = None if where is None else max(0, total - where[1][0])
            self._report.add("unreadable", broken, self._file, None if where is None else where[0].number, frame)
            return
        for episode, (start, end) in cut:
            told = f"{max(0, total - start)} frames of {self._key} for {end - start} rows"
            self._report.add("video-length", told, self._file, episode.number, max(0, total - start))
        after = total - max(end for _, end in self._spans)
        if after > 0:
            self._report.add("unlisted", f"{after} frames of {self._key} after those of the last episode", self._file)

    def compare(self, means: NDArray[np.float64], row_of: dict[int, int]) -> None:
        """Compares mean colours with the episodes' statistics."""
        for place, episode in enumerate(self._episodes):
            whole = self._counts[place] == episode.length
            if self._is_depth or not whole or episode.number in self._report.damaged:
                continue
            shown: Any = self._sums[place] / self._counts[place]
            recorded = means[row_of[episode.number]]
            if np.abs(shown - recorded).max() > CONTENT:
                told = f"{self._key}: mean colour {shown.round(2).tolist()}, recorded {recorded.round(2).tolist()}"
                self._report.add("video-content", told, self._file, episode.number)
