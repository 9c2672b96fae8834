"""`adamanip view`: a picture of an episode, with the tool's path, goals and tries, and below it phases and effort."""

from __future__ import annotations

import enum
import io
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import is_asset_id, make_object
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome, Phase
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.evaluation.plots import new_figure
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.json_fields import parse

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
Array = NDArray[np.float32]


class ShownTry(NamedTuple):
    """A try; ``progress``: motion of its joint in the commanded direction [rad or m]; ``recovers``: after a failure."""

    key_frame: int
    joint: str
    failed: bool
    progress: float
    recovers: bool


@dataclass(frozen=True)
class ShownEpisode:
    """An episode of T rows; each row is the observation before its key frame.

    Attributes:
        title: one line: object, hidden state, result.
        clouds: (T, N, 3) points, robot base frame [m].
        tools: (T, 10) poses of the tool, as in the contract's action.
        goals: (T - 1, 10) commanded poses.
        effort: (T, 7) external joint torques [N m]; empty if not recorded.
        phases: phase of each key frame; None if unlabelled.
        outcomes: outcome of each key frame; None if not recorded.
        tries: in order.
    """

    title: str
    clouds: Array
    tools: Array
    goals: Array
    effort: Array
    phases: tuple[Phase | None, ...]
    outcomes: tuple[Outcome | None, ...]
    tries: tuple[ShownTry, ...]


def read_episode(root: Path, index: int) -> ShownEpisode:
    """Reads an episode of any dataset with a cloud, a state and actions in the contract's form.

    Raises:
        DatasetError: the dataset is missing, half written or damaged.
        ConfigurationError: it has no such episode.
    """
    dataset = Dataset(root)
    episode = dataset.episode(index)
    columns, length = dataset.columns(episode), episode.length
    sent = length - 1 if columns.get(schema.DONE, [False])[-1] else length
    tries = tuple(_tries(columns, sent, _joint_names(episode.row.get("object_id"))))
    return ShownEpisode(
        title=_title(index, episode.row, tries),
        clouds=as_points(columns[schema.POINT_CLOUD]).astype(np.float32),
        tools=columns[schema.STATE][:, : schema.ACTION_DIM].astype(np.float32),
        goals=columns.get(schema.EXECUTED, columns[schema.ACTION])[:sent].astype(np.float32),
        effort=columns.get(schema.EFFORT, np.zeros((length, 0))).astype(np.float32),
        phases=_labels(Phase, columns.get(schema.PHASE), sent),
        outcomes=_labels(Outcome, columns.get(schema.OUTCOME), sent),
        tries=tries,
    )


def _labels[Label: enum.IntEnum](
    kind: type[Label], column: NDArray[Any] | None, count: int
) -> tuple[Label | None, ...]:
    known = {int(label): label for label in kind}
    return tuple(known.get(code) for code in ([-1] * count if column is None else column[:count].astype(int).tolist()))


def _tries(columns: Mapping[str, NDArray[Any]], sent: int, names: tuple[str, ...]) -> Iterator[ShownTry]:
    failed_before = False
    for number, joint in enumerate(
        columns[schema.TRIED][:sent].astype(int).tolist() if schema.TRIED in columns else ()
    ):
        if joint >= 0:
            failed = bool(columns[schema.FAILED][number])
            name = names[joint] if joint < len(names) else f"joint {joint}"
            progress = float(columns[schema.PROGRESS][number])
            yield ShownTry(number, name, failed, progress, recovers=failed_before and not failed)
            failed_before = failed


def _joint_names(object_id: object) -> tuple[str, ...]:
    """Returns joint names of a generated object, the opening joint first; empty for other objects."""
    if not isinstance(object_id, str) or is_asset_id(object_id):
        return ()
    try:
        return make_mechanism(make_object(object_id)).joints
    except AdaManipError:
        return ()


def _title(index: int, row: Mapping[str, Any], tries: tuple[ShownTry, ...]) -> str:
    failed = sum(each.failed for each in tries)
    success = row.get("success")
    ended = "" if success is None else "success" if success else "no success"
    counted = f"{failed} failed {'try' if failed == 1 else 'tries'}" if tries else ""
    result = (" after " if success else ", ").join(filter(None, (ended, counted)))
    try:
        hidden = sorted(parse(row["hidden_state"]).items())
    except (ValueError, KeyError, TypeError, AttributeError):
        hidden = []
    values = [
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}".lower() for name, value in hidden
    ]
    shown = f"hidden: {', '.join(values)}" if values else ""
    parts = [f"episode {index}", str(row.get("object_id") or ", ".join(row["tasks"])), shown, result]
    return " · ".join(filter(None, parts))


# Picture --------------------------------------------------------------------------------------------------------------


def write_picture(episode: ShownEpisode, path: Path) -> None:
    """Draws an episode to a PNG file."""
    content = io.BytesIO()
    draw(episode).savefig(content, format="png", dpi=DPI, pil_kwargs={"optimize": True}, metadata={"Software": ""})
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_atomically(path, content.getvalue())


def draw(episode: ShownEpisode) -> Figure:
    """Returns the picture of an episode; its two axes are the scene and the timeline."""
    figure = new_figure(*SIZE)
    grid = figure.add_gridspec(2, 1, height_ratios=(2.6, 1.0))
    _draw_scene(figure.add_subplot(grid[0], projection="3d"), episode)
    _draw_timeline(figure.add_subplot(grid[1]), episode)
    figure.suptitle(episode.title, fontsize=11, parse_math=False)
    return figure


def _draw_scene(axes: Any, episode: ShownEpisode) -> None:
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
        for each, (x, y, z) in zip(tries, places, strict=True):
            if failed or each.recovers:
                beside = z + 0.02 if failed else z - 0.035
                axes.text(x, y, beside, str(each.key_frame), color=color, fontweight="bold", ha="center", gid="numbers")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_box_aspect(high - low, zoom=1.3)
    axes.view_init(elev=20, azim=-160)
    axes.locator_params(nbins=4)
    axes.legend(loc="upper left", fontsize=8, frameon=False)


def _draw_timeline(axes: Axes, episode: ShownEpisode) -> None:
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
        label = f"{each.joint}\n{each.progress:+.2f}" + ("\nrecovers" if each.recovers else "")
        color = FAILED if each.failed else WORKED
        axes.text(each.key_frame + 0.5, 0.03, label, transform=top, color=color, fontsize=7, ha="center", gid="tries")
    for number, outcome in enumerate(episode.outcomes):
        if outcome:  # neither reached nor unknown
            name = outcome.name.lower()
            axes.text(number + 0.3, 0.9, name, transform=top, color=STALLED, fontsize=7, gid=name)
    if episode.effort.size:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlim=(0, len(episode.goals)), xlabel="key frame", ylabel="torque [N m]")
    axes.spines[["top", "right"]].set_visible(False)
