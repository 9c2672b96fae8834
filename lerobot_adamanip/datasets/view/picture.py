"""Picture of an episode: the scene with the tool's path, goals and tries; below it phases and effort."""

from __future__ import annotations

import io
import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.datasets.view.episode import ViewedEpisode
from lerobot_adamanip.evaluation.plots import new_figure
from lerobot_adamanip.util import files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE, DPI = (11.0, 7.8), 100
"""Size of the picture [inch] and resolution [px per inch]."""
MARGIN = 0.15
"""Margin around the tool's path [m]."""
FAILED, WORKED, PATH, STALLED = "#c62828", "#2e7d32", "#1f4e9c", "#e07b00"
_PHASES = {
    Phase.APPROACH: "#d7dde5", Phase.GRASP: "#aebccd", Phase.TRY: "#f2c14e", Phase.RELEASE: "#e3e3e3",
    Phase.UNLOCK: "#8fb8de", Phase.OPEN: "#8fcf9f",
}  # fmt: skip


def write_picture(episode: ViewedEpisode, path: Path) -> None:
    """Draws an episode to a PNG file."""
    content = io.BytesIO()
    draw(episode).savefig(content, format="png", dpi=DPI, pil_kwargs={"optimize": True}, metadata={"Software": ""})
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_atomically(path, content.getvalue())


def draw(episode: ViewedEpisode) -> Figure:
    """Returns the picture of an episode; its two axes are the scene and the timeline."""
    figure = new_figure(*SIZE)
    grid = figure.add_gridspec(2, 1, height_ratios=(2.6, 1.0))
    _draw_scene(figure.add_subplot(grid[0], projection="3d"), episode)
    _draw_timeline(figure.add_subplot(grid[1]), episode)
    figure.suptitle(episode.title, fontsize=11, parse_math=False)
    return figure


def _draw_scene(axes: Any, episode: ViewedEpisode) -> None:
    """Draws the first cloud, seen over the robot's shoulder. A try is drawn where the tool was at its end."""
    path, goals = episode.tools[:, :3], episode.goals[:, :3]
    around = np.concatenate([path, goals])
    low, high = around.min(axis=0) - MARGIN, around.max(axis=0) + MARGIN
    cloud = episode.clouds[0]
    cloud = cloud[((cloud >= low) & (cloud <= high)).all(axis=1)]
    axes.scatter(*cloud.T, c=cloud[:, 2], s=12, cmap="viridis", alpha=0.8, linewidths=0, gid="cloud")
    axes.plot(*path.T, color=PATH, linewidth=1.6, gid="path", label="tool")
    axes.scatter(*goals.T, s=26, facecolors="white", edgecolors="#444444", gid="goals", label="goal")
    for failed, marker, color, name in ((True, "X", FAILED, "failed try"), (False, "o", WORKED, "try that worked")):
        tries = [each for each in episode.tries if each.failed is failed]
        places = path[[each.key_frame + 1 for each in tries]]
        axes.scatter(*places.T, s=70, marker=marker, color=color, depthshade=False, gid=name, label=name)
        for each, place in zip(tries, places, strict=True):
            if failed or each.recovers:
                x, y, z = place
                beside = z + 0.02 if failed else z - 0.035
                axes.text(x, y, beside, str(each.key_frame), color=color, fontweight="bold", ha="center", gid="numbers")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_box_aspect(high - low, zoom=1.3)
    axes.view_init(elev=20, azim=-160)
    axes.locator_params(nbins=4)
    axes.legend(loc="upper left", fontsize=8, frameon=False)


def _draw_timeline(axes: Axes, episode: ViewedEpisode) -> None:
    """Draws phases, motions that missed their goal, tries and external joint torques, by key frame."""
    from matplotlib.ticker import MaxNLocator

    for joint, torque in enumerate(episode.effort.T):
        axes.plot(np.arange(len(torque)), torque, linewidth=1.2, label=f"joint {joint + 1}", gid="effort")
    top = axes.get_xaxis_transform()
    first = 0
    for phase, run in itertools.groupby(episode.phases):
        end = first + len(list(run))
        color, name = ("white", "not labelled") if phase is None else (_PHASES[phase], phase.name.lower())
        axes.axvspan(first, end, color=color, alpha=0.5, linewidth=0, gid="phases")
        axes.text((first + end) / 2, 1.02, name, transform=top, fontsize=7, rotation=30, gid="phase")
        first = end
    for each in episode.tries:
        told = f"{each.joint}\n{each.progress:+.2f}" + ("\nrecovers" if each.recovers else "")
        color = FAILED if each.failed else WORKED
        axes.text(each.key_frame + 0.5, 0.03, told, transform=top, color=color, fontsize=7, ha="center", gid="tries")
    for number, outcome in enumerate(episode.outcomes):
        if outcome:  # neither reached nor unknown
            name = outcome.name.lower()
            axes.text(number + 0.3, 0.9, name, transform=top, color=STALLED, fontsize=7, gid=name)
    if episode.effort.size:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlim=(0, episode.key_frames), xlabel="key frame", ylabel="torque [N m]")
    axes.spines[["top", "right"]].set_visible(False)
