"""Writes the results of docs and README: ``python scripts/make_results.py [--check]``.

The documents are docs/results.md, docs/results.csv, docs/leaderboard.md, and blocks in the README and two notes.
The sources are results/*.json and, from `adamanip benchmark`, results/benchmark/SCALE/*.json. README and
docs/results.md say if they were measured with another simulation version than the present one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from check_common import ROOT, document_command

from lerobot_adamanip.benchmark.declaration import PAPER_TABLE, read_declaration
from lerobot_adamanip.benchmark.leaderboard import leaderboard_page, violations
from lerobot_adamanip.benchmark.paired_text import effects_table
from lerobot_adamanip.benchmark.report import BenchmarkReport, make_report
from lerobot_adamanip.benchmark.report_text import benchmark_page, means_beside_paper, success_by_category, summary
from lerobot_adamanip.benchmark.result import CellResult, read_cells
from lerobot_adamanip.contract.versions import earlier_version, mixed_versions
from lerobot_adamanip.evaluation.results import ResultFile, read_result
from lerobot_adamanip.evaluation.results_page import END, START, csv_rows, readme_block, results_page, with_block
from lerobot_adamanip.evaluation.tables import csv_table

IN_README = ("demo.json",)
"""Result files for the README. docs/results.md shows all."""
MEANS: dict[str, Callable[[BenchmarkReport], str]] = {"test": summary, "paper": means_beside_paper}
"""Scale -> its means in the README."""
SCALES = ("test", "paper", "cpu", "overfit")
"""Order of the scales on the page; others follow."""
PICTURES = """![Success over the failed tries that an episode may have](images/benchmark_tries.png)

![Success by method and category, with intervals, scale test](images/benchmark_success.png)

![Success in the setting of the paper's code, scale paper; dashes are the paper's numbers](images/benchmark_paper.png)
"""
PAGE, BOARD = ROOT / "docs" / "results.md", ROOT / "docs" / "leaderboard.md"
README, RESULTS, NOTES = ROOT / "README.md", ROOT / "results", ROOT / "docs" / "research"
TABLES: dict[Path, tuple[str, Callable[[BenchmarkReport], str]]] = {
    NOTES / "memory.md": ("test", effects_table),
    NOTES / "paper_setting.md": ("paper", success_by_category),
}
"""Document -> scale and table of the block that it holds."""


def read_results(folder: Path) -> dict[str, ResultFile]:
    """Returns file name -> result, sorted by name. Raises `DatasetError` for an invalid file."""
    return {path.name: read_result(path) for path in sorted(folder.glob("*.json"))}


def benchmark_reports(folder: Path) -> Iterator[BenchmarkReport]:
    """Yields a report per scale of our declarations that has results."""
    for declaration in map(read_declaration, sorted(PAPER_TABLE.parent.glob("*.toml"))):
        for scale in declaration.scales:
            if results := read_cells(folder / "benchmark" / scale):
                yield make_report(results, declaration, scale)


def entries(folder: Path) -> dict[str, list[CellResult]]:
    """Returns name -> result files of the leaderboard's entries, of the newest simulation version that has any.

    Those that break its rule are left out.
    """
    found = {path.name: read_cells(path) for path in sorted((folder / "leaderboard").glob("*/"))}
    methods = read_declaration(PAPER_TABLE.with_name("default_policy.toml")).methods
    for result in read_cells(folder / "benchmark" / "test"):
        if result.cell.method in methods:
            found.setdefault(f"{methods[result.cell.method].title} (this project)", []).append(result)
    for version in sorted({each.simulation_version for results in found.values() for each in results}, reverse=True):
        if valid := {name: results for name, results in found.items() if not any(violations(results, version))}:
            return valid
    return {}


def _is_uniform(report: BenchmarkReport) -> bool:
    """Returns whether all results are of test scenes, one version and the declared options."""
    changed = any(entry.earlier or entry.other_options for entry in report.entries.values())
    return report.scenes == "test" and not changed


def documents(folder: Path) -> dict[Path, str]:
    """Returns document -> text."""
    results = read_results(folder)
    shown = {name: result for name, result in results.items() if name in IN_README}
    reports = list(benchmark_reports(folder))
    by_scale = {report.scale: report for report in reports}
    means = {by_scale[scale].scale: text for scale, text in MEANS.items() if scale in by_scale}
    means = {scale: text for scale, text in means.items() if _is_uniform(by_scale[scale])}
    tables = filter(None, (text(by_scale[scale]) for scale, text in means.items()))
    note = _versions_note([*shown.values(), *chain(*(by_scale[scale].results for scale in means))])
    readme = with_block(README.read_text(encoding="utf-8"), readme_block(shown, tables, note))
    reports.sort(key=lambda report: (*SCALES, report.scale).index(report.scale))
    pages = [benchmark_page(report, level=2) for report in reports]
    numbers = csv_table(chain(csv_rows(results), *(report.csv_rows() for report in reports)))
    board = leaderboard_page(entries(folder))
    note = _versions_note([*results.values(), *chain(*(report.results for report in reports))])
    page = results_page(results, [PICTURES, *pages] if pages else [], note)
    notes = {
        path: _with_table(path, table(by_scale[scale])) for path, (scale, table) in TABLES.items() if scale in by_scale
    }
    return {PAGE: page, PAGE.with_suffix(".csv"): numbers, README: readme, BOARD: board, **notes}


def _versions_note(results: Sequence[ResultFile | CellResult]) -> str:
    """Returns what a reader must know of the versions behind some results; empty if they are the present ones."""
    mixed = mixed_versions(each.versions for each in results)
    told = f"They were measured with different versions installed: {mixed}." if mixed else ""
    return f"{earlier_version(each.simulation_version for each in results)} {told}".strip()


def _with_table(path: Path, table: str) -> str:
    return with_block(path.read_text(encoding="utf-8"), f"{START}\n{table}\n{END}")


def main() -> int:
    """Writes the documents, or lists outdated ones. Returns 0 on success."""
    return document_command(__doc__, lambda: documents(RESULTS))


if __name__ == "__main__":
    sys.exit(main())
