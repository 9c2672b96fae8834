"""`adamanip report`: success rates with intervals, trials and plots of an evaluation."""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.evaluation.log import read_log
from lerobot_adamanip.evaluation.metrics import EvaluationSummary, Rate, difference_interval, rate, summarise

_PLOT_FORMATS = (".png", ".pdf", ".svg")
_FILE_WIDTH = 200
"""Columns of a table that goes into a file or a pipe."""


@dataclass
class Report:
    """Reports evaluations from their episode logs, which `lerobot-eval --env.episode_log=FILE` writes.

    Each episode (seed, object and hidden state) is counted once per log: when a log holds it again, the last record
    wins. With several logs, every one is compared with the first.
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Episode logs, one evaluation each."""

    label: tuple[str, ...] = ()
    """What to call them, in the same order; file names by default."""

    plot: Path | None = None
    """Write a picture (.png, .pdf or .svg): success by group with intervals, and success over episodes."""

    json: bool = False
    """Print one JSON object instead of tables."""

    def run(self) -> int:
        """Reads, prints and plots; 0."""
        labels = self._labels()
        if self.plot is not None and self.plot.suffix.lower() not in _PLOT_FORMATS:
            raise ConfigurationError(
                "Unknown kind of picture.", got=self.plot, allowed=", ".join(_PLOT_FORMATS), hint="curve.png"
            )
        evaluations = {label: read_log(path) for label, path in zip(labels, self.logs, strict=True)}
        summaries = {label: summarise(records) for label, records in evaluations.items()}
        if self.plot is not None:
            from lerobot_adamanip.evaluation.plots import plot_evaluations

            plot_evaluations(evaluations, self.plot)
        if self.json:
            print(json.dumps(to_json(dict(zip(labels, self.logs, strict=True)), summaries, self.plot)))
        else:
            print_tables(summaries)
            if self.plot is not None:
                print(f"picture: {self.plot}")
        return 0

    def _labels(self) -> list[str]:
        if not self.logs:
            raise ConfigurationError(
                "No episode log given.", got="nothing", allowed="one or more files", hint="adamanip report LOG"
            )
        if not self.label:
            stems = [path.stem for path in self.logs]
            return stems if len(set(stems)) == len(stems) else [str(path) for path in self.logs]
        if len(self.label) != len(self.logs) or len(set(self.label)) != len(self.label):
            got = f"{len(self.label)} labels ({', '.join(self.label)}) for {len(self.logs)} logs"
            raise ConfigurationError(
                "Labels do not fit.", got=got, allowed="one per log, all different", hint="--label adaptive static"
            )
        return list(self.label)


def to_json(logs: dict[str, Path], summaries: dict[str, EvaluationSummary], plot: Path | None) -> dict[str, Any]:
    """The machine's version: ``evaluations`` (label, log, summary each), ``differences`` from the first, ``plot``."""
    first, *others = summaries.items()
    return {
        "evaluations": [
            {"label": label, "log": str(logs[label]), **dataclasses.asdict(summary)}
            for label, summary in summaries.items()
        ],
        "differences": [
            {
                "first": first[0],
                "second": label,
                **{
                    group: dict(zip(("difference", "low", "high"), _difference(first[1], summary, group), strict=True))
                    for group in ("overall", "locked", "unlocked")
                },
            }
            for label, summary in others
        ],
        "plot": None if plot is None else str(plot),
    }


def _difference(first: EvaluationSummary, second: EvaluationSummary, group: str) -> tuple[float, float, float]:
    return difference_interval(getattr(first, group), getattr(second, group))


def _percent(value: Rate) -> str:
    if value.rate is None:
        return "-"
    return f"{100 * value.rate:.1f} %  [{100 * value.low:.1f}, {100 * value.high:.1f}]  {value.count}/{value.episodes}"


def print_tables(summaries: dict[str, EvaluationSummary]) -> None:
    """The human's version: a column per log, then differences, then the objects that failed."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Column, Table

    console = Console(file=sys.stdout, soft_wrap=True)
    if not console.is_terminal:
        console.width = _FILE_WIDTH
    columns = [Column(escape(label), no_wrap=True) for label in ("", *summaries)]
    table = Table(*columns, box=None, pad_edge=False)
    for name, cells in _rows(list(summaries.values())):
        table.add_row(name, *cells)
    console.print("Success with 95 % Wilson intervals", style="bold")
    console.print(table)
    repeats = sum(summary.repeats for summary in summaries.values())
    if repeats:
        console.print(f"{repeats} repeated episodes were counted once, the last record of each.")
    first, *others = summaries.items()
    for label, summary in others:
        for group in ("overall", "locked", "unlocked"):
            if not (getattr(first[1], group).episodes and getattr(summary, group).episodes):
                continue
            gap, low, high = (100 * value for value in _difference(first[1], summary, group))
            line = f"{first[0]} - {label}, {group}: {gap:+.1f} points [{low:+.1f}, {high:+.1f}]"
            console.print(line, markup=False, highlight=False)
    for label, summary in summaries.items():
        failed = {name: result for name, result in summary.objects.items() if result.failures}
        text = ", ".join(f"{name} {r.failures}/{r.episodes}" for name, r in failed.items()) or "none"
        console.print(f"Failures by object, {label}: {text}", markup=False, highlight=False)


def _rows(summaries: list[EvaluationSummary]) -> list[tuple[str, list[str]]]:
    groups = ("overall", "locked", "unlocked", "seen", "unseen")
    names = {"overall": "all", "seen": "seen objects", "unseen": "unseen objects"}
    rows = [("episodes", [str(summary.episodes) for summary in summaries])]
    known = [g for g in groups if any(getattr(summary, g).episodes for summary in summaries)]
    rows += [(names.get(g, g), [_percent(getattr(summary, g)) for summary in summaries]) for g in known]
    categories = list(dict.fromkeys(name for summary in summaries for name in summary.categories))
    if len(categories) > 1:
        rows += [(name, [_percent(s.categories.get(name, rate(0, 0))) for s in summaries]) for name in categories]
    if any(summary.locked.episodes for summary in summaries):
        tried = [_percent(summary.tried_locked_door_first) for summary in summaries]
        rows.append(("tried the locked door first", tried))
    lengths = [summary.key_frames_of_successes for summary in summaries]
    rows.append(("key frames of a success", ["-" if value is None else f"{value:.1f}" for value in lengths]))
    wasted = [f"{s.tries.wasted:+.2f}  ({s.tries.made:.2f} made, {s.tries.best:.2f} at best)" for s in summaries]
    rows.append(("wasted tries per episode", wasted))
    return rows
