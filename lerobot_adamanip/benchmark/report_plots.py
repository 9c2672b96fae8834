"""A benchmark's report as pictures. Matplotlib is imported when one is drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.benchmark.paper_rates import PAPER_OBJECTS, SUCCESS_BY_TRIALS, TRIALS_CATEGORY, reported
from lerobot_adamanip.benchmark.report import BUDGETS, BenchmarkReport, Row
from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.evaluation.metrics import pool
from lerobot_adamanip.evaluation.plots import heights_and_errors, new_figure, save_figure
from lerobot_adamanip.evaluation.rates import Rate
from lerobot_adamanip.evaluation.text_format import words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLUMNS = 3
_LEGEND_COLUMN_INCH = 3.4
"""Room for the longest title of a method."""
_FEW = BUDGETS[2]


def plot_report(report: BenchmarkReport, folder: Path) -> list[Path]:
    """Draws what there is to draw into a folder; returns the pictures."""
    if not report.results:
        return []
    table = (_plot_success, _plot_key_frames, _plot_wasted) if report.categories_with_results else ()
    trials = (_plot_trials,) if any(place[1] is not None for place in report.entries) else ()
    drawn = [*table, *trials]
    return [plot(report, folder) for plot in drawn]


def _plot_success(report: BenchmarkReport, folder: Path) -> Path:
    """Bars with intervals by method and category, a panel for each split of objects, the paper's values as lines."""
    figure = new_figure(_bars_width(report), 3.4 * len(report.splits))
    panels: Any = figure.subplots(len(report.splits), 1, squeeze=False)[:, 0]
    for axes, objects in zip(panels, report.splits, strict=True):
        for number, row in enumerate(report.rows_with_results):
            found = [report.numbers(row.name, (category,), (objects,)) for category in report.categories_with_results]
            places, width = _places(report, number)
            _draw_success(
                axes, [(x, each[0].success) for x, each in zip(places, found, strict=True) if each], width, number
            )
            _mark_missing(axes, [x for x, each in zip(places, found, strict=True) if not each])
            for x, category in zip(places, report.categories_with_results, strict=True):
                paper = reported(row.paper, category) if objects == PAPER_OBJECTS else None
                if paper is not None:
                    axes.plot([x - width / 2, x + width / 2], [paper[0]] * 2, "--", color="black", linewidth=1.0)
        _name_categories(axes, report)
        axes.set(ylabel=f"success [%], {objects} objects", ylim=(0, 103))
    _legend_of_all(figure, report.rows_with_results)
    path = folder / "success.png"
    dashes = "; dashes: in the paper" if report.beside_paper else ""
    save_figure(figure, f"Success with 95 % Wilson intervals{dashes}", path)
    return path


def _draw_success(axes: Axes, bars: Sequence[tuple[float, Rate]], width: float, number: int) -> None:
    places, (heights, errors) = [x for x, _ in bars], heights_and_errors([success for _, success in bars])
    axes.bar(places, heights, 0.92 * width, color=f"C{number}")
    axes.errorbar(places, heights, errors, fmt="none", capsize=1.5, ecolor="0.25", linewidth=0.8)


def _mark_missing(axes: Axes, places: Sequence[float]) -> None:
    """Says where there is no number: a bar of no height would look like one."""
    for x in places:
        axes.text(x, 0, "no number", rotation=90, fontsize=6, color="0.5", ha="center", va="bottom")


def _bars_width(report: BenchmarkReport) -> float:
    """Width of a figure [inch] with a bar for each method and category."""
    return max(8.0, 3 + 0.16 * len(report.rows_with_results) * len(report.categories_with_results))


def _places(report: BenchmarkReport, number: int) -> tuple[list[float], float]:
    """Returns where the bars of a method stand, one for each category, and how much room each has."""
    width = 0.85 / len(report.rows_with_results)
    shift = (number - (len(report.rows_with_results) - 1) / 2) * width
    return [x + shift for x in range(len(report.categories_with_results))], width


def _plot_key_frames(report: BenchmarkReport, folder: Path) -> Path:
    """Share opened within a number of key frames, a panel for each category, all splits of objects together."""
    rows = math.ceil(len(report.categories_with_results) / _COLUMNS)
    figure = new_figure(11.0, 2.9 * rows)
    panels: Any = list(figure.subplots(rows, _COLUMNS, squeeze=False, sharey=True).flat)
    for axes, category in zip(panels, report.categories_with_results, strict=False):
        for number, row in enumerate(report.rows_with_results):
            if found := report.numbers(row.name, (category,), report.splits):
                numbers = pool(found)
                shares = [100 * (numbers.opened_within(k).rate or 0.0) for k in range(MAX_KEY_FRAMES + 1)]
                axes.plot(range(MAX_KEY_FRAMES + 1), shares, label=row.title, color=f"C{number}", linewidth=1.5)
        axes.set_title(words(category), fontsize=9)
        axes.set(ylim=(0, 103), xlabel="key frames spent", ylabel="opened [%]")
    for axes in panels[len(report.categories_with_results) :]:
        axes.set_visible(False)
    _legend_of_all(figure, report.rows_with_results)
    path = folder / "key_frames.png"
    save_figure(figure, "Success against key frames spent", path)
    return path


def _legend_of_all(figure: Any, rows: Sequence[Row]) -> None:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=f"C{number}", label=row.title) for number, row in enumerate(rows)]
    columns = max(1, int(figure.get_figwidth() / _LEGEND_COLUMN_INCH))
    figure.legend(handles=lines, loc="outside lower center", ncols=columns, fontsize=8, frameon=False)


def _plot_wasted(report: BenchmarkReport, folder: Path) -> Path:
    """Bars of failed tries per success beyond the best possible, by method and category."""
    figure = new_figure(_bars_width(report), 3.6)
    axes = figure.subplots()
    for number, row in enumerate(report.rows_with_results):
        places, width = _places(report, number)
        found = [report.numbers(row.name, (category,), report.splits) for category in report.categories_with_results]
        tries = [pool(each).wasted_tries if each else None for each in found]
        wasted = [None if each is None else each.value for each in tries]
        bars = [(x, each) for x, each in zip(places, wasted, strict=True) if each is not None]
        axes.bar([x for x, _ in bars], [height for _, height in bars], 0.92 * width, color=f"C{number}")
        _mark_missing(axes, [x for x, each in zip(places, wasted, strict=True) if each is None])
    axes.axhline(0, color="0.3", linewidth=0.8)
    _name_categories(axes, report)
    axes.set(ylabel="wasted tries per success")
    _legend_of_all(figure, report.rows_with_results)
    path = folder / "wasted_tries.png"
    save_figure(figure, "Failed tries per success beyond the best possible", path)
    return path


def _plot_trials(report: BenchmarkReport, folder: Path) -> Path:
    """Success against failed trials in the demonstrations, with intervals, beside the paper's, and within a budget."""
    figure = new_figure(6.5, 4.0)
    axes = figure.subplots()
    curves = sorted({(place[0], place[2], place[3]) for place in report.entries if place[1] is not None})
    for method, category, objects in curves:
        found = [(k, report.entry(method, category, objects, k)) for k in report.trials]
        points = [(k, each.numbers.success) for k, each in found if each is not None]
        heights, errors = heights_and_errors([success for _, success in points])
        label = f"{words(category)}, {objects} objects"
        trials = [k for k, _ in points]
        drawn = axes.errorbar(trials, heights, errors, marker="o", capsize=3, label=label)
        within = [100 * (each.numbers.opened_within(_FEW).rate or 0.0) for _, each in found if each is not None]
        style = {"marker": ".", "color": drawn[0].get_color(), "label": f"{label}, within {_FEW} key frames"}
        axes.plot(trials, within, ":", **style)
    if report.beside_paper:
        label = f"{TRIALS_CATEGORY}, the paper"
        axes.plot(range(len(SUCCESS_BY_TRIALS)), SUCCESS_BY_TRIALS, "--", color="black", label=label)
    axes.set(xlabel="failed trials in the demonstrations", ylabel="success [%]", ylim=(0, 103))
    axes.legend(frameon=False, fontsize=8)
    path = folder / "trials.png"
    save_figure(figure, "Success with 95 % Wilson intervals", path)
    return path


def _name_categories(axes: Axes, report: BenchmarkReport) -> None:
    names = [words(category) for category in report.categories_with_results]
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.5, len(names) - 0.5)  # where there is no bar, labels alone do not widen the axis
