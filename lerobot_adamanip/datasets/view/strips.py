"""Strips that tell what happened in an episode, key frame by key frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.datasets.view.episode import ViewedEpisode

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAILED, WORKED, _STALLED = "#c62828", "#2e7d32", "#e07b00"
_PHASES = {
    Phase.APPROACH: "#d7dde5", Phase.GRASP: "#aebccd", Phase.TRY: "#f2c14e", Phase.RELEASE: "#e3e3e3",
    Phase.UNLOCK: "#8fb8de", Phase.OPEN: "#8fcf9f",
}  # fmt: skip


def draw_phases(axes: Axes, episode: ViewedEpisode) -> None:
    """Draws what the expert was doing, and where the arm did not get where it was sent."""
    for phase, first, end in episode.phase_runs():
        if phase is None:
            axes.text((first + end) / 2, 0.5, "not labelled", ha="center", va="center", fontsize=8, gid="phase")
            continue
        axes.axvspan(first, end, color=_PHASES[phase], linewidth=0, gid="phases")
        name = phase.name.lower()
        if end - first >= 0.055 * len(name) * episode.key_frames / 10:
            axes.text((first + end) / 2, 0.5, name, ha="center", va="center", fontsize=8, gid="phase")
    for number, outcome in enumerate(episode.outcomes):
        axes.axvline(number, color="white", linewidth=0.8)
        if outcome:  # neither reached nor unknown
            axes.plot([number + 0.5], [0.1], marker="v", color=_STALLED, markersize=5, gid=outcome.name.lower())
    missed = dict.fromkeys(outcome.name.lower() for outcome in episode.outcomes if outcome)
    if missed:
        told = "\u25bc " + ",\n".join(missed)
        axes.text(1.006, 0.5, told, transform=axes.transAxes, va="center", fontsize=7.5, color=_STALLED, gid="missed")
    axes.set(xlim=(0, episode.key_frames), ylim=(0, 1), yticks=[])
    _side_title(axes, "phase")
    _bare(axes)


def draw_tries(axes: Axes, episode: ViewedEpisode) -> None:
    """Draws which joint each try was for, how far it moved, and which followed a failed one and worked."""
    joints = list(dict.fromkeys(each.joint for each in episode.tries))
    for each in episode.tries:
        height = joints.index(each.joint)
        color = FAILED if each.failed else WORKED
        axes.barh(height, 0.9, left=each.key_frame + 0.05, height=0.86, color=color, gid="tries")
        moved = f"{each.progress:+.2f}"
        word = f"{moved}\nfailed" if each.failed else f"{moved}\nrecovers" if each.recovers else moved
        axes.text(
            each.key_frame + 0.5,
            height,
            word,
            ha="center",
            va="center",
            fontsize=6.5,
            color="white",
            gid="recoveries" if each.recovers else "try",
        )
    axes.set(yticks=range(len(joints)), ylim=(len(joints) - 0.4, -0.6))
    axes.set_yticklabels(joints, fontsize=8)
    _side_title(axes, "tries")
    _bare(axes)


def draw_effort(axes: Axes, episode: ViewedEpisode) -> None:
    """Draws what the arm felt, with the failed tries behind it."""
    from matplotlib.ticker import MaxNLocator

    rows = np.arange(len(episode.effort))
    for each in episode.tries:
        if each.failed:
            axes.axvspan(each.key_frame, each.key_frame + 1, color=FAILED, alpha=0.12, linewidth=0, gid="felt")
    for joint, torque in enumerate(episode.effort.T):
        axes.plot(rows, torque, linewidth=1.2, label=f"joint {joint + 1}", gid="effort")
    if episode.effort.size:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), fontsize=7, frameon=False, handlelength=1.2)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="key frame", ylabel="torque [N m]")
    axes.tick_params(labelsize=8)
    axes.grid(axis="y", alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


def _side_title(axes: Axes, text: str) -> None:
    axes.set_ylabel(text, fontsize=9, rotation=0, ha="right", va="center", labelpad=8)


def _bare(axes: Axes) -> None:
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, labelbottom=False)
