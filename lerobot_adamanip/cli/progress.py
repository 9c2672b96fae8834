"""Progress of long work: bars where a person watches, a line now and then in logs and CI.

A script uses it like a command::

    with show_progress({"record": "recorded"}) as progress:
        for number in range(100):
            progress("record", number + 1, 100)
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TextIO

from lerobot_adamanip.collection.summary import CollectSummary

EVERY_SECONDS, EVERY_SHARE = 15.0, 0.05
"""A line is written after so much time [s], or after so much more of the work, whichever comes first."""
LEAST_SECONDS = 2.0
"""But never two within so much time [s], apart from a stage's last."""

Progress = Callable[[str, int, int], None]
"""Told of a stage's name, how much of it is done, and how much there is."""


@dataclass
class _Stage:
    begin: float
    line: float = -float("inf")
    share: float = -1.0


@dataclass
class ProgressLines:
    """Writes progress as lines of text.

    Attributes:
        names: stage -> what a line calls it; a stage that is not in it is not written.
        stream: to write to.
        clock: tells the time [s].
    """

    names: Mapping[str, str]
    stream: TextIO = field(default_factory=lambda: sys.stderr)
    clock: Callable[[], float] = time.monotonic
    _stages: dict[str, _Stage] = field(default_factory=dict)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Takes note; writes a line if one is due."""
        if stage not in self.names:
            return
        now, share = self.clock(), done / max(1, total)
        known = self._stages.setdefault(stage, _Stage(now))
        due = now - known.line >= EVERY_SECONDS or share - known.share >= EVERY_SHARE
        last = done >= total and known.share < 1.0
        if not last and not (due and now - known.line >= LEAST_SECONDS):
            return
        known.line, known.share = now, share
        seconds = now - known.begin
        left = f", about {seconds * (1 - share) / share:.0f} s left" if 0 < share < 1 and seconds > 1 else ""
        line = f"{self.names[stage]}: {done}/{total} ({100 * share:.0f} %) after {seconds:.0f} s{left}"
        print(line, file=self.stream, flush=True)


@contextlib.contextmanager
def show_progress(names: Mapping[str, str], *, every_stage: bool = False) -> Iterator[Progress]:
    """Shows progress on stderr while inside.

    Args:
        names: stage -> what it is called.
        every_stage: show bars of other stages too, under their own names.
    """
    if not sys.stderr.isatty():
        yield ProgressLines(names)
        return
    from rich import progress as bars
    from rich.console import Console

    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(),
    )
    with bars.Progress(*columns, console=Console(stderr=True)) as shown:
        tasks: dict[str, bars.TaskID] = {}

        def listen(stage: str, done: int, total: int) -> None:
            if stage not in names and not every_stage:
                return
            if stage not in tasks:
                tasks[stage] = shown.add_task(names.get(stage, stage), total=total)
            shown.update(tasks[stage], completed=done, total=total)

        yield listen


def print_categories(summary: CollectSummary) -> None:
    """Prints a row per category of a collection."""
    print(f"{'category':16} {'episodes':>8} {'attempts':>8} {'key frames':>10} {'per worker and minute':>21}")
    for name, row in summary.categories.items():
        rate = f"{row.episodes_per_worker_minute:.1f}" if row.recorded else "-"
        print(f"{name:16} {row.episodes:8} {row.attempts:8} {row.mean_key_frames:10.1f} {rate:>21}")
