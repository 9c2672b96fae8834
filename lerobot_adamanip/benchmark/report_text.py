"""Report of a benchmark as Markdown, for its folder and for docs/results.md."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Iterable, Iterator

from lerobot_adamanip.benchmark.budget import budget_table
from lerobot_adamanip.benchmark.paired_text import effects_table, method_name, paired_table, title_of
from lerobot_adamanip.benchmark.paper_rates import (
    PAPER_OBJECTS,
    SUCCESS_BY_TRIALS,
    TRIALS_CATEGORY,
    reported,
    reported_mean,
)
from lerobot_adamanip.benchmark.report import BUDGETS, FEW_KEY_FRAMES, BenchmarkReport, Entry
from lerobot_adamanip.benchmark.result import StepCost
from lerobot_adamanip.benchmark.run import WORDS
from lerobot_adamanip.contract.versions import joined_versions, mixed_versions
from lerobot_adamanip.evaluation.metrics import METRICS, Metrics
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.rates import Rate
from lerobot_adamanip.evaluation.text_format import counted, duration_text, interval_text, markdown_table, words

_PAPER = f"the paper, {PAPER_OBJECTS}"
EARLIER, OTHER_OPTIONS, BELOW_PAPER = "†", "‡", " ↓"
_LEGEND = (
    "Numbers are pooled over all trainings of a method, which see the same scenes. A mean weights all categories "
    "equally. The CSV file beside this page has counts, Wilson's 95 % intervals and all metrics of each category, also "
    "by hidden value. These intervals take all episodes as independent, so they are too narrow where several trainings "
    "see the same scenes."
)
_PAPER_LEGEND = (
    "The paper's values are mean ± deviation in %, on its own objects and in its own simulator. It does not say what "
    "the deviation measures. ↓: below the paper's mean less its deviation."
)
_SUCCESS, _WITHIN = operator.attrgetter("success"), operator.attrgetter("within_best_tries")
_MARKS = {
    EARLIER: "of an earlier simulation or data version than the others; not to be compared with them",
    OTHER_OPTIONS: "of other options than declared now",
}


def benchmark_page(report: BenchmarkReport, level: int = 1) -> str:
    """Returns a report as Markdown; ``level`` is the level of its first heading."""
    first, inner = "#" * level, "#" * (level + 1)
    parts = [f"{first} Benchmark, scale {report.scale}\n", _extent(report)]
    for title, body in _sections(report):
        parts += [f"{inner} {title}\n", f"{body}\n"]
    return "\n".join(parts)


def summary(report: BenchmarkReport) -> str:
    """Returns the means of the methods that have results of all categories, as a short table; empty without any."""
    rows = []
    for row in report.rows_with_results:
        means = [(report.mean(row.name, each), report.mean(row.name, each, _WITHIN)) for each in report.splits]
        if means[0][0] is not None:
            shown = ["-" if opened is None else f"{_mean(opened)}, {_mean(within)}" for opened, within in means]
            rows.append([method_name(row), *shown, report.trainings(row.name, report.splits[0])])
    titles = ["method", *(f"{objects} objects: opened, within" for objects in report.splits), "trainings"]
    number = counted(report.results[0].numbers.success.episodes, "scene") if rows else ""
    explanation = (
        f"Means over {len(report.categories)} categories, {number} of each, {report.scenes} scenes. A category's "
        f"number is over all its trainings, which see the same scenes. *Within*: {METRICS['within_best_tries'].title}."
    )
    return f"{markdown_table(titles, rows)}\n\n{explanation}" if rows else ""


def means_beside_paper(report: BenchmarkReport) -> str:
    """Returns the mean success of the paper's methods with the paper's numbers in brackets; empty without any."""
    means = []
    for row in report.rows_with_results if report.beside_paper else ():
        paper, ours = reported_mean(row.paper, report.categories), report.mean(row.name, PAPER_OBJECTS)
        if paper is not None and ours is not None:
            means.append(f"{method_name(row)} {_mean(ours)} ({paper:.1f})")
    if not means:
        return ""
    number = counted(report.results[0].numbers.success.episodes, f"{report.scenes} scene")
    title = f"Mean success in the setting of the paper's code, {number} of each category (in the paper)"
    return f"{title}: {', '.join(means)}."


def _sections(report: BenchmarkReport) -> Iterator[tuple[str, str]]:
    """Yields the title and body of each section that has data."""
    if not report.results:
        return
    if len(report.categories) > 1:
        yield "Mean success", _means(report)
    yield "Success by category [%]", success_by_category(report)
    if within := _by_category(report, _WITHIN):
        yield f"{METRICS['within_best_tries'].title}, by category [%]".capitalize(), within
    if paired := paired_table(report):
        yield "In the same scenes", paired
    if effects := effects_table(report):
        yield "Effects of changes", effects
    if report.trials:
        yield "Success against failed trials in the demonstrations", _trials(report)
    yield "Success within a number of key frames", _budgets(report)
    yield "Tries", _tries(report)
    if budgets := budget_table(report):
        yield "Budget", budgets
    yield "Cost", _costs(report)


def _extent(report: BenchmarkReport) -> str:
    """Returns the number of results, the missing cells, and methods that cannot run here."""
    simulation = " and ".join(sorted({str(result.simulation_version) for result in report.results}))
    where = f" on {report.scenes} scenes, simulation version {simulation}" if report.results else ""
    number = f"{counted(len(report.results), 'result')}{where}."
    legends = (report.note, number, _LEGEND, _PAPER_LEGEND * report.beside_paper)
    lines = [" ".join(filter(None, legends))]
    shown = "".join(map(_mark, report.entries.values()))
    if marks := [f"{mark}: {meaning}" for mark, meaning in _MARKS.items() if mark in shown]:
        lines.append(f"{'; '.join(marks)}.")
    if len({(report.scenes_of(result)[0], result.scenes) for result in report.results}) > 1:
        lines.append("Mind: several simulation versions or splits of scenes; do not compare numbers of different ones.")
    if mixed := mixed_versions(result.all_versions for result in report.results):
        lines.append(f"Mind: measured with different versions installed: {mixed}.")
    if report.missing:
        without = [method_name(row) for row in report.rows if row not in report.rows_with_results]
        methods = f" No result of: {'; '.join(without)}." if without else ""
        number = counted(len(report.missing), "cell")
        lines.append(f"Declared and not run: {number}; rows without a result are left out.{methods}")
    lines += [f"- {title_of(report, name)} cannot be run here: {why}" for name, why in report.unavailable.items()]
    return "\n".join(lines) + "\n"


def _means(report: BenchmarkReport) -> str:
    first, within_title = report.splits[0], METRICS["within_best_tries"].title
    rows = []
    for row in report.rows_with_results:
        cells = []
        for objects in report.splits:
            entries = [report.entry(row.name, category, objects) for category in report.categories]
            marks = "".join(mark for mark in _MARKS if any(entry and mark in _mark(entry) for entry in entries))
            cells.append(f"{_mean(report.mean(row.name, objects))} {marks}".strip())
        if set(cells) == {"-"}:
            continue
        paper = reported_mean(row.paper, report.categories)
        cells += [_mean(report.mean(row.name, first, _WITHIN)), report.trainings(row.name, first)]
        cells += ["-" if paper is None else f"{paper:.1f} %"] * report.beside_paper
        rows.append([method_name(row), *cells])
    titles = ["method", *_objects(report), f"{within_title}, {first}", "trainings", *[_PAPER] * report.beside_paper]
    return markdown_table(titles, rows)


def _mean(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def success_by_category(report: BenchmarkReport) -> str:
    """Returns success in percent, a column a category, with the paper's rows if they stand beside."""
    return _by_category(report, _SUCCESS, report.beside_paper)


def _by_category(report: BenchmarkReport, share: Callable[[Metrics], Rate | None], beside_paper: bool = False) -> str:
    """Returns a table of a rate in percent, a column a category; empty without a result that has the rate."""
    rows, shown, categories = [], set(), report.categories_with_results
    for row, objects in itertools.product(report.rows_with_results, report.splits):
        beside = beside_paper and objects == PAPER_OBJECTS
        papers = [reported(row.paper, category) if beside else None for category in categories]
        cells = [
            _cell(report.entry(row.name, category, objects), share, paper)
            for category, paper in zip(categories, papers, strict=True)
        ]
        if any(cell[0] != "-" for cell in cells):
            rows.append([f"{method_name(row)}, {objects}", *cells])
        if any(papers) and row.paper not in shown:
            shown.add(row.paper)
            values = ("-" if paper is None else "{:.0f} ± {:.0f}".format(*paper) for paper in papers)
            rows.append([f"{row.paper}, {_PAPER}", *values])
    return markdown_table(["method, objects", *map(words, categories)], rows) if rows else ""


def _cell(entry: Entry | None, share: Callable[[Metrics], Rate | None], paper: tuple[float, float] | None) -> str:
    """Returns a rate in percent with its marks; ``paper`` is the paper's mean and deviation [%]."""
    rate = None if entry is None else share(entry.numbers)
    if entry is None or rate is None or rate.rate is None:
        return "-"
    below = paper is not None and 100 * rate.rate < paper[0] - paper[1]
    return f"{100 * rate.rate:.1f}".removesuffix(".0") + BELOW_PAPER * below + _mark(entry)


def _mark(entry: Entry) -> str:
    marks = EARLIER * entry.earlier + OTHER_OPTIONS * entry.other_options
    return f"{' ' if marks else ''}{marks}"


def _trials(report: BenchmarkReport) -> str:
    rows = []
    for method, category, objects in report.curves:
        for trials in report.trials:
            entry = report.entry(method, category, objects, trials)
            cells = ["not run", "not run"]
            if entry is not None:
                within = interval_text(entry.numbers.opened_within(FEW_KEY_FRAMES))
                cells = [interval_text(entry.numbers.success) + _mark(entry), within]
            known = report.beside_paper and category == TRIALS_CATEGORY and trials < len(SUCCESS_BY_TRIALS)
            paper = f"{SUCCESS_BY_TRIALS[trials]:.1f} %" if known else "-"
            rows.append([words(category), objects, str(trials), *cells, paper])
    titles = ["category", "objects", "failed trials", "success", f"within {FEW_KEY_FRAMES} key frames", "the paper"]
    return markdown_table(titles, rows)


def _budgets(report: BenchmarkReport) -> str:
    rows = []
    for row in report.rows:
        for objects in report.splits:
            means = [report.mean(row.name, objects, operator.methodcaller("opened_within", each)) for each in BUDGETS]
            if means[-1] is not None:
                rows.append(
                    [method_name(row), objects, *("-" if mean is None else f"{100 * mean:.1f} %" for mean in means)]
                )
    if not rows:
        return "No method has results of all categories yet."
    return markdown_table(["mean over the categories", "objects", *map(str, BUDGETS)], rows)


def _tries(report: BenchmarkReport) -> str:
    rows = []
    for row, objects in itertools.product(report.rows, report.splits):
        if found := report.numbers(row.name, report.categories, (objects,)):
            wasted = _known_mean(each.wasted_tries.value for each in found if each.wasted_tries)
            repeated = _known_mean(each.repeated.rate for each in found if each.repeated)
            new = _known_mean(after_one.rate for each in found if (after_one := (each.untried or {}).get(1)))
            shares = ["-" if each is None else f"{100 * each:.0f} %" for each in (repeated, new)]
            shown = "-" if wasted is None else f"{wasted:.2f}"
            rows.append([method_name(row), objects, str(len(found)), shown, *shares])
    titles = ["method", "objects", "categories", "wasted tries", "failed tries repeated", "new after a failed try"]
    explanation = (
        "Means over the categories that have a value, equally weighted. Wasted tries are the failed tries per success "
        "minus those that a strategy without sight of the hidden state must expect. New after a failed try: after one "
        "kind of failed try since the last motion."
    )
    return f"{markdown_table(titles, rows)}\n\n{explanation}"


def _known_mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _costs(report: BenchmarkReport) -> str:
    costs: dict[str, dict[str, StepCost]] = {}  # a step that several cells share appears once
    for result in report.results:
        for name, cost in result.costs.items():
            costs.setdefault(name.partition("_")[0], {})[result.steps[name].key] = cost
    lines = [
        f"- {WORDS[kind]}: {duration_text(sum(each.seconds for each in found.values()))}, {counted(len(found), 'time')}"
        for kind, found in costs.items()
    ]
    machines = sorted(
        (each.machine for found in costs.values() for each in found.values()), key=lambda m: (m["cores"], m["gpu"])
    )
    lines.append(f"- on {'; '.join(dict.fromkeys(map(machine_text, machines)))}")
    commits = {f"{each.commit or 'none'}"[:10] + " with changes" * each.changed for each in report.results}
    simulation, data, versions = (
        {str(getattr(each, name)) for each in report.results}
        for name in ("simulation_version", "data_version", "version")
    )
    installed = joined_versions(each.all_versions for each in report.results)
    scenes = {"{} to {}".format(*each.scene_seeds) for each in report.results}
    for what, values in (
        ("seeds of scenes", scenes),
        ("commit", commits),
        ("simulation version", simulation),
        ("data version", data),
        ("version", versions),
        ("installed", {f"{name} {version}" for name, version in installed.items()}),
    ):
        lines.append(f"- {what}: {', '.join(sorted(values))}")
    return "\n".join(lines)


def _objects(report: BenchmarkReport) -> list[str]:
    return [f"{objects} objects" for objects in report.splits]
