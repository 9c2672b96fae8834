"""Plots of evaluations. Matplotlib is imported when a plot is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.evaluation.rates import Rate, rate
from lerobot_adamanip.evaluation.record import EpisodeRecord, without_repeats
from lerobot_adamanip.evaluation.report import compare

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_BARS = 24
"""Maximum number of groups in a plot."""
_CHARACTERS_FLAT = 60
"""Total length of group labels [characters] above which they are rotated."""


def cumulative_rates(records: Sequence[EpisodeRecord]) -> list[Rate]:
    """Returns success rates after 1, 2, ... unique episodes, in order of seeds."""
    kept = sorted(without_repeats(records), key=lambda record: (record.seed, record.object_id))
    successes, rates = 0, []
    for number, record in enumerate(kept, start=1):
        successes += record.success
        rates.append(rate(successes, number))
    return rates


def plot_evaluations(evaluations: Mapping[str, Sequence[EpisodeRecord]], path: Path) -> None:
    """Plots success by group and over episodes to ``path``, with 95 % intervals and one colour per label."""
    from matplotlib.ticker import MaxNLocator

    comparison = compare(evaluations)
    groups = comparison.groups
    for by in ("category and objects", "hidden"):  # a suite has too many of them
        if len(groups) > MAX_BARS:
            groups = [group for group in groups if group.by != by]
    width = max(10.5, 5 + 0.32 * len(groups) * max(2, len(evaluations)))
    figure = new_figure(width, 4.6)
    bars, curve = figure.subplots(1, 2, width_ratios=(width - 4.8, 4.8))
    rates = {label: [part.success(group) for group in groups] for label, part in comparison.summaries.items()}
    draw_bars(bars, [group.label for group in groups], rates)
    bars.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, borderaxespad=0.2)
    for label, records in evaluations.items():
        so_far = cumulative_rates(records)
        counts = range(1, len(so_far) + 1)
        (line,) = curve.plot(
            counts, [100 * (one.rate or 0.0) for one in so_far], label=plain_text(label), linewidth=1.8
        )
        low, high = [100 * one.low for one in so_far], [100 * one.high for one in so_far]
        curve.fill_between(counts, low, high, alpha=0.15, color=line.get_color(), linewidth=0)
    curve.set(xlabel="episodes", ylabel="success so far [%]", ylim=(0, 103))
    curve.xaxis.set_major_locator(MaxNLocator(integer=True))
    save_figure(figure, comparison.title, path)


def plain_text(text: str) -> str:
    """Returns text that Matplotlib draws as it is: no formula between ``$``, and a legend shows its leading ``_``."""
    escaped = text.replace("$", r"\$")
    return f" {escaped}" if text[:1] in ("", "_") else escaped


def new_figure(width: float, height: float) -> Figure:
    """Returns a figure of this size [inch] that needs no display and leaves pyplot's global state alone."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, title: str, path: Path) -> None:
    """Applies the common style to a figure and writes it to ``path``; creates the folder if needed."""
    for axes in figure.axes:
        axes.grid(axis="y", alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(plain_text(title), fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def bar_places(number: int, bars: int, groups: int) -> tuple[list[float], float]:
    """Returns the positions of bar ``number`` of ``bars`` in each group, and the bar width."""
    width = 0.85 / bars
    return [group + (number - (bars - 1) / 2) * width for group in range(groups)], width


def draw_bars(axes: Axes, names: Sequence[str], bars: Mapping[str, Sequence[Rate]]) -> None:
    """Draws success with intervals as grouped bars.

    Args:
        axes: axes to draw on.
        names: group names.
        bars: label -> success in each group. A rate without episodes is marked, to differ from zero success.
    """
    for number, (label, rates) in enumerate(bars.items()):
        places, width = bar_places(number, len(bars), len(names))
        heights = [100 * (one.rate or 0.0) for one in rates]
        bounds = [(100 * one.low, 100 * one.high) if one.episodes else (0.0, 0.0) for one in rates]
        below = [height - low for height, (low, _) in zip(heights, bounds, strict=True)]
        above = [high - height for height, (_, high) in zip(heights, bounds, strict=True)]
        axes.bar(
            places, heights, 0.92 * width, yerr=[below, above], capsize=1.5, label=plain_text(label), ecolor="0.25"
        )
        for x, one in zip(places, rates, strict=True):
            if not one.episodes:
                axes.text(x, 0, "no number", rotation=90, fontsize=6, color="0.5", ha="center", va="bottom")
    is_turned = sum(map(len, names)) > _CHARACTERS_FLAT
    axes.set_xticks(range(len(names)), names, rotation=35 if is_turned else 0, ha="right" if is_turned else "center")
    axes.tick_params(axis="x", labelsize=8)
    axes.set(ylabel="success [%]", xlim=(-0.5, len(names) - 0.5), ylim=(0, 103))
