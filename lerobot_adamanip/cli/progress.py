"""Progress on stderr: bars on a terminal, lines in logs and CI."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TextIO

MAX_INTERVAL_S, MAX_INTERVAL_SHARE = 15.0, 0.05
"""Time [s] and share of the work between two lines, whichever comes first."""
MIN_INTERVAL_S = 2.0
"""Minimum time between two lines, except a stage's last one [s]."""

Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the number of finished items and their total."""


@dataclass
class _Stage:
    begin: float
    first_share: float
    printed_at: float = -float("inf")
    printed_share: float = -1.0


@dataclass
class ProgressLines:
    """Writes progress as lines of text.

    Attributes:
        names: stage -> its name in a line. Other stages are not written.
        stream: output stream.
        clock: returns the time [s].
    """

    names: Mapping[str, str]
    stream: TextIO = field(default_factory=lambda: sys.stderr)
    clock: Callable[[], float] = time.monotonic
    _stages: dict[str, _Stage] = field(default_factory=dict)
    _begin: float = field(init=False)

    def __post_init__(self) -> None:
        """Starts the first stage's time, which includes the start of simulators."""
        self._begin = self.clock()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Writes a line if one is due."""
        if stage not in self.names:
            return
        now, share = self.clock(), done / max(1, total)
        known = self._stages.setdefault(stage, _Stage(now if self._stages else self._begin, share))
        since = now - known.printed_at
        is_due = since >= MAX_INTERVAL_S or share - known.printed_share >= MAX_INTERVAL_SHARE
        is_last = done >= total and known.printed_share < 1.0
        if not is_last and not (is_due and since >= MIN_INTERVAL_S):
            return
        known.printed_at, known.printed_share = now, share
        seconds, gained = now - known.begin, share - known.first_share
        left = (
            f", about {seconds * (1 - share) / gained:.0f} s left" if gained > 0 and share < 1 and seconds > 1 else ""
        )
        line = f"{self.names[stage]}: {done}/{total} ({100 * share:.0f} %) after {seconds:.0f} s{left}"
        print(line, file=self.stream, flush=True)


@contextlib.contextmanager
def show_progress(names: Mapping[str, str], *, every_stage: bool = False) -> Iterator[Progress]:
    """Shows progress on stderr and redirects library output there, since stdout is for the result.

    Args:
        names: stage -> its name in a line.
        every_stage: also show bars of other stages, under their own names.
    """
    with contextlib.redirect_stdout(sys.stderr):
        if not sys.stderr.isatty():
            yield ProgressLines(names)
            return
        from rich import progress as bars
        from rich.console import Console

        times = (bars.TimeElapsedColumn(), bars.TimeRemainingColumn())
        columns = (bars.TextColumn("{task.description}"), bars.BarColumn(), bars.MofNCompleteColumn(), *times)
        with bars.Progress(*columns, console=Console(stderr=True)) as shown:
            tasks: dict[str, bars.TaskID] = {}

            def update(stage: str, done: int, total: int) -> None:
                if stage not in names and not every_stage:
                    return
                if stage not in tasks:
                    tasks[stage] = shown.add_task(names.get(stage, stage), total=total)
                shown.update(tasks[stage], completed=done, total=total)

            yield update
