"""Tables of paired differences in a report, and the names of its methods."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

from lerobot_adamanip.benchmark.declaration import Effect
from lerobot_adamanip.benchmark.report import BenchmarkReport, Row
from lerobot_adamanip.evaluation.metrics import METRICS
from lerobot_adamanip.evaluation.paired import OPENED, WITHIN_TRIES, PairedDifference
from lerobot_adamanip.evaluation.text_format import markdown_table, words

_GAPS = ("opened", "by training", METRICS["within_best_tries"].title, "by training")
_PAIRED_LEGEND = (
    "in points: mean over scenes and trainings, with a 95 % interval over scenes. The interval excludes the spread "
    "between trainings, which share their demonstrations; the next column shows each training's difference. Intervals "
    "are not corrected for the number of comparisons; two added scenes keep them from collapsing where methods agree. "
    "A training in which one of the two lacks a category, or has other scenes, is left out."
)


def paired_table(report: BenchmarkReport) -> str:
    """Returns a table of the paired differences to the reference; empty without outcomes of scenes."""
    others = [row for row in report.rows_with_results if row.name != report.reference]
    changes = [Effect(title=method_name(row), method=report.reference, without=row.name) for row in others]
    return _table(report, "method", changes, f"{title_of(report, report.reference)} less each method")


def effects_table(report: BenchmarkReport) -> str:
    """Returns a table of the declared effects; empty without outcomes of scenes."""
    return _table(report, "what differs", report.effects, "With it less without it")


def _table(report: BenchmarkReport, first: str, effects: Iterable[Effect], explanation: str) -> str:
    """Returns a table of paired differences, over the categories in which both methods have results."""
    rows = []
    for effect, objects in itertools.product(effects, report.splits):
        both = (effect.method, effect.without)
        chosen = [each for each in report.categories if each in (effect.categories or report.categories)]
        shared = [each for each in chosen if all(report.entry(name, each, objects) for name in both)]
        if cells := _gaps(report, both, shared, objects):
            where = "all" if len(shared) == len(report.categories) else ", ".join(map(words, shared))
            rows.append([effect.title, f"{where}, {objects}", *cells])
    table = markdown_table([first, "categories, objects", *_GAPS], rows)
    return f"{table}\n\n{explanation} in the same scenes, {_PAIRED_LEGEND}" if rows else ""


def _gaps(report: BenchmarkReport, methods: tuple[str, str], categories: Sequence[str], objects: str) -> list[str]:
    """Returns the cells of `_GAPS`; none without results of both methods."""
    gaps = [report.paired(methods, categories, objects, outcome) for outcome in (OPENED, WITHIN_TRIES)]
    return [text for gap in gaps if gap is not None for text in (_difference(gap), _by_training(gap))]


def _by_training(gap: PairedDifference) -> str:
    return ", ".join(f"{100 * each:+z.0f}" for each in gap.by_training.values())


def _difference(gap: PairedDifference) -> str:
    return f"{100 * gap.difference:+z.0f} [{100 * gap.low:+z.0f}, {100 * gap.high:+z.0f}]"


def method_name(row: Row) -> str:
    """Returns a method's title, with the package that declares it."""
    return f"{row.title} ({row.package})" if row.package else row.title


def title_of(report: BenchmarkReport, method: str) -> str:
    """Returns the title of a method by name."""
    return next((row.title for row in report.rows if row.name == method), method)
