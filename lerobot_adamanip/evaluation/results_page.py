"""Tables from result files: the page docs/results.md, its CSV, and the block in the README."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from lerobot_adamanip.evaluation.groups import OBJECT_SPLITS
from lerobot_adamanip.evaluation.metrics import Metrics, pool
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.results import ResultFile, ResultRow
from lerobot_adamanip.evaluation.tables import metrics_table
from lerobot_adamanip.evaluation.text_format import duration_text, markdown_table, words

START, END = "<!-- results -->", "<!-- /results -->"
INTRODUCTION = """# Results

Generated from the files in `results/` by `python scripts/make_results.py`; a test compares the two.
[results.csv](results.csv) has all metrics of all rows, by split of objects and by hidden value;
[metrics](metrics.md) defines them.

Numbers of different *simulation versions* are of different episodes: do not compare them. Brackets hold Wilson's 95 %
intervals of rates and, in tables of differences, paired 95 % intervals over scenes; means have none. Commands are those
of the commit below each table, for a benchmark in its files `results/benchmark/SCALE/*.json`; later versions may spell
them otherwise.
"""
NOTHING = "No number is shown here: none has been measured yet."
_TRIES = ("key_frames", "wasted_tries", "repeated", "failures")
"""Metrics of the second table, limited by the page width; the CSV contains all."""


def results_page(results: Mapping[str, ResultFile], benchmarks: Iterable[str] = (), note: str = "") -> str:
    """Returns docs/results.md.

    Args:
        results: by file name.
        benchmarks: Markdown of the benchmark's reports.
        note: about the versions of all of them.
    """
    parts = [INTRODUCTION, *([f"{note}\n"] if note else []), *benchmarks]
    if not results and len(parts) == 1:
        parts.append(f"{NOTHING}\n")
    for name, result in results.items():
        parts.append(f"## {_heading(result)}\n")
        parts += [f"{table}\n" for table in (success_table(result), _tries(result)) if table]
        parts.append(f"{source_line(name, result)}\n")
    return "\n".join(parts)


def csv_rows(results: Mapping[str, ResultFile]) -> Iterator[tuple[dict[str, object], Metrics]]:
    """Yields labels and metrics of each row, for `csv_table`."""
    for name, result in results.items():
        for row in result.rows:
            labels = {each: value for each, value in vars(row).items() if each != "metrics"}
            yield {"result": name, "simulation_version": result.simulation_version, **labels}, row.metrics


def readme_block(results: Mapping[str, ResultFile], tables: Iterable[str] = (), note: str = "") -> str:
    """Returns the README block with both markers: results of mechanism rules `paper`.

    Policy selection used the validation scenes, so the block omits them once test scenes have results. It also omits
    experts once a policy has results. A single number gets no table. ``tables`` and ``note`` follow as they are.
    """
    fresh = [result for result in results.values() if any(row.mechanism_rules == "paper" for row in result.rows)]
    fresh = [result for result in fresh if result.scenes != "validation"] or fresh
    by_kind = {kind: [result for result in fresh if result.kind == kind] for kind in ("policy", "expert")}
    parts = [START]
    for result in by_kind["policy"] or by_kind["expert"]:
        single = len(result.rows) == 1
        told = f" {result.rows[0].metrics.show('success')}" if single else f"\n\n{success_table(result)}"
        parts.append(f"{_heading(result)} ({_scenes(result)}):{told}\n")
    parts += [f"{table}\n" for table in tables]
    sources = "Commands, seeds and commits are in `results/`; all categories in [results](docs/results.md)."
    parts.append(f"{note} {sources}".strip() if len(parts) > 1 else NOTHING)
    return "\n".join([*parts, END])


def with_block(document: str, block: str) -> str:
    """Returns a document with its marked block replaced; raises ValueError unless it has exactly one block."""
    before, start, rest = document.partition(START)
    _, end, after = rest.partition(END)
    if not start or not end or START in rest or END in after:
        raise ValueError(f"not exactly one block {START} ... {END}")
    return before + block + after


def success_table(result: ResultFile) -> str:
    """Returns success by subject, category and split of objects; adds means for subjects with several categories."""
    rows = result.rows
    splits = [split for split in OBJECT_SPLITS if any(row.objects == split for row in rows)]
    lines = []
    for subject, of_subject in _by_subject(rows).items():
        categories = _by_category(of_subject)
        for category, mine in categories.items():
            shown = {row.objects: row.metrics.show("success") for row in mine}
            lines.append([subject, words(category), *(shown.get(split, "-") for split in splits)])
        if len(categories) > 1:
            means = [_mean_success([row for row in of_subject if row.objects == each], categories) for each in splits]
            lines.append([subject, f"mean of {len(categories)}", *means])
    titles = [result.kind, "category", *(f"{split} objects" for split in splits)]
    return markdown_table(titles, lines)


def _tries(result: ResultFile) -> str:
    rows = [
        ((subject, words(category)), pool(row.metrics for row in mine))
        for subject, of_subject in _by_subject(result.rows).items()
        for category, mine in _by_category(of_subject).items()
    ]
    return metrics_table((result.kind, "category"), rows, _TRIES)


def _by_subject(rows: Sequence[ResultRow]) -> dict[str, list[ResultRow]]:
    """Returns name -> rows; the name includes the mechanism rules if there are several."""
    several = len({row.mechanism_rules for row in rows}) > 1
    found: dict[str, list[ResultRow]] = {}
    for row in rows:
        found.setdefault(f"{row.subject} ({row.mechanism_rules})" if several else row.subject, []).append(row)
    return found


def _by_category(rows: Iterable[ResultRow]) -> dict[str, list[ResultRow]]:
    found: dict[str, list[ResultRow]] = {}
    for row in rows:
        found.setdefault(row.category, []).append(row)
    return found


def _mean_success(rows: Sequence[ResultRow], categories: Collection[str]) -> str:
    """Returns the mean success over the categories; an empty text if one was not measured."""
    shares = [row.metrics.success.rate or 0.0 for row in rows]
    return f"{100 * sum(shares) / len(shares):.1f} %" if len(shares) == len(categories) else "-"


def source_line(name: str, result: ResultFile) -> str:
    """Returns the line that names the source of a table."""
    commit = "no commit" if result.commit is None else f"commit {result.commit[:10]}"
    commit += " with changes" if result.changed else ""
    taken = "" if result.seconds is None else f", {duration_text(result.seconds)}"
    made = f"{commit}, version {result.version}, simulation version {result.simulation_version}"
    scenes = f"{_scenes(result)}, seeds {result.seeds[0]} to {result.seeds[1]}"
    return f"`{result.command}`; {made}; {scenes}; {machine_text(result.machine)}{taken}. From `results/{name}`."


def _heading(result: ResultFile) -> str:
    return result.title[:1].upper() + result.title[1:]


def _scenes(result: ResultFile) -> str:
    return "scenes of no split" if result.scenes is None else f"{result.scenes} scenes"
