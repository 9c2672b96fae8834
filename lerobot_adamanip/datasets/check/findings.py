"""Findings of a check: their kinds, one finding, and the report that collects them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the number done and the total number."""
KINDS = (
    "averaged", "cameras", "missing", "unreadable", "leftover", "unlisted", "metadata", "untrusted", "count", "schema",
    "shape", "length", "index", "timestamp", "task", "not-finite", "rotation", "workspace", "gripper", "limits",
    "label", "video-length", "video-content", "episode-statistics", "statistics", "facts", "collection", "versions",
    "attempts", "replay",
)  # fmt: skip
"""Kinds of findings; docs/checking.md says what each means."""
WARNINGS = frozenset(("averaged", "cameras"))
"""Kinds of findings that make no check fail."""
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
        return self.kind not in WARNINGS

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
        return sum(count for kind, count in self.counts.items() if (kind not in WARNINGS) is fails)

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        plain = {"root": self.root, "clean": self.clean, "episodes": self.episodes, "rows": self.rows}
        return {**plain, "counts": dict(self.counts), "findings": [asdict(each) for each in self.findings]}
