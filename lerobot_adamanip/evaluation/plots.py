"""Plots of evaluations. Matplotlib is imported when a plot is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.evaluation.groups import Group, without_repeats
from lerobot_adamanip.evaluation.rates import Rate, rate
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.report import compare

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_BARS = 24
"""Maximum number of groups in a plot."""
_LABEL_PERCENT = 16
"""Height of a count label [% of the axis]."""
_CHARACTERS_FLAT = 60
"""Total length of group labels [characters] above which they are rotated."""


def cumulative_rates(records: Sequence[EpisodeRecord]) -> list[Rate]:
    """Returns success rates after 1, 2, ... unique episodes, in order of seeds."""
    kept = sorted(without_repeats(records), key=lambda record: (record.seed, record.object_id))
    done, rates = 0, []
    for number, record in enumerate(kept, start=1):
        done += record.success
        rates.append(rate(done, number))
    return rates


def plot_evaluations(evaluations: Mapping[str, Sequence[EpisodeRecord]], path: Path) -> None:
    """Plots success by group and over episodes to ``path``, with 95 % intervals and one colour per label."""
    from matplotlib.ticker import MaxNLocator

    comparison = compare(evaluations)
    groups = _drawn(comparison.groups)
    width = max(10.5, 5 + 0.32 * len(groups) * max(2, len(evaluations)))
    figure = new_figure(width, 4.6)
    bars, curve = figure.subplots(1, 2, width_ratios=(width - 4.8, 4.8))
    rates = {label: [each.success(group) for group in groups] for label, each in comparison.summaries.items()}
    draw_bars(bars, [group.label for group in groups], rates, counts=True)
    bars.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, borderaxespad=0.2)
    for label, records in evaluations.items():
        so_far = cumulative_rates(records)
        counts = range(1, len(so_far) + 1)
        (line,) = curve.plot(counts, [100 * (r.rate or 0.0) for r in so_far], label=label, linewidth=1.8)
        low, high = [100 * r.low for r in so_far], [100 * r.high for r in so_far]
        curve.fill_between(counts, low, high, alpha=0.15, color=line.get_color(), linewidth=0)
    curve.set(xlabel="episodes", ylabel="success so far [%]", ylim=(0, 103))
    curve.xaxis.set_major_locator(MaxNLocator(integer=True))
    save_figure(figure, comparison.title, path)


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
    figure.suptitle(title, fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def heights_and_errors(rates: Sequence[Rate]) -> tuple[list[float], list[list[float]]]:
    """Returns rates [%] and the interval lengths below and above them, in matplotlib's form.

    A rate without episodes gets no bar and no interval.
    """
    heights = [100 * (each.rate or 0.0) for each in rates]
    below = [height - 100 * each.low if each.episodes else 0.0 for height, each in zip(heights, rates, strict=True)]
    above = [100 * each.high - height if each.episodes else 0.0 for height, each in zip(heights, rates, strict=True)]
    return heights, [below, above]


def _drawn(groups: Sequence[Group]) -> list[Group]:
    """Returns the groups that fit; for a suite, drops splits by category or hidden values first."""
    chosen = list(groups)
    for dull in ("category and objects", "hidden"):
        if len(chosen) > MAX_BARS:
            chosen = [group for group in chosen if group.by != dull]
    return chosen


def bar_places(number: int, bars: int, groups: int) -> tuple[list[float], float]:
    """Returns the positions of bar ``number`` of ``bars`` in each group, and the bar width."""
    width = 0.85 / bars
    return [group + (number - (bars - 1) / 2) * width for group in range(groups)], width


def draw_bars(axes: Axes, names: Sequence[str], bars: Mapping[str, Sequence[Rate]], *, counts: bool = False) -> None:
    """Draws success with intervals as grouped bars.

    Args:
        axes: axes to draw on.
        names: group names.
        bars: label -> success in each group. A rate without episodes is marked, to differ from zero success.
        counts: whether to write successes and episodes on each bar.
    """
    for number, (label, rates) in enumerate(bars.items()):
        places, width = bar_places(number, len(bars), len(names))
        values, errors = heights_and_errors(rates)
        axes.bar(places, values, 0.92 * width, yerr=errors, capsize=3 if counts else 1.5, label=label, ecolor="0.25")
        for x, success in zip(places, rates, strict=True):
            if not success.episodes:
                axes.text(x, 0, "no number", rotation=90, fontsize=6, color="0.5", ha="center", va="bottom")
            elif counts:
                _label_bar(axes, x, success, width)
    turned = sum(map(len, names)) > _CHARACTERS_FLAT and counts
    axes.set_xticks(range(len(names)), names, rotation=35 if turned else 0, ha="right" if turned else "center")
    axes.tick_params(axis="x", labelsize=8)
    axes.set(ylabel="success [%]", xlim=(-0.5, len(names) - 0.5), ylim=(0, 103))


def _label_bar(axes: Axes, x: float, success: Rate, width: float) -> None:
    """Writes the counts of a bar where the interval line does not cross them: inside, above or beside."""
    low, high = 100 * success.low, 100 * success.high
    place = (
        (x, 1.5) if low > _LABEL_PERCENT else (x, high + 1.5) if high < 100 - _LABEL_PERCENT else (x + width / 4, 1.5)
    )
    inside = place[1] == 1.5 and 100 * (success.rate or 0.0) > _LABEL_PERCENT
    text, color = f"{success.count}/{success.episodes}", "white" if inside else "black"
    axes.text(*place, text, ha="center", va="bottom", fontsize=7, color=color, rotation=90)
