"""Findings of a check: their kinds, one finding, and the report that collects them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the number done and the total number."""


class Kind(NamedTuple):
    """Meaning of a kind of finding, its repair by `adamanip check --repair`, and whether it makes a check fail."""

    meaning: str
    repair: str
    fails: bool = True


_NO = "no"
KINDS: Mapping[str, Kind] = {
    "missing": Kind("a file that the dataset names does not exist", "`meta/stats.json` alone"),
    "unreadable": Kind(
        "a file, or a part of it, is cut off or cannot be parsed", "`meta/stats.json`, and files of no saved episode"
    ),
    "leftover": Kind("a temporary file or picture of a process that ended early", "moved away"),
    "unlisted": Kind("rows or video frames that belong to no episode", "files of no saved episode are moved away"),
    "metadata": Kind("an episode's metadata contradicts itself, or the dataset has another format", _NO),
    "untrusted": Kind(
        "a value that another program would interpret (options of an encoder, a playlist, markup, control characters), "
        "which no command passes on",
        _NO,
    ),
    "count": Kind("totals in `meta/info.json` differ from the episodes", "counted again"),
    "schema": Kind("a column is missing, or its type, shape or names differ from the contract's", _NO),
    "shape": Kind("a cell is empty, or its shape differs from its column's", _NO),
    "length": Kind("an episode has more or fewer rows than its metadata says", _NO),
    "index": Kind("`index`, `frame_index` or `episode_index` are not consecutive", _NO),
    "timestamp": Kind("the time of a row or frame is not its number divided by the frame rate", _NO),
    "task": Kind("a row's task does not exist, or is not a task of its episode", _NO),
    "not-finite": Kind("NaN or infinity", _NO),
    "rotation": Kind("rotation 6D of a state's or an action's pose is not two orthonormal rows", _NO),
    "workspace": Kind("a cloud has points outside the workspace", _NO),
    "gripper": Kind("a gripper's opening is not in [0, 1]", _NO),
    "label": Kind("a label is not one of the contract's codes, or contradicts earlier labels", _NO),
    "video-length": Kind("a video is shorter than its episodes, or is cut at other places", _NO),
    "video-content": Kind("a video's colours differ from its episode's statistics", _NO),
    "episode-statistics": Kind("an episode's statistics differ from those of its rows", _NO),
    "statistics": Kind("`meta/stats.json` differs from the statistics of the rows", "computed again"),
    "averaged": Kind(
        "warning: quantiles of `meta/stats.json` are averages of the episodes', or the cloud has none, as LeRobot's "
        "tools leave them",
        "computed again",
        fails=False,
    ),
    "cameras": Kind(
        "warning: `meta/cameras.json` is lost, as LeRobot's tools lose it",
        "written again, if `meta/episodes` has the column `camera`",
        fails=False,
    ),
    "facts": Kind("an episode's columns (object, hidden state, tries ...) are invalid, or contradict its rows", _NO),
    "collection": Kind("`meta/collection.json` is invalid, or an episode does not belong to that collection", _NO),
    "versions": Kind("an episode's software versions differ from its collection's", _NO),
    "attempts": Kind("`meta/attempts.jsonl` has lost lines", _NO),
    "replay": Kind("the simulator does not reproduce the recording (`--replay`)", _NO),
}
"""Kind -> meaning. docs/checking.md shows this table."""
MOST_OF_A_KIND = 200
"""Largest number of listed findings of a kind; further ones are only counted."""


@dataclass(frozen=True)
class Finding:
    """One finding: kind (of `KINDS`), message, and place: file, episode, and frame within the episode."""

    kind: str
    message: str
    file: str | None = None
    episode: int | None = None
    frame: int | None = None

    @property
    def fails(self) -> bool:
        """Whether it makes a check fail; a warning does not."""
        return KINDS[self.kind].fails

    def __str__(self) -> str:
        """Returns one line: kind, place, message; a warning says so first."""
        episode = None if self.episode is None else f"episode {self.episode}"
        frame = None if self.frame is None else f"frame {self.frame}"
        place = ", ".join(filter(None, (self.file, episode, frame)))
        warning = "" if self.fails else "warning: "
        return f"{warning}{self.kind}: {place}{': ' if place else ''}{self.message}"


@dataclass(frozen=True)
class Rows:
    """Places of R rows: their file, and each row's episode (R,) and number within it (R,)."""

    file: str
    episodes: NDArray[np.int64]
    frames: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.episodes)

    def starts(self) -> NDArray[np.int64]:
        """Returns the first row of each run of rows of one episode."""
        return np.flatnonzero(np.r_[True, np.diff(self.episodes) != 0])

    def runs(self) -> Iterator[tuple[int, slice]]:
        """Yields each run of rows of one episode, and the episode's index."""
        for start, end in itertools.pairwise([*self.starts().tolist(), len(self)]):
            yield int(self.episodes[start]), slice(start, end)


@dataclass
class Report:
    """Findings of a check.

    Attributes:
        root: folder of the dataset.
        episodes, rows: numbers of checked ones.
        findings: at most `MOST_OF_A_KIND` of each kind.
        counts: kind -> number of findings.
        damaged: episodes with a finding about their rows; consequences of it are not reported again.
    """

    root: str = ""
    episodes: int = 0
    rows: int = 0
    findings: list[Finding] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    damaged: set[int] = field(default_factory=set)

    def add(
        self, kind: str, message: str, file: str | None = None, episode: int | None = None, frame: int | None = None
    ) -> None:
        """Adds a finding; raises ValueError for an unknown kind."""
        if kind not in KINDS:
            raise ValueError(f"No kind of finding: {kind}")
        self.counts[kind] += 1
        if episode is not None:
            self.damaged.add(episode)
        if self.counts[kind] <= MOST_OF_A_KIND:
            self.findings.append(Finding(kind, message, file, episode, frame))

    def add_rows(self, kind: str, message: str, where: Rows, wrong: NDArray[np.bool_]) -> None:
        """Adds one finding for each episode with wrong rows, at its first wrong row."""
        episodes, frames = where.episodes[wrong], where.frames[wrong]
        for episode in np.unique(episodes).tolist():
            episode_frames = frames[episodes == episode]
            more = f", and {len(episode_frames) - 1} more rows" if len(episode_frames) > 1 else ""
            self.add(kind, message + more, where.file, episode, int(episode_frames.min()))

    @property
    def clean(self) -> bool:
        """Whether there are no findings but warnings."""
        return not self.total(fails=True)

    def total(self, *, fails: bool) -> int:
        """Returns the number of findings that make the check fail, or of warnings."""
        return sum(count for kind, count in self.counts.items() if KINDS[kind].fails is fails)

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        plain = {"root": self.root, "clean": self.clean, "episodes": self.episodes, "rows": self.rows}
        return {**plain, "counts": dict(self.counts), "findings": [asdict(each) for each in self.findings]}
