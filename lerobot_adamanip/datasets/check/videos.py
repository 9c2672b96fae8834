"""Check videos: decode all frames, compare number and times with the rows, and colours with the statistics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.check.statistics import Stored
from lerobot_adamanip.datasets.dataset import Dataset, Episode
from lerobot_adamanip.datasets.opening import UntrustedValueError, check_video
from lerobot_adamanip.util.video import open_mp4

CONTENT = 0.08
"""Largest difference of an episode's mean colour [0 ... 1] from its statistics, because coding is lossy."""

Frame = tuple[float, NDArray[np.float64], tuple[int, int]]
"""Time [s], mean colour (3,) of 0 to 1, height and width [px]."""


def check_videos(dataset: Dataset, stored: Stored, report: Report, progress: Callable[[], None]) -> None:
    """Checks all videos of the episodes; calls ``progress`` after each frame."""
    for (key, file), listed in _by_file(dataset).items():
        if not (dataset.root / file).is_file():
            report.add("missing", f"{key} of this and the following episodes in this file", file, listed[0].number)
            continue
        try:
            check_video(dataset.root / file)
        except UntrustedValueError as error:
            report.add("untrusted", str(error), file, listed[0].number)
            continue
        frames, broken = _decode(dataset.root / file, progress)
        size = tuple(dataset.features[key]["shape"][:2])
        if frames and frames[0][2] != size:
            report.add("schema", f"{key} has frames of {frames[0][2]}, not {size}", file, listed[0].number)
        end = 0
        for episode in sorted(listed, key=lambda each: each.videos[key].start):
            start = round(episode.videos[key].start * dataset.fps)
            end = start + episode.length
            for problem in _check_frames(dataset, key, episode, frames[start:end], stored):
                if episode.number not in report.damaged:
                    report.add(problem[0], problem[1], file, episode.number, problem[2])
            if end > len(frames):
                there = max(0, len(frames) - start)
                kind = "unreadable" if broken else "video-length"
                message = broken or f"{there} frames of {key} for {episode.length} rows"
                report.add(kind, message, file, episode.number, there)
                if broken:
                    break
        else:
            if broken:
                report.add("unreadable", broken, file)
            elif len(frames) > end:
                report.add("unlisted", f"{len(frames) - end} frames of {key} after the last episode", file)


def _by_file(dataset: Dataset) -> dict[tuple[str, str], list[Episode]]:
    """Returns (column, video file) -> its episodes, in order."""
    files: dict[tuple[str, str], list[Episode]] = {}
    for episode in dataset.episodes:
        for key, part in episode.videos.items():
            files.setdefault((key, part.file), []).append(episode)
    return files


def _check_frames(
    dataset: Dataset, key: str, episode: Episode, frames: Sequence[Frame], stored: Stored
) -> Iterator[tuple[str, str, int | None]]:
    """Yields findings (kind, message, frame) about an episode's frame times and mean colour."""
    begin = round(episode.videos[key].start * dataset.fps)
    for number, (time, *_) in enumerate(frames):
        due = (begin + number) / dataset.fps
        if abs(time - due) > 1e-3:
            yield "timestamp", f"a frame of {key} is shown at {time:.3f} s, not {due:.3f}", number
    means = stored.get(key, {}).get("mean")
    is_depth = (dataset.features[key].get("info") or {}).get("is_depth_map", False)
    if means is None or means.shape[1] != 3 or is_depth or len(frames) < episode.length:
        return
    shown = np.mean([colour for _, colour, _ in frames], axis=0)
    recorded = means[dataset.row_of[episode.number]]
    if np.abs(shown - recorded).max() > CONTENT:
        message = f"{key}: mean colour {shown.round(2).tolist()}, recorded {recorded.round(2).tolist()}"
        yield "video-content", message, None


def _decode(path: Path, progress: Callable[[], None]) -> tuple[list[Frame], str]:
    """Returns the frames of a video, and the reason if decoding stopped after them, else an empty text."""
    import av

    av.logging.set_libav_level(av.logging.FATAL)
    frames: list[Frame] = []
    try:
        with open_mp4(path) as container:
            for frame in container.decode(video=0):
                picture = frame.to_ndarray(format="rgb24")
                colour = picture.reshape(-1, 3).mean(axis=0) / 255.0
                frames.append((float(frame.time or 0.0), colour, (picture.shape[0], picture.shape[1])))
                progress()
    except (av.FFmpegError, OSError, IndexError, ValueError) as error:
        return frames, f"cannot be decoded: {error}"[:200]
    return frames, ""
