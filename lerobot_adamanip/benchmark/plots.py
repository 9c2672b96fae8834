"""Plots of a benchmark's report. Matplotlib is imported when a plot is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lerobot_adamanip.benchmark.paper_rates import PAPER_OBJECTS, reported
from lerobot_adamanip.benchmark.report import BenchmarkReport
from lerobot_adamanip.evaluation.plots import bar_places, draw_bars, new_figure, plain_text, save_figure
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.text_format import words

_LEGEND_COLUMN_INCH = 3.4
"""Space for the longest title of a method."""


def plot_report(report: BenchmarkReport, folder: Path) -> list[Path]:
    """Draws all plots that have data into a folder; returns their paths."""
    paths = [_plot_success(report, folder)] if report.entries else []
    lines = {name: report.opened_with(name, report.splits[0]) for name in report.methods}
    if any(lines.values()):
        lines = {report.titles[name]: [100 * share for share in shares] for name, shares in lines.items()}
        title = f"Success within a number of failed tries, {report.scenes} scenes"
        axes = {
            "xlabel": "failed tries at most",
            "ylabel": f"success [%], {report.splits[0]} objects",
            "ylim": (0, 103),
        }
        paths.append(_plot_lines(lines, range(20), title, folder / "tries.png", marker="o", **axes))
    losses = {report.titles[name]: report.mean_losses(name) for name in report.methods}
    if any(losses.values()):
        parts = max(map(len, losses.values()))
        ends = [100 * (number + 1) / parts for number in range(parts)]
        title = "Training loss, geometric mean over categories"
        axes = {"xlabel": "share of the training [%]", "ylabel": "training loss / loss at the start", "yscale": "log"}
        paths.append(_plot_lines(losses, ends, title, folder / "losses.png", marker="", **axes))
    return paths


def _plot_lines(
    lines: Mapping[str, Sequence[float]], x: Sequence[float], title: str, path: Path, *, marker: str, **settings: Any
) -> Path:
    figure = new_figure(8.0, 4.5)
    axes = figure.subplots()
    axes.set_prop_cycle(color=_colors(len(lines)))
    for name, y in lines.items():
        if y:
            axes.plot(x[: len(y)], y, marker=marker, label=plain_text(name))
    axes.set(**settings)
    figure.legend(loc="outside lower center", ncols=2, fontsize=6, frameon=False)
    save_figure(figure, title, path)
    return path


def _colors(count: int) -> Sequence[Any]:
    """Returns ``count`` different colours."""
    from matplotlib import colormaps

    if count > 20:
        return [colormaps["turbo"](number / (count - 1)) for number in range(count)]
    colors: Sequence[Any] = colormaps["tab10" if count <= 10 else "tab20"].colors  # type: ignore[attr-defined]
    return colors[:count]


def _plot_success(report: BenchmarkReport, folder: Path) -> Path:
    """Draws a bar with its interval for each method and category, one panel per split with the methods that it has.

    Beside the paper's numbers, which dashes mark, bars show success; else success within the best strategy's tries.
    """
    methods, categories = report.methods, report.categories_with_results
    measure, title = ("success", "Success") if report.beside_paper else ("within_best_tries", "Opened within the tries")
    colors, labels = dict(zip(methods, _colors(len(methods)), strict=True)), dict[str, Any]()
    figure = new_figure(max(8.0, 3 + 0.16 * len(methods) * len(categories)), 3.4 * len(report.splits))
    panels: Any = figure.subplots(len(report.splits), 1, squeeze=False)[:, 0]
    for axes, objects in zip(panels, report.splits, strict=True):
        here = [name for name in methods if any((name, each, objects) in report.entries for each in categories)]
        axes.set_prop_cycle(color=[colors[name] for name in here])
        bars = {}
        for number, name in enumerate(here):
            entries = [report.entries.get((name, category, objects)) for category in categories]
            rates = [None if entry is None else getattr(entry.metrics, measure) for entry in entries]
            bars[report.titles[name]] = [rate(0, 0) if each is None else each for each in rates]
            places, width = bar_places(number, len(here), len(categories))
            for x, category in zip(places, categories, strict=True):
                paper = reported(report.paper[name], category) if objects == PAPER_OBJECTS else None
                if paper is not None:
                    axes.plot([x - width / 2, x + width / 2], [paper[0]] * 2, "--", color="black", linewidth=1.0)
        draw_bars(axes, [words(category) for category in categories], bars)
        axes.set_ylabel(f"{objects} objects [%]")
        labels |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    columns = max(1, int(figure.get_figwidth() / _LEGEND_COLUMN_INCH))
    handles = list(labels.values())
    figure.legend(handles, list(labels), loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    path = folder / "success.png"
    dashes = "; dashes: in the paper" if report.beside_paper else ""
    save_figure(figure, f"{title} with 95 % Wilson intervals{dashes}", path)
    return path
