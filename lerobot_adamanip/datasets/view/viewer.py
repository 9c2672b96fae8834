"""Show an episode in rerun, which comes with ``lerobot[viz]`` and is imported only when needed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d
from lerobot_adamanip.datasets.view.episode import ViewedEpisode
from lerobot_adamanip.util.errors import ConfigurationError

APPLICATION = "adamanip"
KEY_FRAME, SECONDS = "key_frame", "time"
"""Timelines: number of the key frame, and seconds since the start."""
_TOOL, _GOAL, _FAILED, _WORKED = (31, 78, 156), (90, 90, 90), (198, 40, 40), (46, 125, 50)
_AXIS = 0.05
"""Length of the axes of a pose [m]."""
_AXES = np.array([(220, 60, 60), (60, 160, 60), (70, 90, 220)], np.uint8)


def save(episode: ViewedEpisode, path: Path) -> None:
    """Writes a recording for `rerun FILE.rrd`, atomically. Needs no display."""
    recording = _rerun().RecordingStream(APPLICATION)
    path.parent.mkdir(parents=True, exist_ok=True)
    half = path.with_name(f".{path.name}.writing")
    try:
        recording.save(half, default_blueprint=_blueprint(episode))
        log_episode(recording, episode)
        recording.flush()
        recording.disconnect()
        os.replace(half, path)
    finally:
        half.unlink(missing_ok=True)


def log_episode(recording: Any, episode: ViewedEpisode) -> None:
    """Logs an episode to a rerun stream, row by row."""
    rr = _rerun()
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("log", rr.TextLog(episode.title, level="INFO"), static=True)
    joints = [f"joint {number + 1} [N m]" for number in range(episode.effort.shape[1])]
    recording.log("effort", rr.SeriesLines(names=joints), static=True)
    recording.log("gripper", rr.SeriesLines(names=["gripper (0 closed, 1 open)"]), static=True)
    for row, (cloud, tool) in enumerate(zip(episode.clouds, episode.tools, strict=True)):
        recording.set_time(KEY_FRAME, sequence=row)
        recording.set_time(SECONDS, duration=float(episode.seconds[row]))
        recording.log("world/cloud", rr.Points3D(cloud, colors=_by_height(cloud), radii=0.003))
        path = episode.tools[: row + 1, :3]
        recording.log("world/tool/path", rr.LineStrips3D([path], colors=[_TOOL], radii=0.0015))
        _log_pose(recording, "world/tool/pose", tool)
        recording.log("gripper", rr.Scalars([float(tool[schema.GRIPPER_DIM])]))
        if episode.effort.size:
            recording.log("effort", rr.Scalars(episode.effort[row]))
        if episode.images is not None:
            recording.log("camera", rr.Image(episode.images[row]))
        if row < episode.key_frames:
            _log_key_frame(recording, episode, row)
    recording.log("world/goal", rr.Clear(recursive=True))


def _log_key_frame(recording: Any, episode: ViewedEpisode, number: int) -> None:
    """Logs the goal, the outcome, and the try if there is one."""
    rr = _rerun()
    goal, phase, outcome = episode.goals[number], episode.phases[number], episode.outcomes[number]
    _log_pose(recording, "world/goal/pose", goal)
    doing, ended = ("not labelled" if label is None else label.name.lower() for label in (phase, outcome))
    recording.log("world/goal/point", rr.Points3D([goal[:3]], colors=[_GOAL], radii=0.008, labels=[doing]))
    level = "INFO" if outcome in (Outcome.REACHED, None) else "WARN"
    recording.log("log", rr.TextLog(f"{number}: {doing}, {ended}", level=level))
    for each in episode.tries:
        if each.key_frame == number:
            told = "failed" if each.failed else "worked, after one that failed" if each.recovers else "worked"
            text = f"{number}: try at the {each.joint} {told} (moved {each.progress:+.3f} rad or m)"
            recording.log("log", rr.TextLog(text, level="ERROR" if each.failed else "INFO"))
            where = episode.tools[min(number + 1, len(episode.tools) - 1), :3]
            look = {"colors": [_FAILED if each.failed else _WORKED], "labels": [f"{number} {each.joint} {told}"]}
            recording.log(f"world/tries/{number}", rr.Points3D([where], radii=0.01, **look))  # own name: stays visible


def _log_pose(recording: Any, name: str, pose: NDArray[Any]) -> None:
    """Logs a pose of the contract, (10,), as its three axes."""
    axes = matrix_from_rotation_6d(pose[schema.ROTATION_DIMS]).T * _AXIS
    origins = np.tile(pose[:3], (3, 1))
    recording.log(name, _rerun().Arrows3D(origins=origins, vectors=axes, colors=_AXES, radii=0.002))


def _by_height(cloud: NDArray[Any]) -> NDArray[np.uint8]:
    """Returns colours (N, 3) by height: dark blue below, yellow above."""
    from matplotlib import colormaps

    low, high = cloud[:, 2].min(), cloud[:, 2].max()
    colors: NDArray[np.uint8] = colormaps["viridis"]((cloud[:, 2] - low) / max(high - low, 1e-6), bytes=True)[:, :3]
    return colors


def _blueprint(episode: ViewedEpisode) -> Any:
    import rerun.blueprint as rrb

    views: list[Any] = [rrb.Spatial2DView(origin="camera", name="camera")] if episode.images is not None else []
    views += [rrb.TimeSeriesView(origin=name, name=name) for name in ("effort", "gripper")]
    told = rrb.Vertical(*views, rrb.TextLogView(origin="log", name="what happened"))
    scene = rrb.Spatial3DView(origin="world", name="scene")
    panel = rrb.TimePanel(timeline=KEY_FRAME)
    return rrb.Blueprint(rrb.Horizontal(scene, told, column_shares=[3, 2]), panel, collapse_panels=True)


def _rerun() -> Any:
    try:
        import rerun
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            "rerun is not installed.",
            got=f"no module {error.name}",
            allowed="rerun-sdk",
            hint="pip install 'lerobot[viz]'; or --out episode.png, which does not need it",
        ) from error
    return rerun
