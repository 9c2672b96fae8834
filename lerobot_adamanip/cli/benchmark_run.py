"""Runs `adamanip benchmark`."""

from __future__ import annotations

import contextlib
import json
import shlex
import signal
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.benchmark.declaration import PAPER_TABLE, Declaration, read_declaration, with_packages
from lerobot_adamanip.benchmark.folder import BenchmarkFolder
from lerobot_adamanip.benchmark.plan import Cell, KeyVersions, all_cells, select_cells
from lerobot_adamanip.benchmark.plots import plot_report
from lerobot_adamanip.benchmark.policies import find_policies
from lerobot_adamanip.benchmark.report import make_report
from lerobot_adamanip.benchmark.report_text import LEGEND, benchmark_page
from lerobot_adamanip.benchmark.run import FAILED, STALE, BenchmarkRun, CellState
from lerobot_adamanip.cli.arguments import require_effects
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.collection.ray_cluster import require_usable
from lerobot_adamanip.evaluation.provenance import machine_class, present_origin
from lerobot_adamanip.evaluation.rates import rate, success_summary
from lerobot_adamanip.evaluation.results import read_results
from lerobot_adamanip.evaluation.text_format import counted, csv_table, interval_text
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.files import write_atomically

if TYPE_CHECKING:
    from lerobot_adamanip.cli.benchmark import BenchmarkCommand

DEFAULT_SCALE = "cpu"
EXIT_INTERRUPTED, EXIT_TERMINATED = 130, 143


def run_benchmark(options: BenchmarkCommand) -> int:
    """Lists, runs or reports. Returns 1 if a cell failed, 130 after Ctrl-C, otherwise 0."""
    declaration = read_declaration(options.config) if options.config else with_packages(read_declaration(PAPER_TABLE))
    scale, selection = options.scale or DEFAULT_SCALE, _selection(options)
    cells = select_cells(declaration, scale, **selection)
    runs_nothing = options.list_cells or options.report
    _check(options, len(cells), is_chosen=runs_nothing or any((options.scale, options.config, *selection.values())))
    with contextlib.redirect_stdout(sys.stderr):  # library output must not get into the JSON
        benchmark = _benchmark(options, declaration, scale)
        try:
            states = [benchmark.state(cell) for cell in cells] if runs_nothing else _run_cells(benchmark, cells)
        except KeyboardInterrupt:
            command = shlex.join(["adamanip", *sys.argv[1:]])
            print(f"Interrupted. Finished work is kept. To resume:\n  {command}")
            return EXIT_INTERRUPTED
        written = {} if options.list_cells else _write_report(benchmark)
    _print(options, scale, states, written)
    return 1 if any(each.state == FAILED for each in states) else 0


def _check(options: BenchmarkCommand, cells: int, *, is_chosen: bool) -> None:
    if not is_chosen:
        raise ConfigurationError(
            f"Nothing was chosen, and scale {DEFAULT_SCALE} has {cells} cells: about a day on two cores.",
            got="neither --scale nor --methods, --categories, --splits, --seeds",
            allowed="one of them",
            hint=f"--methods dp3_adaptive --categories safe; all of it: --scale {DEFAULT_SCALE}",
        )
    if options.list_cells and options.report:
        raise ConfigurationError("Two things at once.", got="--list and --report", allowed="one of them", hint="--list")
    if options.cluster is None:
        require_effects(options, {"with --cluster": ("insecure_cluster",)})
    else:
        require_usable(options.cluster, insecure=options.insecure_cluster)
    if options.jobs < 1:
        raise ConfigurationError("Not a number of jobs.", got=options.jobs, allowed="1 or more", hint="--jobs 2")


def _selection(options: BenchmarkCommand) -> dict[str, tuple[Any, ...]]:
    seeds = _names(options.seeds)
    if not all(seed.isdecimal() for seed in seeds):
        raise ConfigurationError("Not a seed.", got=options.seeds, allowed="whole numbers", hint="--seeds 1000,1001")
    names = {name: _names(getattr(options, name)) for name in ("methods", "categories", "splits")}
    return {**names, "seeds": tuple(map(int, seeds))}


def _benchmark(options: BenchmarkCommand, declaration: Declaration, scale: str) -> BenchmarkRun:
    policies, unavailable = find_policies(declaration.methods)
    return BenchmarkRun(
        declaration=declaration,
        scale=scale,
        folder=BenchmarkFolder((options.out / scale).absolute()),
        versions=KeyVersions(policies=policies),
        origin=present_origin(),
        machine=machine_class(),
        unavailable=unavailable,
        collect_options=_collect_options(options),
        jobs=options.jobs,
        say=lambda text: print(text, flush=True),
    )


def _collect_options(options: BenchmarkCommand) -> tuple[str, ...]:
    cluster = () if options.cluster is None else (f"--cluster={options.cluster}",)
    return (f"--workers={options.workers}", *cluster, *(("--insecure-cluster",) if options.insecure_cluster else ()))


def _print(options: BenchmarkCommand, scale: str, states: Sequence[CellState], written: dict[str, str]) -> None:
    if options.json:
        print(json.dumps({"scale": scale, "cells": [_state_json(each) for each in states], **written}))
        return
    width = max(len(each.cell.name) for each in states)
    for each in states:
        if options.list_cells or each.state == FAILED:
            print(f"{each.cell.name:<{width}}  {each.state:<11}  {_status_text(each)}".rstrip())
    counts = Counter(each.state for each in states)
    print(f"{counted(len(states), 'cell')}: {', '.join(f'{count} {state}' for state, count in counts.items())}")
    for what, path in written.items():
        print(f"{what}: {path}")


def _run_cells(benchmark: BenchmarkRun, cells: Sequence[Cell]) -> list[CellState]:
    """Runs the unfinished cells, with progress on stderr. SIGTERM also ends the running commands."""
    states = []
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(EXIT_TERMINATED))
    try:
        with show_progress({"cells": "cells"}) as progress:
            progress("cells", 0, len(cells))
            for number, state in enumerate(benchmark.run(cells), start=1):
                states.append(state)
                progress("cells", number, len(cells))
    finally:
        signal.signal(signal.SIGTERM, before)
    return states


def _write_report(benchmark: BenchmarkRun) -> dict[str, str]:
    """Writes the report of all results in the folder as Markdown, CSV and pictures. Returns the paths."""
    stale = {cell for cell in all_cells(benchmark.declaration, benchmark.scale) if benchmark.state(cell).state == STALE}
    report = make_report(
        read_results(benchmark.folder.cells).values(),
        benchmark.declaration,
        benchmark.scale,
        unavailable=benchmark.unavailable,
        stale=stale,
    )
    folder = benchmark.folder.root / "report"
    folder.mkdir(parents=True, exist_ok=True)
    table, metrics = folder / "benchmark.md", folder / "benchmark.csv"
    write_atomically(table, f"{benchmark_page(report)}\n{LEGEND}".encode())
    write_atomically(metrics, csv_table(list(report.csv_lines())).encode())
    pictures = {f"picture of {path.stem}": str(path) for path in plot_report(report, folder)}
    return {"table": str(table), "metrics": str(metrics), **pictures}


def _names(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def _state_json(state: CellState) -> dict[str, Any]:
    success = None if state.result is None else state.result.rows[0].metrics.success
    return {
        "name": state.cell.name,
        **asdict(state.cell),
        "state": state.state,
        "reason": state.reason,
        "success": None if success is None else {**asdict(success), **success_summary(success)},
    }


def _status_text(state: CellState) -> str:
    """Returns a cell's success rate, if it has a result, and the reason of its state."""
    success = rate(0, 0) if state.result is None else state.result.rows[0].metrics.success
    return "; ".join(filter(None, (interval_text(success) if success.episodes else "", state.reason)))
