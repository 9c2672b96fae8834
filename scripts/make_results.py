"""Writes the results of docs and README: ``python scripts/make_results.py [--check]``.

The documents are docs/results.md, docs/results.csv, docs/leaderboard.md, and a block in the README. The sources are
results/*.json and, from `adamanip benchmark`, results/benchmark/SCALE/*.json. README and docs/results.md say if they
were measured with another simulation version than the present one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from check_common import ROOT, document_command

from lerobot_adamanip.benchmark.declaration import PAPER_TABLE, read_declaration
from lerobot_adamanip.benchmark.leaderboard import leaderboard_page, read_entry
from lerobot_adamanip.benchmark.report import BenchmarkReport, make_report
from lerobot_adamanip.benchmark.report_text import LEGEND, benchmark_page, summary
from lerobot_adamanip.contract.versions import earlier_version, mixed_versions
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.report import OBJECT_SPLITS
from lerobot_adamanip.evaluation.results import ResultFile, ResultRow, read_results
from lerobot_adamanip.evaluation.text_format import csv_table, duration_text, markdown_table, percent_text, words

IN_README = ("demo.json",)
"""Result files for the README. docs/results.md shows all."""
MEANS = {"test": ("dp3_adaptive", "without_memory", "never_with_memory", "mm20", "mm20_calibrated", "d435")}
"""Scale -> methods whose means the README shows; docs/results.md has all."""
SCALES = (
    "test", "row", "held_out_row", "held_out_changing", "held_out_category", "held_out_category_five",
    "held_out_mechanism", "real_sensors", "again", "paper", "one_object", "control_rate", "paper_0_2",
)  # fmt: skip
"""Order of the scales on the page; others follow."""
PAGE, BOARD = ROOT / "docs" / "results.md", ROOT / "docs" / "leaderboard.md"
README, RESULTS = ROOT / "README.md", ROOT / "results"
START, END = "<!-- results -->", "<!-- /results -->"
NOTHING = "No number is shown here: none has been measured yet."
INTRODUCTION = """# Results

Generated from the files in `results/` by `python scripts/make_results.py`; a test compares the two.
[results.csv](results.csv) has all metrics and intervals of all rows; [metrics](metrics.md) defines them.
Numbers of different *simulation versions* are of different episodes: do not compare them. Commands are in the files.
They are those of the commit below each table; later versions may spell them otherwise.
"""
PICTURES = """![Success over the failed tries that an episode may have](images/benchmark_tries.png)

![Opened within the best strategy's tries, with intervals, scale test](images/benchmark_success.png)

![Success in the setting of the paper's code, scale paper_0_2; dashes: the paper](images/benchmark_paper.png)

![Opened within the tries at control rate, scale control_rate](images/benchmark_control_rate.png)

![Training losses at control rate; an interrupted training has none](images/benchmark_control_rate_losses.png)
"""


def benchmark_reports(folder: Path) -> Iterator[BenchmarkReport]:
    """Yields a report per scale that has results; see `declarations`."""
    for declaration in map(read_declaration, declarations(folder)):
        for scale in declaration.scales:
            if results := read_results(folder / "benchmark" / scale):
                yield make_report(results.values(), declaration, scale)


def declarations(folder: Path) -> list[Path]:
    """Returns the files of our declarations, and of those that are kept beside results of earlier code."""
    return [*sorted(PAPER_TABLE.parent.glob("*.toml")), *sorted((folder / "benchmark").glob("*/declaration.toml"))]


def documents(folder: Path) -> dict[Path, str]:
    """Returns document -> text."""
    results = read_results(folder)
    reports = sorted(benchmark_reports(folder), key=lambda report: (*SCALES, report.scale).index(report.scale))
    lines = [line for name, result in results.items() for line in csv_lines(name, result)]
    csv = csv_table([*lines, *(line for report in reports for line in report.csv_lines())])
    return {
        PAGE: results_page(results, reports),
        PAGE.with_suffix(".csv"): csv,
        README: with_block(README.read_text(encoding="utf-8"), readme_block(results, reports)),
        BOARD: leaderboard_page({path.name: read_entry(path) for path in sorted((folder / "leaderboard").glob("*/"))}),
    }


def csv_lines(name: str, result: ResultFile) -> Iterator[dict[str, object]]:
    """Yields the labels and metrics of each row of a result file."""
    for row in result.rows:
        labels = {"subject": row.subject, "mechanism_rules": row.mechanism_rules}
        origin = {"result": name, "simulation_version": result.simulation_version}
        yield {**origin, **labels, "category": row.category, "objects": row.objects, **row.metrics.columns()}


def results_page(results: Mapping[str, ResultFile], reports: Iterable[BenchmarkReport]) -> str:
    """Returns docs/results.md."""
    reports = list(reports)
    note = _versions_note([*results.values(), *(result for report in reports for result in report.results)])
    parts = [INTRODUCTION, *([f"{note}\n"] if note else [])]
    if reports:
        parts += [PICTURES, *(benchmark_page(report, level=2) for report in reports), LEGEND]
    if not results and not reports:
        parts.append(f"{NOTHING}\n")
    for name, result in results.items():
        title = result.title[:1].upper() + result.title[1:]
        parts.append(f"## {title}\n\n{success_table(result)}\n\n{_source(name, result)}\n")
    return "\n".join(parts)


def success_table(result: ResultFile) -> str:
    """Returns success by subject, category and split of objects; adds means for subjects with several categories.

    Results of several mechanism rules have lines for each of them.
    """
    splits = [split for split in OBJECT_SPLITS if any(row.objects == split for row in result.rows)]
    rules = {row.mechanism_rules for row in result.rows}
    subjects: dict[str, dict[str, dict[str, ResultRow]]] = {}
    for row in result.rows:
        subject = f"{row.subject}, rules {row.mechanism_rules}" if len(rules) > 1 else row.subject
        subjects.setdefault(subject, {}).setdefault(row.category, {})[row.objects] = row
    lines = []
    for subject, categories in subjects.items():
        for category, rows in categories.items():
            counts = {objects: row.metrics.success for objects, row in rows.items()}
            cells = [f"{counts[one].count}/{counts[one].episodes}" if one in counts else "-" for one in splits]
            lines.append([subject, words(category), *cells])
        if len(categories) > 1:
            means = [_mean([rows.get(objects) for rows in categories.values()]) for objects in splits]
            lines.append([subject, f"mean of {len(categories)}", *map(percent_text, means)])
    return markdown_table([result.kind, "category", *(f"{split} objects" for split in splits)], lines)


def _mean(rows: Iterable[ResultRow | None]) -> float | None:
    rates = [None if row is None else row.metrics.success.rate for row in rows]
    return None if None in rates else sum(rate or 0.0 for rate in rates) / len(rates)


def _source(name: str, result: ResultFile) -> str:
    commit = f"{f'commit {result.commit[:10]}' if result.commit else 'no commit'}{' with changes' * result.changed}"
    duration = "" if result.seconds is None else f", {duration_text(result.seconds)}"
    origin = f"{commit}, version {result.version}, simulation version {result.simulation_version}"
    scenes = f"{_scenes(result)}, seeds {result.seeds[0]} to {result.seeds[1]}"
    return f"`{result.command}`; {origin}; {scenes}; {machine_text(result.machine)}{duration}. From `results/{name}`."


def _scenes(result: ResultFile) -> str:
    return "scenes of no split" if result.scenes is None else f"{result.scenes} scenes"


def readme_block(results: Mapping[str, ResultFile], reports: Iterable[BenchmarkReport]) -> str:
    """Returns the README block with both markers: the files of `IN_README`, and the means of `MEANS`."""
    shown = [result for name, result in results.items() if name in IN_README]
    uniform = {report.scale: report for report in reports if _is_uniform(report)}
    means = {scale: summary(uniform[scale], methods) for scale, methods in MEANS.items() if scale in uniform}
    parts = [
        f"{result.title} ({_scenes(result)}): {row.metrics.show('success')}\n"
        for result in shown
        for row in result.rows
    ]
    parts += [f"{table}\n" for table in means.values() if table]
    note = _versions_note([*shown, *(result for scale in means for result in uniform[scale].results)])
    sources = "Commands, seeds and commits are in `results/`; all categories in [results](docs/results.md)."
    return "\n".join([START, *parts, f"{note} {sources}".strip() if parts else NOTHING, END])


def _is_uniform(report: BenchmarkReport) -> bool:
    """Returns whether all results are of test scenes, one version and the declared options."""
    return report.scenes == "test" and not any(entry.marks for entry in report.entries.values())


def _versions_note(results: Iterable[ResultFile]) -> str:
    """Returns what a reader must know of the versions behind some results; empty if they are the present ones."""
    results = list(results)
    mixed = mixed_versions(result.versions for result in results)
    differing = f"They were measured with different versions installed: {mixed}." if mixed else ""
    return f"{earlier_version(result.simulation_version for result in results)} {differing}".strip()


def with_block(document: str, block: str) -> str:
    """Returns a document with its marked block replaced; raises ValueError unless it has exactly one block."""
    before, start, rest = document.partition(START)
    _, end, after = rest.partition(END)
    if not start or not end or START in rest or END in after:
        raise ValueError(f"not exactly one block {START} ... {END}")
    return before + block + after


def main() -> int:
    """Writes the documents, or lists outdated ones. Returns 0 on success."""
    return document_command(__doc__, lambda: documents(RESULTS))


if __name__ == "__main__":
    sys.exit(main())
