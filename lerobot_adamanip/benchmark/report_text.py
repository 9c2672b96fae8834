"""Report of a benchmark as Markdown, for its folder and for docs/results.md."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from lerobot_adamanip.benchmark.paper_rates import PAPER_OBJECTS, reported, reported_mean
from lerobot_adamanip.benchmark.plan import COLLECT, CORRECT, TRAIN
from lerobot_adamanip.benchmark.report import MARKS, BenchmarkReport, Entry, last_trainings, within
from lerobot_adamanip.benchmark.run import WORDS
from lerobot_adamanip.catalog import parse_object_selection
from lerobot_adamanip.contract.versions import joined_versions, mixed_versions
from lerobot_adamanip.evaluation.metrics import METRICS
from lerobot_adamanip.evaluation.paired import OPENED, WITHIN_TRIES, PairedDifference
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.rates import show
from lerobot_adamanip.evaluation.results import CellRun, StepCost
from lerobot_adamanip.evaluation.text_format import counted, duration_text, markdown_table, percent_text, words

BELOW_PAPER = "↓"
_PAPER = f"the paper, {PAPER_OBJECTS}"
_WITHIN_TITLE = METRICS["within_best_tries"].title
LEGEND = f"""## How to read it

- *Within*: {_WITHIN_TITLE}. *Repeated*: failed tries that the next try repeats.
- Numbers are pooled over all trainings of a method, which see the same scenes. Means weight categories equally
  and need a result of each; those of tries leave out categories without a success or without a failed try.
- The CSV file has counts, Wilson's 95 % intervals and all metrics of each category, also by hidden value. Its intervals
  take all episodes as independent, so they are too narrow where several trainings see the same scenes, where several
  episodes in a row play one scene, or where the object decides more than the scene.
- The paper's values are mean ± deviation in %, on its own objects and in its own simulator. It does not say what the
  deviation measures. {BELOW_PAPER}: below the paper's mean less its deviation.
- Differences are with a change less without it, in points, in the same scenes: the mean over scenes and trainings, a
  95 % interval over scenes, then each training's difference. The interval excludes the spread between trainings, each
  of demonstrations of its own, and is not corrected for the number of comparisons. Two added scenes keep it from
  collapsing where methods agree. With fixed poses, scenes with equal object and hidden values are nearly one scene, and
  intervals are too narrow. A training in which one of the two lacks a category, or has other scenes, is left out.
- Failed tries of a time that a scene is played leave out moved keys of unlocked objects; above 9 they count as 9.
- Budgets are means over a method's trainings. Minutes are of corrections and trainings, and depend on the machine's
  other load. The last column is the change of the training loss from the last but one fifth of the last training to its
  last fifth: a loss that falls there has not converged.
"""


def benchmark_page(report: BenchmarkReport, level: int = 1) -> str:
    """Returns a report as Markdown; ``level`` is the level of its first heading. `LEGEND` explains its tables."""
    tables = {
        "Means over the categories": means_table(report),
        "By category: opened/within [%]": category_table(report),
        "Each time that a scene is played": turns_table(report),
        "Differences in the same scenes": differences_table(report),
        "Budget": budget_table(report),
        "Cost": _costs(report) if report.results else "",
    }
    parts = [f"{'#' * level} Benchmark, scale {report.scale}\n", _extent(report)]
    parts += [f"{'#' * (level + 1)} {title}\n\n{table}\n" for title, table in tables.items() if table]
    return "\n".join(parts)


def summary(report: BenchmarkReport, methods: Collection[str]) -> str:
    """Returns the means of those methods that have results of all categories, as a short table; empty without any."""
    rows = []
    for name in (name for name in report.methods if name in methods):
        means = [(report.mean(name, objects), report.mean(name, objects, within)) for objects in report.splits]
        if means[0][0] is not None:
            marks = [_marks(report.of(name, objects)) for objects in report.splits]
            cells = [
                "-" if one is None else f"{percent_text(one)}, {percent_text(other)} {mark}".strip()
                for (one, other), mark in zip(means, marks, strict=True)
            ]
            trainings = [report.trainings(name, objects) or "-" for objects in report.splits]
            numbers = sorted({*trainings} - {"-"})
            rows.append([report.titles[name], *cells, ", ".join(trainings if len(numbers) > 1 else numbers)])
    if not rows:
        return ""
    titles = ["method", *(f"{objects} objects: opened, within" for objects in report.splits), "trainings"]
    number = counted(report.results[0].rows[0].metrics.success.episodes, "scene")
    explanation = (
        f"Means over {len(report.categories)} categories, {number} of each, {report.scenes} scenes. A category's "
        f"number is over all its trainings, which see the same scenes. *Within*: {_WITHIN_TITLE}: "
        "after at most 0, 1 or 2 failed ones, by category."
    )
    return "\n\n".join(filter(None, (markdown_table(titles, rows), explanation, _meanings(report))))


def _marks(entries: Iterable[Entry]) -> str:
    """Returns the marks of entries, each once."""
    shown = "".join(entry.marks for entry in entries)
    return "".join(mark for mark in MARKS if mark in shown)


def _meanings(report: BenchmarkReport) -> str:
    """Returns what the marks of a report mean; empty without any."""
    return "; ".join(f"{mark}: {MARKS[mark]}" for mark in _marks(report.entries.values()))


def _extent(report: BenchmarkReport) -> str:
    """Returns the number of results, the missing cells, and methods that cannot run here."""
    versions = sorted({str(result.simulation_version) for result in report.results})
    where = f" on {report.scenes} scenes, simulation version {' and '.join(versions)}" if report.results else ""
    lines = [" ".join(filter(None, (report.note, f"{counted(len(report.results), 'result')}{where}.")))]
    if meanings := _meanings(report):
        lines.append(f"{meanings}.")
    if len({(result.simulation_version, result.scenes) for result in report.results}) > 1:
        lines.append("Note: several simulation versions or splits of scenes; do not compare numbers of different ones.")
    if mixed := mixed_versions(result.all_versions for result in report.results):
        lines.append(f"Note: measured with different versions installed: {mixed}.")
    if report.missing:
        without = [title for name, title in report.titles.items() if name not in report.methods]
        methods = f" No result of: {'; '.join(without)}." if without else ""
        number = counted(len(report.missing), "cell")
        lines.append(f"Declared and not run: {number}; rows without a result are left out.{methods}")
    lines += [
        f"- {report.titles.get(name, name)} cannot be run here: {why}" for name, why in report.unavailable.items()
    ]
    return "\n".join(lines) + "\n"


def means_table(report: BenchmarkReport) -> str:
    """Returns a line for each method and split of objects; empty without results."""
    rows = []
    for name, objects in itertools.product(report.methods, report.splits):
        if not (entries := report.of(name, objects)):
            continue
        metrics = [entry.metrics for entry in entries]
        marks = _marks(entries)
        is_whole = len(entries) == len(report.categories)
        wasted = _known_mean(one.wasted_tries.value for one in metrics if one.wasted_tries and is_whole)
        repeated = _known_mean(one.repeated.rate for one in metrics if one.repeated and is_whole)
        paper = reported_mean(report.paper[name], report.categories) if objects == PAPER_OBJECTS else None
        cells = [
            f"{percent_text(report.mean(name, objects))} {marks}".strip(),
            percent_text(report.mean(name, objects, within)),
            "-" if wasted is None else f"{wasted:.2f}",
            "-" if repeated is None else f"{100 * repeated:.0f} %",
            report.trainings(name, objects),
            *(["-" if paper is None else f"{paper:.1f} %"] * report.beside_paper),
        ]
        rows.append([f"{report.titles[name]}, {objects}", *cells])
    titles = ["method, objects", "opened", "within", "wasted tries", "repeated", "trainings"]
    return markdown_table([*titles, *[_PAPER] * report.beside_paper], rows) if rows else ""


def _known_mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def category_table(report: BenchmarkReport) -> str:
    """Returns successes, and successes within the best strategy's tries, by category; empty without results.

    The paper's rows follow those of its methods.
    """
    rows, shown, categories = [], {""}, report.categories_with_results
    for name, objects in itertools.product(report.methods, report.splits):
        if not report.of(name, objects):
            continue
        is_beside_paper = objects == PAPER_OBJECTS
        papers = [reported(report.paper[name], category) if is_beside_paper else None for category in categories]
        entries = [report.entries.get((name, category, objects)) for category in categories]
        cells = [_cell(entry, paper) for entry, paper in zip(entries, papers, strict=True)]
        rows.append([f"{report.titles[name]}, {objects}", *cells])
        if any(papers) and report.paper[name] not in shown:
            shown.add(report.paper[name])
            values = ("-" if paper is None else "{:.0f}±{:.0f}".format(*paper) for paper in papers)
            rows.append([f"{report.paper[name]}, {_PAPER}", *values])
    return markdown_table(["method, objects", *map(words, categories)], rows) if rows else ""


def _cell(entry: Entry | None, paper: tuple[float, float] | None) -> str:
    """Returns two rates in percent with their marks; ``paper`` is the paper's mean and deviation [%]."""
    if entry is None or entry.metrics.success.rate is None:
        return "-"
    is_below = paper is not None and 100 * entry.metrics.success.rate < paper[0] - paper[1]
    both = [entry.metrics.success, entry.metrics.within_best_tries]
    numbers = [f"{100 * one.rate:.1f}".removesuffix(".0") for one in both if one and one.rate is not None]
    return " ".join(filter(None, ("/".join(numbers), BELOW_PAPER * is_below + entry.marks)))


def turns_table(report: BenchmarkReport) -> str:
    """Returns successes and their failed tries each time that a scene is played; empty if none is played again."""
    shown = {(name, objects): report.by_turn(name, objects) for name in report.methods for objects in report.splits}
    count = max(map(len, shown.values()), default=0)
    rows = [
        [f"{report.titles[name]}, {objects}", *(f"{percent_text(one.rate)}, {show(tries)}" for one, tries in turns)]
        for (name, objects), turns in shown.items()
        if turns
    ]
    titles = [f"time {number}: opened, failed tries of a success" for number in range(1, count + 1)]
    return markdown_table(["method, objects", *titles], rows) if rows else ""


def differences_table(report: BenchmarkReport) -> str:
    """Returns the differences of `BenchmarkReport.effects` over the categories in which both methods have results."""
    rows = []
    for effect, objects in itertools.product(report.effects, report.splits):
        methods = (effect.method, effect.without)
        chosen = [category for category in report.categories if category in (effect.categories or report.categories)]
        shared = [one for one in chosen if all((name, one, objects) in report.entries for name in methods)]
        gaps = [report.paired(methods, shared, objects, outcome) for outcome in (OPENED, WITHIN_TRIES)]
        if all(gaps):
            where = "all" if len(shared) == len(report.categories) else ", ".join(map(words, shared))
            marks = _marks(report.entries[name, one, objects] for name in methods for one in shared)
            opened, within_tries = (_difference(gap) for gap in gaps if gap)
            rows.append([effect.title, f"{where}, {objects}", f"{opened} {marks}".strip(), within_tries])
    return markdown_table(["difference", "categories, objects", "opened", "within"], rows) if rows else ""


def _difference(gap: PairedDifference) -> str:
    trainings = ", ".join(f"{100 * value:+z.0f}" for value in gap.by_training.values())
    each = f" ({trainings})" if len(gap.by_training) > 1 else ""
    # A limit of -0 is below zero: chance alone may explain the difference.
    return f"{100 * gap.difference:+z.0f} [{100 * gap.low:+.0f}, {100 * gap.high:+.0f}]{each}"


def budget_table(report: BenchmarkReport) -> str:
    """Returns data, steps, minutes and parameters of each trained method, and the change of its loss at the end."""
    rows = []
    for name in report.methods:
        if runs := [run for run in report.runs_of(name) if TRAIN in run.steps]:
            rows.append([report.titles[name], _data(runs), _steps(runs[0]), *_costs_of(runs)])
    titles = ["method", "learns from", "steps x batch", "minutes of a core", "parameters", "loss, last fifth"]
    return markdown_table(titles, rows) if rows else ""


def _data(runs: Sequence[CellRun]) -> str:
    """Returns the kind and mean number of demonstrations, and what else the trainings use."""
    collect, train = ([options for _, options in runs[0].options_of(kind)] for kind in (COLLECT, TRAIN))
    demonstrations, corrections = (
        sum(_recorded(options) for run in runs for _, options in run.options_of(kind)) / len(runs)
        for kind in (COLLECT, CORRECT)
    )
    parts = [f"{demonstrations:.0f} {collect[0]['--expert']} demonstrations"]
    parts += [f"{corrections:.0f} corrections"] if corrections else []
    parts += {f"images of {options['--image-size']} px" for options in collect if "--image-size" in options}
    is_pretrained = any(one.get("--policy.pretrained_backbone_weights", "null") != "null" for one in train)
    return ", ".join([*parts, *(["a pretrained backbone"] if is_pretrained else [])])


def _recorded(options: Mapping[str, str]) -> int:
    """Returns the number of episodes that a collection records."""
    objects = parse_object_selection(options["--category"], options["--objects"])
    return len(objects) * int(options["--episodes-per-object"])


def _steps(run: CellRun) -> str:
    """Returns the steps of the last training, after those of the trainings that it continues.

    Trainings that it does not continue are counted.
    """
    trainings = {run.steps[name].key: options for name, options in run.options_of(TRAIN)}
    chain = list(trainings.values())[-1:]
    while (start := Path(chain[0].get("--policy.path", "")).parts[1:2]) and start[0] in trainings:
        chain.insert(0, trainings[start[0]])
    steps, others = " + ".join(options["--steps"] for options in chain), len(trainings) - len(chain)
    after = f", after {counted(others, 'training')}" if others else ""
    return f"{steps}{after} x {chain[-1]['--batch_size']}"


def _costs_of(runs: Sequence[CellRun]) -> list[str]:
    """Returns minutes of a core, parameters, and the change of the loss, as texts."""
    names = [(run, name) for run in runs for kind in (CORRECT, TRAIN) for name, _ in run.options_of(kind)]
    costs = [run.costs[name] for run, name in names if name in run.costs]
    spent = sum(cost.seconds * cost.machine["cores"] / 60 for cost in costs) / len(runs)
    minutes = "at least " * any(cost.begun > 1 for cost in costs) + f"{spent:.0f}"  # only the last start is timed
    logs = last_trainings(runs)
    if not logs:
        return [minutes, "-", "-"]
    change = f"{100 * sum(log.change for log in logs) / len(logs):+.0f} %"
    change += f" ({len(logs)} of {len(runs)})" * (len(logs) < len(runs))
    return [minutes, f"{logs[0].parameters / 1e6:.1f} million", change]


def _costs(report: BenchmarkReport) -> str:
    costs: dict[str, dict[str, StepCost]] = {}  # a step that several cells share appears once
    for run in (result.run for result in report.results if result.run):
        for name, cost in run.costs.items():
            costs.setdefault(name.partition("_")[0], {})[run.steps[name].key] = cost
    seconds = {kind: sum(cost.seconds for cost in several.values()) for kind, several in costs.items()}
    paid = []
    for kind, several in costs.items():
        at_least = "at least " * any(cost.begun > 1 for cost in several.values())  # only the last start is timed
        paid.append(f"{WORDS[kind]} {at_least}{duration_text(seconds[kind])} ({counted(len(several), 'time')})")
    machines = sorted({machine_text(cost.machine) for several in costs.values() for cost in several.values()})
    commits = {one[:10] + " with changes" * changed for result in report.results for one, changed in result.commits}
    installed = joined_versions(result.all_versions for result in report.results)
    versions = {
        "seeds of scenes": {"{} to {}".format(*result.seeds) for result in report.results},
        "commit": commits,
        "data version": {str(result.run.data_version) for result in report.results if result.run},
        "version": {result.version for result in report.results},
        "installed": {f"{name} {version}" for name, version in installed.items()},
    }
    lines = [f"{', '.join(paid)}, on {'; '.join(machines)}"]
    lines += [f"{what}: {', '.join(sorted(values))}" for what, values in versions.items()]
    return "\n".join(f"- {line}" for line in lines)
