"""A picture of an episode: the scene with the tool's path and goals, and below it what happened, by key frame."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d
from lerobot_adamanip.datasets.view.episode import CLOSED, Try, ViewedEpisode
from lerobot_adamanip.datasets.view.strips import FAILED, WORKED, draw_effort, draw_phases, draw_tries
from lerobot_adamanip.evaluation.plots import new_figure
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE, DPI = (11.0, 7.8), 100
"""Of the picture [inch], and of an inch [px]."""
_PATH, _GOAL = "#1f4e9c", "#444444"
_MARGIN = 0.1
"""Around the tool's path, in the view from above [m]."""
_SHAFT = 0.045
"""Of the lines that show where a goal's hand points [m]."""


def write_still(episode: ViewedEpisode, path: Path) -> None:
    """Draws an episode to a PNG file, which also holds in words what it shows (`drawn`).

    Raises:
        ConfigurationError: the file is to be of another kind.
    """
    if path.suffix.lower() != ".png":
        raise ConfigurationError("Unknown kind of picture.", got=path, allowed=".png", hint="--out episode.png")
    figure = draw(episode)
    content = io.BytesIO()
    figure.savefig(
        content,
        format="png",
        dpi=DPI,
        pil_kwargs={"optimize": True},
        metadata={"Description": json.dumps(drawn(figure)), "Software": ""},
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_atomically(path, content.getvalue())


def drawn(figure: Figure) -> dict[str, Any]:
    """Returns what a picture shows: of each part by its name, how many points, or which words."""
    found: dict[str, Any] = {"title": figure.get_suptitle()}
    for axes in figure.axes:
        for artist in (*axes.collections, *axes.lines, *axes.patches, *axes.texts):
            name = artist.get_gid()
            if name is None:
                continue
            if hasattr(artist, "get_text"):
                found.setdefault(name, []).append(artist.get_text())
            elif hasattr(artist, "get_offsets"):
                found[name] = found.get(name, 0) + len(artist.get_offsets())
            else:
                found[name] = found.get(name, 0) + (len(artist.get_xdata()) if hasattr(artist, "get_xdata") else 1)
    return found


def draw(episode: ViewedEpisode) -> Figure:
    """Returns the picture of an episode."""
    figure = new_figure(*SIZE)
    grid = figure.add_gridspec(4, 2, height_ratios=(7.2, 0.5, 1.1, 1.9), width_ratios=(1.1, 1.0))
    _draw_scene(figure.add_subplot(grid[0, 0]), episode)
    _draw_top(figure.add_subplot(grid[0, 1]), episode)
    phases = figure.add_subplot(grid[1, :])
    tries = figure.add_subplot(grid[2, :], sharex=phases)
    effort = figure.add_subplot(grid[3, :], sharex=phases)
    draw_phases(phases, episode)
    draw_tries(tries, episode)
    draw_effort(effort, episode)
    figure.suptitle(episode.title, fontsize=11)
    return figure


def _seen_from(camera: NDArray[np.float64], points: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Returns what a camera sees of points (..., 3): image coordinates (..., 2), y up, and depths (...) [m]."""
    local = (points - camera[:3, 3]) @ camera[:3, :3]
    depth = np.maximum(local[..., 2], 1e-3)
    return np.stack([local[..., 0], -local[..., 1]], axis=-1) / depth[..., None], depth


def _any_camera(cloud: NDArray[Any]) -> NDArray[np.float64]:
    """Returns a camera that looks at a cloud from beside the robot, for datasets that tell of none."""
    centre = np.median(cloud, axis=0)
    ahead = np.array([0.62, 0.6, -0.5])
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    pose[:3, 3] = centre - 1.1 * ahead
    return pose


def _draw_scene(axes: Axes, episode: ViewedEpisode) -> None:
    cloud, path = episode.clouds[0], episode.tools[:, :3]
    camera = _any_camera(cloud) if episode.camera is None else episode.camera
    where, depth = _seen_from(camera, cloud)
    order = np.argsort(-depth)
    shown = axes.scatter(
        where[order, 0], where[order, 1], c=cloud[order, 2], s=13 / depth[order] ** 2, cmap="viridis", linewidths=0
    )
    shown.set_gid("cloud")
    way = _seen_from(camera, path)[0]
    _draw_way(axes, episode, way, _seen_from(camera, _shafts(episode))[0])
    for number, name, aside in ((0, "start", (-4, 16)), (len(way) - 1, "end", (-26, -20))):
        axes.annotate(
            name,
            way[number],
            xytext=aside,
            textcoords="offset points",
            fontsize=8,
            color=_PATH,
            gid="ends",
            zorder=9,
            bbox={"facecolor": "white", "linewidth": 0, "pad": 0.8, "alpha": 0.85},
            arrowprops={"arrowstyle": "-", "color": _PATH, "linewidth": 0.7},
        )
    axes.set_aspect("equal")
    axes.set_axis_off()
    told = "from the camera" if episode.camera is not None else "from beside the robot"
    axes.set_title(f"scene at the start, {told} (colour: height)", fontsize=9)


def _draw_top(axes: Axes, episode: ViewedEpisode) -> None:
    """The view from above, the robot below: x up, y to the left."""
    cloud, path, shafts = episode.clouds[0], episode.tools[:, :3], _shafts(episode)
    around = np.concatenate([path, episode.goals[:, :3]])
    low, high = around.min(axis=0) - _MARGIN, around.max(axis=0) + _MARGIN
    order = np.argsort(cloud[:, 2])
    shown = axes.scatter(cloud[order, 1], cloud[order, 0], c=cloud[order, 2], s=9, cmap="viridis", linewidths=0)
    shown.set(alpha=0.45, gid="cloud")
    _draw_way(axes, episode, path[:, 1::-1], shafts[..., 1::-1])
    axes.set(xlim=(high[1], low[1]), ylim=(low[0], high[0]), xlabel="y [m]", ylabel="x [m], away from the robot")
    axes.set_aspect("equal")
    axes.tick_params(labelsize=8)
    axes.set_title("around the tool's path, from above", fontsize=9)
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.12),
        ncols=3,
        fontsize=8,
        frameon=False,
        columnspacing=1.0,
        handletextpad=0.4,
    )


def _shafts(episode: ViewedEpisode) -> NDArray[Any]:
    """Returns (K, 2, 3): of each goal, a point behind it along the hand, and the goal."""
    goals = episode.goals
    ahead = matrix_from_rotation_6d(goals[:, schema.ROTATION_DIMS])[..., :, 2]
    return np.stack([goals[:, :3] - _SHAFT * ahead, goals[:, :3]], axis=1)


def _draw_way(axes: Axes, episode: ViewedEpisode, way: NDArray[Any], shafts: NDArray[Any]) -> None:
    """Draws path, goals and tries in a plane. A try stands where the tool was when it was over."""
    axes.plot(*way.T, color="white", linewidth=3.2, alpha=0.8, zorder=3)
    axes.plot(*way.T, color=_PATH, linewidth=1.4, zorder=4, gid="path", label="tool")
    for shaft in shafts:
        axes.plot(*shaft.T, color=_GOAL, linewidth=0.8, zorder=5, gid="hands")
    closed = episode.goals[:, schema.GRIPPER_DIM] < CLOSED
    for hand, color, name in ((~closed, "white", "goal, hand open"), (closed, "#9a9a9a", "goal, hand closed")):
        if hand.any():
            axes.scatter(
                shafts[hand, 1, 0],
                shafts[hand, 1, 1],
                s=28,
                facecolors=color,
                edgecolors=_GOAL,
                linewidths=0.9,
                zorder=5,
                gid="goals",
                label=name,
            )
    for failed, marker, color, name in ((True, "X", FAILED, "failed try"), (False, "o", WORKED, "try that worked")):
        places = [each.key_frame + 1 for each in episode.tries if each.failed is failed]
        if places:
            axes.scatter(
                way[places, 0],
                way[places, 1],
                s=70 if failed else 36,
                marker=marker,
                color=color,
                edgecolors="white",
                linewidths=0.8,
                zorder=7 if failed else 6,
                gid=name,
                label=name,
            )
    for each in episode.tries:
        if each.failed or each.recovers:
            _number(axes, way[each.key_frame + 1], each)


def _number(axes: Axes, where: NDArray[Any], attempt: Try) -> None:
    """Names the key frame of a try, so that it is found in the strips below."""
    color = FAILED if attempt.failed else WORKED
    axes.annotate(
        str(attempt.key_frame),
        tuple(where),
        xytext=(0, 9 if attempt.failed else -15),
        textcoords="offset points",
        ha="center",
        fontsize=8,
        fontweight="bold",
        color=color,
        zorder=8,
        gid="numbers",
        bbox={"facecolor": "white", "linewidth": 0, "pad": 0.6, "alpha": 0.8},
    )
