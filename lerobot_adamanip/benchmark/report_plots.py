"""Plots of a benchmark's report. Matplotlib is imported when a plot is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lerobot_adamanip.benchmark.budget import mean_losses
from lerobot_adamanip.benchmark.paper_rates import PAPER_OBJECTS, SUCCESS_BY_TRIALS, TRIALS_CATEGORY, reported
from lerobot_adamanip.benchmark.report import FEW_KEY_FRAMES, BenchmarkReport
from lerobot_adamanip.evaluation.plots import bar_places, draw_bars, heights_and_errors, new_figure, save_figure
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.text_format import words

_LEGEND_COLUMN_INCH = 3.4
"""Space for the longest title of a method."""
Lines = Mapping[str, tuple[Sequence[float], Sequence[float]]]
"""Name -> x and y of a line."""


def plot_report(report: BenchmarkReport, folder: Path) -> list[Path]:
    """Draws all plots that have data into a folder; returns their paths."""
    paths = [_plot_success(report, folder)] if report.categories_with_results else []
    paths += [_plot_trials(report, folder)] if report.curves else []
    tries = {row.title: report.opened_with(row.name, report.splits[0]) for row in report.rows_with_results}
    losses = {row.title: mean_losses(report, row.name) for row in report.rows_with_results}
    if any(tries.values()):
        lines: Lines = {name: (range(len(shares)), [100 * share for share in shares]) for name, shares in tries.items()}
        texts = {"xlabel": "failed tries at most", "ylabel": f"success [%], {report.splits[0]} objects"}
        title = f"Success within a number of failed tries, {report.scenes} scenes"
        paths.append(_plot_lines(lines, title, folder / "tries.png", marker="o", ylim=(0, 103), **texts))
    if any(losses.values()):
        lines = {name: (_percents(len(values)), values) for name, values in losses.items()}
        texts = {"xlabel": "share of the training [%]", "ylabel": "training loss / loss at the start"}
        title = "Training loss, geometric mean over categories"
        paths.append(_plot_lines(lines, title, folder / "losses.png", yscale="log", **texts))
    return paths


def _percents(parts: int) -> list[float]:
    """Returns the ends of equal parts of a whole [%]."""
    return [100 * (number + 1) / parts for number in range(parts)]


def _plot_lines(lines: Lines, title: str, path: Path, marker: str = "", **settings: Any) -> Path:
    """Draws a line for each name that has values; ``settings`` are those of matplotlib's ``Axes.set``."""
    figure = new_figure(6.5, 4.0)
    axes = figure.subplots()
    for name, (x, y) in lines.items():
        if y:
            axes.plot(x, y, marker=marker, label=name)
    axes.set(**settings)
    axes.legend(frameon=False, fontsize=7)
    save_figure(figure, title, path)
    return path


def _plot_success(report: BenchmarkReport, folder: Path) -> Path:
    """Draws success with intervals by method and category, one panel per split; dashes mark the paper's values."""
    rows, categories = report.rows_with_results, report.categories_with_results
    figure = new_figure(max(8.0, 3 + 0.16 * len(rows) * len(categories)), 3.4 * len(report.splits))
    panels: Any = figure.subplots(len(report.splits), 1, squeeze=False)[:, 0]
    for axes, objects in zip(panels, report.splits, strict=True):
        bars = {}
        for number, row in enumerate(rows):
            entries = [report.entry(row.name, category, objects) for category in categories]
            bars[row.title] = [rate(0, 0) if each is None else each.numbers.success for each in entries]
            places, width = bar_places(number, len(rows), len(categories))
            for x, category in zip(places, categories, strict=True):
                paper = reported(row.paper, category) if objects == PAPER_OBJECTS else None
                if paper is not None:
                    axes.plot([x - width / 2, x + width / 2], [paper[0]] * 2, "--", color="black", linewidth=1.0)
        draw_bars(axes, [words(category) for category in categories], bars)
        axes.set_ylabel(f"success [%], {objects} objects")
    handles, labels = panels[0].get_legend_handles_labels()
    columns = max(1, int(figure.get_figwidth() / _LEGEND_COLUMN_INCH))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    path = folder / "success.png"
    dashes = "; dashes: in the paper" if report.beside_paper else ""
    save_figure(figure, f"Success with 95 % Wilson intervals{dashes}", path)
    return path


def _plot_trials(report: BenchmarkReport, folder: Path) -> Path:
    """Draws success over failed trials in the demonstrations, with the paper's curve and within a key frame budget."""
    figure = new_figure(6.5, 4.0)
    axes = figure.subplots()
    for method, category, objects in report.curves:
        found = [(k, report.entry(method, category, objects, k)) for k in report.trials]
        points = [(k, each.numbers) for k, each in found if each is not None]
        trials = [k for k, _ in points]
        heights, errors = heights_and_errors([numbers.success for _, numbers in points])
        label = f"{words(category)}, {objects} objects"
        drawn = axes.errorbar(trials, heights, errors, marker="o", capsize=3, label=label)
        within = [100 * (numbers.opened_within(FEW_KEY_FRAMES).rate or 0.0) for _, numbers in points]
        label += f", within {FEW_KEY_FRAMES} key frames"
        axes.plot(trials, within, ":", marker=".", color=drawn[0].get_color(), label=label)
    if report.beside_paper:
        label = f"{TRIALS_CATEGORY}, the paper"
        axes.plot(range(len(SUCCESS_BY_TRIALS)), SUCCESS_BY_TRIALS, "--", color="black", label=label)
    axes.set(xlabel="failed trials in the demonstrations", ylabel="success [%]", ylim=(0, 103))
    axes.legend(frameon=False, fontsize=8)
    path = folder / "trials.png"
    save_figure(figure, "Success with 95 % Wilson intervals", path)
    return path
