"""Report of a benchmark as Markdown, for its folder and for docs/results.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from lerobot_adamanip.benchmark.paper_rates import (
    PAPER_OBJECTS,
    SUCCESS_BY_TRIALS,
    TRIALS_CATEGORY,
    reported,
    reported_mean,
)
from lerobot_adamanip.benchmark.report import BUDGETS, BenchmarkReport, Entry, Row
from lerobot_adamanip.benchmark.run import WORDS
from lerobot_adamanip.evaluation.groups import is_half_of_range
from lerobot_adamanip.evaluation.metrics import Metrics, pool
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.rates import Difference, Rate
from lerobot_adamanip.evaluation.text_format import counted, duration_text, interval_text, markdown_table, words

NOT_RUN, UNAVAILABLE = "not run", "unavailable"
OTHER_CODE, OTHER_OPTIONS = "†", "‡"
_LEGEND = (
    "Successes, episodes, and Wilson's 95 % interval, the episodes of all trainings of a method together (how much "
    "trainings differ is not in it); the mean counts categories alike, and is told where there are all of them."
)
_PAPER_LEGEND = (
    "Rows in italics are the paper's, mean ± deviation in %, on its own objects and in its own simulator; over what "
    "they deviate it does not say."
)
_MARKS = {
    OTHER_CODE: "of other code than the present: not what it would give",
    OTHER_OPTIONS: "of other options than are declared now",
}


def benchmark_page(report: BenchmarkReport, level: int = 1) -> str:
    """Returns a report as Markdown; ``level`` is that of its first heading."""
    first, inner = "#" * level, "#" * (level + 1)
    parts = [f"{first} Benchmark, scale {report.scale}\n", _extent(report)]
    for title, body in _sections(report):
        parts += [f"{inner} {title}\n", f"{body}\n"]
    return "\n".join(parts)


def means_line(report: BenchmarkReport) -> str:
    """Returns the means over the categories in one line, best first.

    Empty unless all cells are there and of the present code, and where the paper's numbers do not stand beside them.
    """
    doubtful = any(each.other_code or each.other_options for each in report.entries.values())
    if not report.beside_paper or not report.results or report.missing or doubtful:
        return ""
    found = [(_name(row), [report.mean(row.name, objects) for objects in report.splits]) for row in report.rows]
    means = [(name, [mean for mean in each if mean is not None]) for name, each in found if None not in each]
    best = sorted(means, key=lambda item: -item[1][0])
    told = [f"{name} {', '.join(f'{100 * mean:.1f}' for mean in each)}" for name, each in best]
    return (
        f"All methods of the paper's table (`adamanip benchmark --scale {report.scale}`; mean success in % over "
        f"{len(report.categories)} categories, {' and '.join(report.splits)} objects, {report.scenes} scenes): "
        f"{'; '.join(told)}."
    )


def _sections(report: BenchmarkReport) -> Iterator[tuple[str, str]]:
    """Yields title and body of what there is to say."""
    if not report.results:
        return
    for objects in report.splits:
        yield f"Success on {objects} objects", _success(report, objects)
    for objects in report.splits:
        title = f"{_title(report, report.reference)} less the others on {objects} objects, in points"
        yield title, _differences(report, objects)
    if report.trials:
        yield "Success against failed trials in the demonstrations", _trials(report)
    yield "Success within a number of key frames", _budgets(report)
    yield "Failed tries per success beyond the best possible", _wasted(report)
    yield "After a try that failed", _recovery(report)
    yield "Given the luckiest hidden value", _lucky(report)
    yield "By what is hidden", _hidden(report)
    yield "What it took", _costs(report)


def _extent(report: BenchmarkReport) -> str:
    """What was reached and what was not, with reasons."""
    number = f"{counted(len(report.results), 'result')}{report.scenes and f' on {report.scenes} scenes'}."
    legends = (report.note, number, _LEGEND, _PAPER_LEGEND * report.beside_paper)
    lines = [" ".join(filter(None, legends))]
    marks = [
        f"{mark}: {meaning}"
        for mark, meaning in _MARKS.items()
        if any(mark in _mark(entry) for entry in report.entries.values())
    ]
    if marks:
        lines.append(f"{'; '.join(marks)}.")
    if len({(result.fingerprint, result.scenes) for result in report.results}) > 1:
        lines.append(
            "Mind: several fingerprints or splits of scenes; numbers of different ones are not to be compared."
        )
    if report.missing:
        without = [_name(row) for row in report.rows if row not in report.rows_with_results]
        methods = f" No result of: {', '.join(without)}." if without else ""
        lines.append(f"Declared and not run: {counted(len(report.missing), 'cell')}.{methods}")
    lines += [f"- {_title(report, name)} cannot be run here: {why}" for name, why in report.unavailable.items()]
    return "\n".join(lines) + "\n"


def _success(report: BenchmarkReport, objects: str) -> str:
    rows = []
    for row in report.rows_with_results:
        mean = report.mean(row.name, objects)
        cells = [_cell(report, row, category, objects) for category in report.categories]
        marks = "".join(mark for mark in _MARKS if any(mark in cell for cell in cells))
        rows.append([_name(row), *cells, "-" if mean is None else f"{100 * mean:.1f} %{marks and ' '}{marks}"])
        if row.paper and objects == PAPER_OBJECTS:
            rows.append(_paper_row(report, row))
    order = _order(report) if objects == PAPER_OBJECTS else ""
    return f"{_table(report, rows, 'mean')}{order}"


def _cell(report: BenchmarkReport, row: Row, category: str, objects: str) -> str:
    entry = report.entry(row.name, category, objects)
    if entry is None:
        return UNAVAILABLE if row.name in report.unavailable else NOT_RUN
    return interval_text(entry.numbers.success) + _mark(entry)


def _mark(entry: Entry) -> str:
    code, options = OTHER_CODE * entry.other_code, OTHER_OPTIONS * entry.other_options
    few = f" ({len(entry.seeds)} of {entry.wanted} trainings)" if len(entry.seeds) < entry.wanted else ""
    return f"{' ' if code or options else ''}{code}{options}{few}"


def _paper_row(report: BenchmarkReport, row: Row) -> list[str]:
    values = [reported(row.paper, category) for category in report.categories]
    mean = reported_mean(row.paper, report.categories)
    cells = ["-" if value is None else f"*{value[0]:.1f} ± {value[1]:.1f}*" for value in values]
    return [f"*{row.paper}*", *cells, "-" if mean is None else f"*{mean:.1f}*"]


def _order(report: BenchmarkReport) -> str:
    """The order of the means beside the paper's, of the methods that have both."""
    found = {}
    for row in report.rows:
        mean, paper = report.mean(row.name, PAPER_OBJECTS), reported_mean(row.paper, report.categories)
        if mean is not None and paper is not None:
            found[row.title] = mean, paper
    if len(found) < 2:
        return ""
    ours, papers = (sorted(found, key=lambda title: -found[title][place]) for place in (0, 1))
    return f"\n\nOrder of the means: {' > '.join(ours)}. In the paper: {' > '.join(papers)}."


def _differences(report: BenchmarkReport, objects: str) -> str:
    rows = []
    for row in report.rows_with_results:
        if row.name != report.reference:
            groups = [*((category,) for category in report.categories), report.categories]
            gaps = [report.to_reference(row.name, group, objects) for group in groups]
            rows.append([_name(row), *map(_difference, gaps)])
    told = "95 % intervals; in bold where zero lies outside. The last column is of all episodes together."
    return f"{_table(report, rows, 'all')}\n\n{told}"


def _difference(gap: Difference | None) -> str:
    if gap is None:
        return "-"
    text = f"{100 * gap.difference:+.0f} [{100 * gap.low:+.0f}, {100 * gap.high:+.0f}]"
    return f"**{text}**" if gap.low > 0 or gap.high < 0 else text


def _trials(report: BenchmarkReport) -> str:
    curves = sorted({(place[0], place[2], place[3]) for place in report.entries if place[1] is not None})
    rows = []
    for method, category, objects in curves:
        found = [report.entry(method, category, objects, trials) for trials in report.trials]
        cells = [NOT_RUN if each is None else interval_text(each.numbers.success) + _mark(each) for each in found]
        curve = f"{_title(report, method)}, {words(category)}, {objects} objects"
        rows.append([curve, *cells])
        for budget in BUDGETS[1:-1]:
            within = [NOT_RUN if each is None else interval_text(each.numbers.opened_within(budget)) for each in found]
            rows.append([f"{curve}, within {budget} key frames", *within])
    if report.beside_paper:
        values = dict(enumerate(SUCCESS_BY_TRIALS))
        papers = [f"*{values[trials]:.1f}*" if trials in values else "-" for trials in report.trials]
        rows.append([f"*the paper, {TRIALS_CATEGORY}*", *papers])
    return markdown_table(["", *map(str, report.trials)], rows)


def _budgets(report: BenchmarkReport) -> str:
    rows = []
    for row in report.rows:
        for objects in report.splits:
            means = [report.mean(row.name, objects, within=budget) for budget in BUDGETS]
            if means[-1] is not None:
                rows.append([_name(row), objects, *("-" if mean is None else f"{100 * mean:.1f} %" for mean in means)])
    if not rows:
        return "No method has results of all categories yet."
    return markdown_table(["mean over the categories", "objects", *map(str, BUDGETS)], rows)


def _wasted(report: BenchmarkReport) -> str:
    told = (
        "Failed tries per success, less those of the best strategy that does not see the hidden state either. Below "
        "zero: it opens where it guesses right, and fails where it does not. All splits of objects together."
    )
    return f"{_by_category(report, _wasted_cell)}\n\n{told}"


def _wasted_cell(numbers: Metrics) -> str:
    wasted = None if numbers.wasted_tries is None else numbers.wasted_tries.value
    return "-" if wasted is None else f"{wasted:+.2f}"


def _recovery(report: BenchmarkReport) -> str:
    rows = []
    for row in report.rows:
        if found := report.numbers(row.name, report.categories, report.splits):
            metrics = pool(found)
            after_one = (metrics.repeated, (metrics.untried or {}).get(1))
            rows.append([_name(row), *("-" if each is None else interval_text(each) for each in after_one)])
    return markdown_table(["", "the same again", "something new after one that failed"], rows)


def _lucky(report: BenchmarkReport) -> str:
    told = (
        "What is opened of the episodes with the hidden value with which a method opens most. Whoever plans once opens "
        "these at best, and none of the others. All splits of objects together."
    )
    return f"{_by_category(report, _lucky_cell)}\n\n{told}"


def _lucky_cell(numbers: Metrics) -> str:
    known = {name: each for name, each in _discrete(numbers).items() if each.episodes}
    if not known:
        return "-"
    name = max(sorted(known), key=lambda each: known[each].rate or 0.0)
    return f"{known[name].count}/{known[name].episodes} ({name})"


def _discrete(numbers: Metrics) -> dict[str, Rate]:
    """Returns success by hidden value, without halves of continuous ranges, which differ between evaluations."""
    return {name: each for name, each in (numbers.hidden or {}).items() if not is_half_of_range(name)}


def _hidden(report: BenchmarkReport) -> str:
    methods = [row for row in report.rows if report.numbers(row.name, report.categories, report.splits)]
    rows = []
    for category in report.categories:
        found = {}
        for row in methods:
            if numbers := report.numbers(row.name, (category,), report.splits):
                found[row.name] = _discrete(pool(numbers))
        for name in sorted({name for hidden in found.values() for name in hidden}):
            rates = [found.get(row.name, {}).get(name) for row in methods]
            cells = ["-" if each is None else f"{each.count}/{each.episodes}" for each in rates]
            rows.append([f"{words(category)}: {name}", *cells])
    return markdown_table(["", *map(_name, methods)], rows)


def _costs(report: BenchmarkReport) -> str:
    costs = report.costs()
    lines = [
        f"- {WORDS[kind]}: {duration_text(sum(each.seconds for each in found))}, {counted(len(found), 'time')}"
        for kind, found in costs.items()
    ]
    machines = sorted(
        (each.machine for found in costs.values() for each in found), key=lambda m: (m["cores"], m["gpu"])
    )
    lines.append(f"- on {'; '.join(dict.fromkeys(map(machine_text, machines)))}")
    origins = [each.origin for each in report.results]
    commits = {f"{each.commit or 'none'}"[:10] + " with changes" * each.changed for each in origins}
    fingerprints = {f"`{each.fingerprint}`" for each in report.results}
    versions = {each.version for each in origins}
    for what, values in (("commit", commits), ("fingerprint", fingerprints), ("version", versions)):
        lines.append(f"- {what}: {', '.join(sorted(values))}")
    return "\n".join(lines)


def _by_category(report: BenchmarkReport, cell: Callable[[Metrics], str]) -> str:
    rows = []
    for row in report.rows:
        found = [report.numbers(row.name, (category,), report.splits) for category in report.categories]
        if any(found):
            rows.append([_name(row), *(cell(pool(each)) if each else "-" for each in found)])
    return _table(report, rows)


def _table(report: BenchmarkReport, rows: Iterable[list[str]], *more: str) -> str:
    return markdown_table(["", *map(words, report.categories), *more], rows)


def _name(row: Row) -> str:
    return f"{row.title} ({row.package})" if row.package else row.title


def _title(report: BenchmarkReport, method: str) -> str:
    return next((row.title for row in report.rows if row.name == method), method)
