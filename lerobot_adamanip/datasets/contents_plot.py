"""A picture of what is in a dataset. Matplotlib is imported when one is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.datasets.contents import Contents
from lerobot_adamanip.evaluation.plots import MAX_BARS, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_contents(found: Contents, path: Path) -> None:
    """Draws episodes by length, by failed tries, and by what they have in common, to ``path``."""
    from matplotlib.ticker import MaxNLocator

    groups = {group.label: each.episodes for group, each in list(found.groups.items())[1 : MAX_BARS + 1]}
    figure = new_figure(7.5 + 0.45 * max(6, len(groups)), 4.2)
    lengths, failures, bars = figure.subplots(1, 3, width_ratios=(3.6, 2.4, 0.45 * max(6, len(groups)) + 1.5))
    _draw(lengths, found.lengths, "key frames of an episode")
    _draw(failures, found.failures, "failed tries of an episode")
    lengths.set_ylabel("episodes")
    bars.bar(range(len(groups)), list(groups.values()), 0.8)
    bars.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    bars.set_xticks(range(len(groups)), list(groups), rotation=35, ha="right", fontsize=8)
    everything = found.overall
    save_figure(figure, f"{Path(found.root).name}: {everything.episodes} episodes of {found.objects} objects", path)


def _draw(axes: Axes, counts: Mapping[int, int], what: str) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.bar(list(counts), list(counts.values()), 0.9)
    axes.set_xlabel(what)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
