"""Patch: make every saved episode of our robots' recordings readable at once, even if the process is killed later.

Changes:
    `lerobot.datasets.lerobot_dataset.DatasetWriter`, for datasets of our robots (`is_dense`), and
    ``LeRobotDataset.resume``, which first repairs such a recording. Each episode gets its own files, complete when it
    is saved: rows, videos, its line of ``meta/episodes``, statistics, and last ``meta/info.json``, which counts it. A
    kill in between leaves uncounted files, and `datasets.repair` moves them away. The writer also stores calibrations
    and safety limits of the connected robot next to its recording, refuses to resume with moved cameras, and adds to
    each row the columns of simulated demonstrations and the arm's reading. ``LeRobotDataset.create`` adds these
    columns; the recorder's comparison expects them when it resumes.
Why:
    LeRobot completes its Parquet files when a session ends. It makes all numbers of a robot inputs of policies.
Without it:
    A kill loses every episode of a recording session; recordings lack the arm's readings and calibrations.
Upstream:
    https://github.com/huggingface/lerobot/issues/3522 and https://github.com/huggingface/lerobot/issues/2495;
    https://github.com/huggingface/lerobot/pull/2864 (open) flushes periodically, but not for `lerobot-record`.
Needed for:
    0.6.1 and main of 2026-08-23, tested with both.
Guard:
    Records two episodes into a scratch folder. Each must be readable as soon as it is saved.
"""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pyarrow.parquet as pq
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.dataset_writer import DatasetWriter
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import DEFAULT_EPISODES_PATH
from numpy.typing import NDArray

from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, POSE, STATES
from lerobot_adamanip.contract.schema import ACTION, DONE, STATE
from lerobot_adamanip.datasets.output_folder import lock_output, resolve_output
from lerobot_adamanip.datasets.statistics import write_statistics
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, read_calibrations, save_calibration
from lerobot_adamanip.hardware.features import (
    ARM,
    CALIBRATIONS,
    FRONT_CAMERA,
    SAFETY,
    is_dense,
    recorded_features,
    split_memory,
)
from lerobot_adamanip.hardware.recorded_rows import MAX_ROWS
from lerobot_adamanip.hardware.robot_registry import ROBOTS
from lerobot_adamanip.hardware.safety import SafetyLimits
from lerobot_adamanip.lerobot_patches.support import UnsupportedError, loaded, replace
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

INFO = "info.json"
MAX_MOVED_MM = 5.0
"""Maximum change of a camera's calibration within one recording, of points 1 m ahead [mm]."""
RECORDER, COMPARISON = "lerobot.scripts.lerobot_record", "sanity_check_dataset_robot_compatibility"
_log = logging.getLogger(__name__)


def apply() -> None:
    """Applies the patch. Raises `UnsupportedError` if an episode is not readable as soon as it is saved."""
    stock = lerobot_dataset.DatasetWriter
    create, resume = LeRobotDataset.create.__func__, LeRobotDataset.resume.__func__

    def make_writer(meta: Any, *args: Any, **options: Any) -> Any:
        return (DurableWriter if is_dense(meta.features) else stock)(meta, *args, **options)

    @functools.wraps(create)
    def create_with_robot(cls: type[Any], repo_id: str, fps: int, features: Any, *args: Any, **options: Any) -> Any:
        return create(cls, repo_id, fps, with_robot_columns(features), *args, **options)

    @functools.wraps(resume)
    def resume_mended(cls: type[Any], repo_id: str, root: str | Path | None = None, *args: Any, **options: Any) -> Any:
        if root is not None:
            repair_recording(Path(root))
        return resume(cls, repo_id, root, *args, **options)

    replace(lerobot_dataset, "DatasetWriter", make_writer)
    replace(LeRobotDataset, "create", classmethod(create_with_robot))
    replace(LeRobotDataset, "resume", classmethod(resume_mended))
    if hasattr(recorder := loaded(RECORDER), COMPARISON):
        replace(recorder, COMPARISON, comparing(getattr(recorder, COMPARISON)))
    try:
        rehearse()
    except Exception as error:
        raise UnsupportedError(str(error)) from error


def with_robot_columns(features: dict[str, Any]) -> dict[str, Any]:
    """Returns the features of a new dataset, with the recorder's columns if it is a recording of our robots."""
    own = split_memory(features)
    return recorded_features(own) if is_dense(own) else features


def comparing(stock: Callable[..., None]) -> Callable[..., None]:
    """Returns LeRobot's comparison of a robot with the recording that it resumes, aware of the added columns."""

    @functools.wraps(stock)
    def compare(dataset: Any, robot: Any, fps: int, features: dict[str, Any]) -> None:
        stock(dataset, robot, fps, with_robot_columns(features))

    return compare


class DurableMetadata(LeRobotDatasetMetadata):
    """LeRobot's metadata, complete on disk after every episode."""

    root: Path
    data_files_size_in_mb = video_files_size_in_mb = 0.0
    """File size limit [MB]: every file counts as full, so each episode gets its own. ``meta/info.json`` stays as is."""

    def save_episode_tasks(self, tasks: list[str]) -> None:
        """Like LeRobot's, but a crash leaves either the old or the new list of tasks."""
        with self._replacing_files():
            super().save_episode_tasks(tasks)

    @functools.wraps(LeRobotDatasetMetadata.save_episode)
    def save_episode(self, *args: Any, **kwargs: Any) -> None:
        """Like LeRobot's. The episode counts as saved after ``meta/info.json`` is replaced."""
        with self._replacing_files():
            super().save_episode(*args, **kwargs)

    def _save_episode_metadata(self, episode: dict[str, Any]) -> None:
        scratch, self.root = self.root, self._place
        try:
            _keep_robot(self.root)
            super()._save_episode_metadata(episode)
            self._close_writer()
            self._sync_latest()
        finally:
            self.root = scratch

    @contextlib.contextmanager
    def _replacing_files(self) -> Iterator[None]:
        """Lets LeRobot write files elsewhere, then moves each into place atomically, ``meta/info.json`` last."""
        self._place = self.root
        with tempfile.TemporaryDirectory() as scratch:
            self.root = Path(scratch)
            try:
                yield
            finally:
                self.root = self._place
            written = (path for path in Path(scratch).rglob("*") if path.is_file())
            for path in sorted(written, key=lambda path: path.name == INFO):
                files.write_atomically(self.root / path.relative_to(scratch), path.read_bytes())

    def _sync_latest(self) -> None:
        """Syncs the files of the latest episode to disk, so that they survive a power cut."""
        latest = {key: value[0] for key, value in self.latest_episode.items()}

        def numbers(prefix: str) -> dict[str, int]:
            return {name: int(latest[f"{prefix}/{name}"]) for name in ("chunk_index", "file_index")}

        names = [self.data_path.format(**numbers("data")), DEFAULT_EPISODES_PATH.format(**numbers("meta/episodes"))]
        names += [self.video_path.format(video_key=key, **numbers(f"videos/{key}")) for key in self.video_keys]
        for path in (self.root / name for name in names):
            files.sync(path)
            files.sync(path.parent)


class DurableWriter(DatasetWriter):
    """LeRobot's writer, but each saved episode has complete files. It holds the dataset's lock."""

    def __init__(self, meta: LeRobotDatasetMetadata, *args: Any, **options: Any) -> None:
        if (size := options.get("batch_encoding_size", 1)) > 1:
            options["batch_encoding_size"] = 1
            _log.warning(
                "video_encoding_batch_size = %d would leave saved episodes without videos: it is 1 for this robot. "
                "For quick saving: --dataset.streaming_encoding=true",
                size,
            )
        super().__init__(meta, *args, **options)
        self._lock = contextlib.ExitStack()
        self._lock.enter_context(lock_output(resolve_output(meta.root), optional=True))
        meta.__class__ = DurableMetadata  # the same data, written differently
        self._has_rows = False

    def add_frame(self, frame: dict[str, Any]) -> None:
        """Like LeRobot's, with the arm's reading that the row was observed with.

        Raises:
            ConfigurationError: a resumed recording has another calibration than the connected robot.
            RobotError: the session has no row of the frame's observation.
        """
        if not self._has_rows:
            require_same_cameras(self._meta.root)
            self._has_rows = True
        session = ROBOTS.find()
        row = {} if session is None else session.rows.find(frame[STATE])
        if ARM in self._meta.features and ARM not in {**row, **frame}:
            raise RobotError(
                "A frame cannot be recorded: the arm's reading of its observation is unknown.",
                got="no single connected robot" if session is None else f"no such state in the last {MAX_ROWS}",
                allowed=f"frames of one robot of ours, each within {MAX_ROWS} observations",
                hint="--strategy.type=highlight: a smaller --strategy.ring_buffer_seconds",
            )
        super().add_frame({**{key: value for key, value in row.items() if key in self._meta.features}, **frame})

    def save_episode(self, episode_data: dict[str, Any] | None = None, parallel_encoding: bool = True) -> None:
        """Like LeRobot's, but marks the last row as the episode's end, and the robot's session starts an episode."""
        ends = (self.episode_buffer if episode_data is None else episode_data).get(DONE)
        if ends:
            ends[-1] = np.array([True])
        super().save_episode(episode_data, parallel_encoding)
        _count_episode()

    def clear_episode_buffer(self, delete_images: bool = True) -> None:
        """Like LeRobot's, and the robot's session starts an episode."""
        super().clear_episode_buffer(delete_images)
        _count_episode()

    def finalize(self) -> None:
        """Like LeRobot's, but with true statistics. Afterwards another process may write or repair the dataset."""
        is_open = not getattr(self, "_finalized", False)
        try:
            super().finalize()
            if is_open and self._meta.total_episodes:
                write_statistics(self._meta.root, self._meta.features)
        finally:
            self._lock.close()

    def _save_episode_data(self, episode_buffer: dict[str, Any]) -> dict[str, Any]:
        metadata: dict[str, Any] = super()._save_episode_data(episode_buffer)
        self.close_writer()
        return metadata


def _count_episode() -> None:
    """Counts an episode of the connected robot: its memory starts anew. `lerobot-rollout` does not count them."""
    if (session := ROBOTS.find()) is not None:
        session.episodes += 1


def rehearse() -> None:
    """Records two episodes of one row into a scratch folder. Raises if a saved one cannot be read."""
    names = {STATE: STATES[POSE], ACTION: ACTION_NAMES[EE_DELTA]}
    features = {key: {"dtype": "float32", "shape": (len(own),), "names": list(own)} for key, own in names.items()}
    zeros = {key: np.zeros(column["shape"], column["dtype"]) for key, column in with_robot_columns(features).items()}
    quiet = datasets.are_progress_bars_disabled()
    datasets.disable_progress_bars()
    try:
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder) / "rehearsal"
            dataset = LeRobotDataset.create("local/rehearsal", 30, features, root=root)
            for episodes in (1, 2):
                dataset.add_frame({**zeros, "task": "rehearsal"})
                dataset.save_episode()
                counted = json.loads((root / "meta" / INFO).read_text(encoding="utf-8"))["total_episodes"]
                counts = [counted, *(_rows(root / name) for name in ("data", "meta/episodes"))]
                if counts != [episodes] * 3:
                    raise ValueError(f"{counts} of {episodes} saved episodes are readable")
            dataset.finalize()
    finally:
        if not quiet:
            datasets.enable_progress_bars()


def _rows(folder: Path) -> int:
    return sum(pq.read_metadata(path).num_rows for path in folder.rglob("*.parquet"))


def repair_recording(root: Path) -> None:
    """Repairs a recording of our robots after a crash. Ignores other datasets and missing folders."""
    from lerobot_adamanip.datasets.opening import read_info
    from lerobot_adamanip.datasets.repair import repair

    try:
        if not is_dense(read_info(root)["features"]):
            return
    except (OSError, ValueError):
        return  # LeRobot reports the error
    for line in repair(root).lines():
        _log.warning("%s: %s", root.name, line)


def require_same_cameras(root: Path) -> None:
    """Checks that the connected robot has the recorded cameras: conversion uses their calibrations for all episodes.

    The front camera may have moved, since rows hold its pose.

    Raises:
        ConfigurationError: a camera differs by more than `MAX_MOVED_MM`.
    """
    session, path = ROBOTS.find(), root / CALIBRATIONS
    if session is None or not path.exists():
        return
    recorded = read_calibrations(path)
    for key in recorded.keys() & session.calibrations.keys():
        before, now = recorded[key], session.calibrations[key]
        if key == FRONT_CAMERA and (before.depth_in_base is None) == (now.depth_in_base is None):
            now = now.at(before.depth_pose)
        moved = _points_ahead(before) - _points_ahead(now)
        if (moved_mm := 1e3 * np.linalg.norm(moved, axis=1).max()) > MAX_MOVED_MM:
            raise ConfigurationError(
                "This recording cannot be resumed: a camera is another one, or was calibrated again.",
                got=f"camera {key}, moved by {moved_mm:.0f} mm at a distance of 1 m; nothing was recorded",
                allowed=f"the calibration in {path}, within {MAX_MOVED_MM:g} mm",
                hint="a new --dataset.root without --resume; convert each with adamanip keyframes",
            )


def _points_ahead(camera: CameraCalibration) -> NDArray[np.float64]:
    """Returns the corners of the picture 1 m ahead (4, 3), base or tool frame [m]."""
    pose = camera.depth_pose
    pixels = np.array([(x, y, 1.0) for x in (0, camera.depth.width - 1) for y in (0, camera.depth.height - 1)])
    return np.linalg.solve(camera.depth.matrix, pixels.T).T @ pose[:3, :3].T + pose[:3, 3]


def _keep_robot(root: Path) -> None:
    """Writes the connected robot's camera calibrations and safety limits next to its first episode, since rows do not
    contain them.
    """
    session = ROBOTS.find()
    if session is None:
        return
    if not (root / CALIBRATIONS).exists():
        for key, calibration in session.calibrations.items():
            save_calibration(root / CALIBRATIONS, key, calibration)
    if isinstance(session.safety, SafetyLimits) and not (root / SAFETY).exists():
        files.write_atomically(root / SAFETY, session.safety.to_json().encode())
