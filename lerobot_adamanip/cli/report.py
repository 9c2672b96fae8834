"""`adamanip report`: success rates with intervals, tries and plots of an evaluation."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from lerobot_adamanip.evaluation.comparison import Comparison, compare
from lerobot_adamanip.evaluation.failures import failures_text
from lerobot_adamanip.evaluation.groups import Group
from lerobot_adamanip.evaluation.log import read_log
from lerobot_adamanip.evaluation.metrics import EvaluationSummary, first_episodes, split_evaluations
from lerobot_adamanip.evaluation.rates import Rate
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.table import Table

_PLOT_FORMATS, _RESULT = (".png", ".pdf", ".svg"), ".json"
FILE_WIDTH = 200
"""Columns of a table that goes into a file or a pipe."""
OBJECT_SPLITS = "Seen, unseen and novel objects are splits of a category, whatever the policy was trained on."
SURPLUS = (
    "All episodes of the logs are counted. lerobot-eval counts the first --eval.n_episodes=N: report --episodes N."
)
Evaluations = dict[str, list[EpisodeRecord]]


@dataclass
class Report:
    """Reports evaluations from their episode logs, which `lerobot-eval --env.episode_log=FILE` writes.

    A log that holds several evaluations gives a column to each. Within one, each episode (seed, object and hidden
    state) is counted once; the last record wins. Everything is compared with the first column.
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Episode logs."""

    label: tuple[str, ...] = ()
    """What to call them, in the same order; file names by default."""

    episodes: int | None = None
    """Count only the first so many episodes of each evaluation and category, by seed, as lerobot-eval counts the first
    --eval.n_episodes. Left out: all of them, also the surplus of a last batch that was not full."""

    pool: bool = False
    """Count all evaluations of a log on one split of scenes as one."""

    out: tuple[Path, ...] = ()
    """Files to write: a picture (.png, .pdf or .svg) of success by group and over episodes; a result file (.json) of
    everything reported, for scripts/make_results.py, which needs --command."""

    command: str | None = None
    """The command that measured it, as typed in the repository's root; written into the result file."""

    title: str = "success of policies"
    """One line that says what was measured; written into the result file."""

    seconds: float | None = None
    """How long it took [s], if it was measured; written into the result file."""

    json: bool = False
    """Print one JSON object instead of tables."""

    def run(self) -> int:
        """Reads, prints, plots and writes; 0."""
        labels = self._labels()
        self._check()
        logs = {label: read_log(path) for label, path in zip(labels, self.logs, strict=True)}
        evaluations = dict(self._evaluations(logs))
        comparison = compare(evaluations)
        for path in self.out:
            self._write(evaluations, path)
        if self.json:
            print(json.dumps({**comparison.to_json(), "out": list(map(str, self.out))}))
            return 0
        print_tables(comparison)
        if self.episodes is None:
            print(SURPLUS)
        for path in self.out:
            print(f"written: {path}")
        return 0

    def _check(self) -> None:
        for path in self.out:
            if path.suffix.lower() != _RESULT:
                check_plot(path)
        if self.episodes is not None and self.episodes < 1:
            raise ConfigurationError("Nothing to count.", got=self.episodes, allowed=">= 1", hint="--episodes 100")
        if any(path.suffix.lower() == _RESULT for path in self.out) and not self.command:
            hint = "--command 'lerobot-eval --policy.path=... --env.type=... '"
            raise ConfigurationError("A result needs its command.", got=self.command, allowed="one line", hint=hint)

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

    def _evaluations(self, logs: Evaluations) -> Iterator[tuple[str, list[EpisodeRecord]]]:
        """Yields label and records of each evaluation; those of one log are numbered, or called by their labels."""
        for label, records in logs.items():
            chosen = records if self.episodes is None else first_episodes(records, self.episodes)
            parts = split_evaluations(chosen, pool=self.pool)
            for number, part in enumerate(parts, start=1):
                said = part[0].provenance.run_label
                name = f"{number} {said}" if said else str(number)
                yield (label if len(parts) == 1 else f"{label} #{name}"), part

    def _write(self, evaluations: Evaluations, path: Path) -> None:
        if path.suffix.lower() != _RESULT:
            from lerobot_adamanip.evaluation.plots import plot_evaluations

            plot_evaluations(evaluations, path)
            return
        from lerobot_adamanip.evaluation.result_rows import rows_of_records
        from lerobot_adamanip.evaluation.results import policy_result, write_result

        result = policy_result(
            [row for label, part in evaluations.items() for row in rows_of_records(part, label)],
            [record for part in evaluations.values() for record in part],
            title=self.title,
            command=str(self.command),
            seconds=self.seconds,
        )
        write_result(path, result)


def check_plot(path: Path | None) -> None:
    """Raises `ConfigurationError` for a picture of a kind that cannot be drawn."""
    if path is not None and path.suffix.lower() not in _PLOT_FORMATS:
        raise ConfigurationError(
            "Unknown kind of picture.", got=path, allowed=", ".join(_PLOT_FORMATS), hint="curve.png"
        )


def percent(value: Rate) -> str:
    """Returns ``90.0 %  [76.9, 96.0]  36/40``."""
    if value.rate is None:
        return "-"
    return f"{100 * value.rate:.1f} %  [{100 * value.low:.1f}, {100 * value.high:.1f}]  {value.count}/{value.episodes}"


def print_tables(comparison: Comparison) -> None:
    """The human's version: a column per evaluation, tries, differences, what failed, and what to mind."""
    from rich.console import Console

    console = Console(file=sys.stdout, soft_wrap=True)
    if not console.is_terminal:
        console.width = FILE_WIDTH
    summaries = comparison.summaries
    console.print(comparison.title, style="bold")
    console.print(_table(comparison, _success_rows(comparison)))
    console.print("\nFailed tries per success, and at best without seeing what is hidden", style="bold")
    console.print(_table(comparison, _tries_rows(comparison)))
    console.print("\nAfter a try that failed", style="bold")
    console.print(_table(comparison, _recovery_rows(comparison)))
    repeats = sum(summary.repeats for summary in summaries.values())
    if repeats:
        console.print(f"{repeats} repeated episodes were counted once, the last record of each.")
    shown = set(comparison.groups)
    for one in comparison.differences:
        if one.group in shown:
            gap, low, high = (100 * value for value in (one.success.difference, one.success.low, one.success.high))
            line = f"{one.first} - {one.second}, {one.group.label}: {gap:+.1f} points [{low:+.1f}, {high:+.1f}]"
            console.print(line, markup=False, highlight=False)
    for label, summary in summaries.items():
        failed = {name: result for name, result in summary.objects.items() if result.failures}
        text = ", ".join(f"{name} {r.failures}/{r.episodes}" for name, r in failed.items()) or "none"
        console.print(f"Failures by object, {label}: {text}", markup=False, highlight=False)
        ended = failures_text(summary.failures)
        console.print(f"Failures by how they ended, {label}: {ended}", markup=False, highlight=False)
    if any(group.by == "objects" for group in comparison.groups):
        console.print(OBJECT_SPLITS, markup=False, highlight=False)
    for warning in comparison.warnings:
        console.print(f"Mind: {warning}", style="bold yellow", markup=False, highlight=False)


def _table(comparison: Comparison, rows: Iterator[tuple[str, list[str]]]) -> Table:
    from rich.markup import escape
    from rich.table import Column, Table

    columns = [Column(escape(label), no_wrap=True) for label in ("", *comparison.summaries)]
    table = Table(*columns, box=None, pad_edge=False)
    for name, cells in rows:
        table.add_row(escape(name), *cells)
    return table


def _success_rows(comparison: Comparison) -> Iterator[tuple[str, list[str]]]:
    summaries = list(comparison.summaries.values())
    yield "scenes", [summary.scenes for summary in summaries]
    yield "episodes", [str(summary.episodes) for summary in summaries]
    for group in comparison.groups:
        yield group.label, [percent(summary.success(group)) for summary in summaries]
    if any(summary.tried_locked_first.episodes for summary in summaries):
        yield "tried the locked door first", [percent(summary.tried_locked_first) for summary in summaries]
    lengths = [summary.overall.key_frames_of_successes for summary in summaries]
    yield "key frames of a success", ["-" if value is None else f"{value:.1f}" for value in lengths]


def _tries_rows(comparison: Comparison) -> Iterator[tuple[str, list[str]]]:
    for group in comparison.groups:
        if group.by in ("all", "category", "hidden"):
            yield group.label, [_tries(summary, group) for summary in comparison.summaries.values()]


def _recovery_rows(comparison: Comparison) -> Iterator[tuple[str, list[str]]]:
    found = [summary.recovery for summary in comparison.summaries.values()]
    yield "the same again", [percent(each.repeated) for each in found]
    for count in sorted({count for each in found for count in each.untried}):
        name = f"something new after {count} that failed"
        yield name, [percent(each.untried[count]) if count in each.untried else "-" for each in found]


def _tries(summary: EvaluationSummary, group: Group) -> str:
    tries = summary.groups[group].tries if group in summary.groups else None
    return "-" if tries is None else f"{tries.made:.2f}, {tries.best:.2f} at best: {tries.wasted:+.2f}"
