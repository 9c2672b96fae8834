"""Read and check a dataset's metadata: features, tasks, episodes and their files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.datasets.check.findings import Report, first_line
from lerobot_adamanip.datasets.description import (
    DATA_PATH,
    TASK,
    VIDEO_PATH,
    OtherFormatError,
    UntrustedValueError,
    check_episode_text,
)
from lerobot_adamanip.datasets.reading import conversion_command, read_episodes, read_info

INFO, STATS, TASKS, CAMERAS, ATTEMPTS = (
    f"meta/{name}" for name in ("info.json", "stats.json", "tasks.parquet", "cameras.json", "attempts.jsonl")
)
_FRAME = 1e-3
"""Largest difference of equal times [s]; LeRobot stores them as sums of durations."""


class VideoPart(NamedTuple):
    """Place of an episode's frames: path within the dataset, and times within the file [s]."""

    file: str
    start: float
    end: float


class Episode(NamedTuple):
    """Metadata of an episode: index, length, files, and its range of dataset rows (``end`` excluded)."""

    number: int
    length: int
    file: str
    start: int
    end: int
    tasks: tuple[str, ...]
    listed_in: str
    videos: dict[str, VideoPart]


@dataclass(frozen=True)
class Layout:
    """A dataset's metadata.

    Attributes:
        root: its folder.
        info: ``meta/info.json``.
        tasks: task_index -> text.
        episodes: in order.
        table: rows of ``meta/episodes``, in the same order; column ``listed_in`` has the file of each.
    """

    root: Path
    info: dict[str, Any]
    tasks: dict[int, str]
    episodes: list[Episode]
    table: pa.Table

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """Columns, in LeRobot's description."""
        found: dict[str, dict[str, Any]] = self.info["features"]
        return found

    @property
    def fps(self) -> int:
        """Rows per second."""
        return int(self.info["fps"])

    def keys_of(self, *dtypes: str) -> list[str]:
        """Returns the columns of the given types."""
        return [key for key, feature in self.features.items() if feature["dtype"] in dtypes]

    @property
    def picture_keys(self) -> list[str]:
        """Columns of images and videos, whose statistics are of colours."""
        return self.keys_of("video", "image")

    @property
    def data_keys(self) -> list[str]:
        """Columns in the Parquet files."""
        return [key for key in self.features if key not in self.keys_of("video")]

    @property
    def rows(self) -> int:
        """Number of rows of all episodes, from the metadata."""
        return sum(episode.length for episode in self.episodes)

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Index of an episode -> its row in `table`."""
        return {number: row for row, number in enumerate(self.table["episode_index"].to_pylist())}

    def by_data_file(self) -> dict[str, list[Episode]]:
        """Returns data file -> its episodes, in order."""
        found: dict[str, list[Episode]] = {}
        for episode in self.episodes:
            found.setdefault(episode.file, []).append(episode)
        return found

    def by_video_file(self) -> dict[tuple[str, str], list[Episode]]:
        """Returns (column, video file) -> its episodes, in order."""
        found: dict[tuple[str, str], list[Episode]] = {}
        for episode in self.episodes:
            for key, part in episode.videos.items():
                found.setdefault((key, part.file), []).append(episode)
        return found


def read_layout(root: Path, report: Report) -> Layout | None:
    """Reads the metadata; returns None, with findings, if the rest cannot be read without it."""
    try:
        info = read_info(root)
    except FileNotFoundError:
        report.add("missing", "the description of the dataset", INFO)
        return None
    except OtherFormatError as error:
        report.add("metadata", f"{error}; {conversion_command(root)} converts v2.1", INFO)
        return None
    except UntrustedValueError as error:
        report.add("untrusted", str(error)[:200], INFO)
        return None
    except (OSError, ValueError) as error:
        report.add("unreadable", str(error), INFO)
        return None
    tasks, table = _tasks(root, report), _episode_table(root, report)
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    layout = Layout(root, info, tasks or {}, list(_episodes(table, videos, report)), table)
    _check_counts(layout, report, tasks is not None)
    _check_order(layout, report)
    return layout


def _tasks(root: Path, report: Report) -> dict[int, str] | None:
    try:
        content = pq.read_table(root / TASKS).to_pydict()
        texts = next(values for key, values in content.items() if key != "task_index")
        tasks = {int(index): str(text) for index, text in zip(content["task_index"], texts, strict=True)}
    except FileNotFoundError:
        report.add("missing", "texts of the tasks", TASKS)
        return None
    except (OSError, ValueError, TypeError, KeyError, StopIteration, pa.ArrowException) as error:
        report.add("unreadable", first_line(error), TASKS)
        return None
    for text in tasks.values():
        try:
            TASK("a task", text)
        except ValueError as error:
            report.add("untrusted", str(error), TASKS)
    return tasks


def _episode_table(root: Path, report: Report) -> pa.Table:
    tables = []
    for path in sorted((root / "meta" / "episodes").glob("*/*.parquet")):
        name = path.relative_to(root).as_posix()
        try:
            table = read_episodes(path, statistics=True).replace_schema_metadata(None)
            if not {"episode_index", "length"} <= set(table.column_names):
                raise KeyError("the file does not list episodes")
            tables.append(table.append_column("listed_in", pa.array([name] * len(table), pa.string())))
        except (OSError, KeyError, pa.ArrowException) as error:
            report.add("unreadable", first_line(error), name)
    if not tables:
        if not report.counts["unreadable"]:
            report.add("missing", "metadata of the episodes", "meta/episodes")
        return pa.table({"episode_index": pa.array([], pa.int64()), "listed_in": pa.array([], pa.string())})
    return pa.concat_tables(tables, promote_options="permissive").sort_by("episode_index")


def check_texts(layout: Layout, report: Report) -> None:
    """Reports texts in columns of episodes that a terminal or a card would interpret."""
    for name in layout.table.column_names:
        if not pa.types.is_string(layout.table.schema.field(name).type):
            continue
        for row, value in enumerate(layout.table[name].to_pylist()):
            try:
                check_episode_text(name, value)
            except UntrustedValueError as error:
                place = layout.table["listed_in"][row].as_py(), layout.table["episode_index"][row].as_py()
                report.add("untrusted", str(error)[:200], *place)


def _episodes(table: pa.Table, videos: Iterable[str], report: Report) -> Iterator[Episode]:
    names = [name for name in table.column_names if not name.startswith("stats/")]
    for row in table.select(names).to_pylist():
        try:
            yield _episode(row, videos)
        except (KeyError, TypeError, ValueError) as error:
            report.add("metadata", f"missing or invalid: {error}", row["listed_in"], row["episode_index"])


def _episode(row: dict[str, Any], videos: Iterable[str]) -> Episode:
    def number(name: str) -> int:
        value = row[name]
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise ValueError(f"{name} = {value!r}")
        return value

    def file(template: str, prefix: str, **names: str) -> str:
        return template.format(**names, **{name: number(f"{prefix}/{name}") for name in ("chunk_index", "file_index")})

    def part(key: str) -> VideoPart:
        start, end = (float(row[f"videos/{key}/{name}_timestamp"]) for name in ("from", "to"))
        return VideoPart(file(VIDEO_PATH, f"videos/{key}", video_key=key), start, end)

    return Episode(
        number("episode_index"),
        number("length"),
        file(DATA_PATH, "data"),
        number("dataset_from_index"),
        number("dataset_to_index"),
        tuple(row["tasks"]),
        row["listed_in"],
        {key: part(key) for key in videos},
    )


def _check_counts(layout: Layout, report: Report, tasks_known: bool) -> None:
    info, listed = layout.info, len(layout.table)
    if info["total_episodes"] != listed:
        report.add("count", f"total_episodes = {info['total_episodes']}, but there is metadata of {listed}", INFO)
    elif info["total_frames"] != layout.rows and len(layout.episodes) == listed:
        report.add("count", f"total_frames = {info['total_frames']}, but the episodes have {layout.rows} rows", INFO)
    if tasks_known and info.get("total_tasks") != len(layout.tasks):
        report.add("count", f"total_tasks = {info.get('total_tasks')}, but there are {len(layout.tasks)}", INFO)


def _check_order(layout: Layout, report: Report) -> None:
    """Checks that episodes and their rows are consecutive, and that lengths match the ranges of rows."""
    row = 0
    for expected, episode in enumerate(layout.episodes):
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
            if abs(part.end - part.start - episode.length / layout.fps) > _FRAME:
                told = f"{part.end - part.start:.3f} s of {key} for {episode.length} rows at {layout.fps}/s"
                report.add("video-length", told, *place)


def leftovers(root: Path) -> Iterator[Path]:
    """Yields temporary files and folders of a killed process."""
    yield from sorted(root.rglob(".*.tmp"))
    yield from sorted(path for path in root.glob("tmp*") if path.is_dir())  # LeRobot encodes videos there
    if any(path.is_file() for path in (root / "images").rglob("*")):  # LeRobot always leaves it, but empty
        yield root / "images"


def unlisted_files(layout: Layout) -> Iterator[str]:
    """Yields Parquet and video files that belong to no episode."""
    known = set(layout.by_data_file()) | {file for _, file in layout.by_video_file()}
    for pattern in ("data/*/*.parquet", "videos/*/*/*.mp4"):
        names = (path.relative_to(layout.root).as_posix() for path in sorted(layout.root.glob(pattern)))
        yield from (name for name in names if name not in known)
