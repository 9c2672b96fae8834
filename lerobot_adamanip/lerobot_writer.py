"""A writer of LeRobot datasets whose every saved episode can be read, whatever becomes of the process afterwards.

Each episode has files of its own, whose ends are written when it is saved: rows, then videos, then its line of
``meta/episodes``, then the statistics, and last ``meta/info.json``, which counts it. A kill in between leaves files
that nothing counts; `lerobot_adamanip.hub.check.repair` moves them away, or counts them if they are whole. It builds on
private names of LeRobot: `lerobot_adamanip.lerobot_recording` imports it where they are as they were when it was
written.
"""

from __future__ import annotations

import contextlib
import logging
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from lerobot.configs.video import DepthEncoderConfig
from lerobot.datasets.compute_stats import aggregate_stats
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.dataset_writer import DatasetWriter
from lerobot.datasets.io_utils import write_info, write_stats
from lerobot.datasets.utils import DEFAULT_EPISODES_PATH
from lerobot.datasets.video_utils import StreamingVideoEncoder
from lerobot.utils.utils import flatten_dict

from lerobot_adamanip import files
from lerobot_adamanip.demos.output_folder import lock_output, resolve_output
from lerobot_adamanip.hardware.calibration.file import save_calibration
from lerobot_adamanip.hardware.features import CALIBRATIONS, SAFETY
from lerobot_adamanip.hardware.safety_limits import SafetyLimits
from lerobot_adamanip.hardware.session import BOARD

_X265 = "x265-params"
_FULL = 0.0
"""A file of this size is full [MB]: every episode begins another one."""
_log = logging.getLogger(__name__)


class DurableMetadata(LeRobotDatasetMetadata):
    """LeRobot's metadata, written through with every episode; ``meta/info.json`` last."""

    root: Path
    stats: dict[str, dict[str, Any]] | None

    @property
    def data_files_size_in_mb(self) -> float:
        """Any file is full. What ``meta/info.json`` says stays."""
        return _FULL

    @property
    def video_files_size_in_mb(self) -> float:
        """As `data_files_size_in_mb`."""
        return _FULL

    def save_episode_tasks(self, tasks: list[str]) -> None:
        """As LeRobot's, but a crash leaves the old list of tasks or the new one."""
        root, save = self.root, super().save_episode_tasks

        def write(folder: Path) -> None:
            self.root = folder
            try:
                save(tasks)
            finally:
                self.root = root

        _write_atomically(root, write)

    def save_episode(
        self,
        episode_index: int,
        episode_length: int,
        episode_tasks: list[str],
        episode_stats: dict[str, dict[str, Any]],
        episode_metadata: dict[str, Any],
    ) -> None:
        """As LeRobot's; the episode is saved once ``meta/info.json`` has been replaced."""
        _keep_calibrations(self.root)
        _keep_safety(self.root)
        told = {"episode_index": episode_index, "tasks": episode_tasks, "length": episode_length}
        self._save_episode_metadata({**told, **episode_metadata, **flatten_dict({"stats": episode_stats})})
        self._close_writer()
        self._sync_latest()
        stats = episode_stats if self.stats is None else aggregate_stats([self.stats, episode_stats])
        self.stats = stats
        _write_atomically(self.root, lambda folder: write_stats(stats, folder))
        self.info.total_episodes += 1
        self.info.total_frames += episode_length
        self.info.total_tasks = len(self.tasks)
        self.info.splits = {"train": f"0:{self.info.total_episodes}"}
        _write_atomically(self.root, lambda folder: write_info(self.info, folder))

    def _sync_latest(self) -> None:
        """Makes the files of the latest episode outlive a power cut."""
        latest = {key: value[0] for key, value in self.latest_episode.items()}

        def numbers(prefix: str) -> dict[str, int]:
            return {name: int(latest[f"{prefix}/{name}"]) for name in ("chunk_index", "file_index")}

        names = [self.data_path.format(**numbers("data")), DEFAULT_EPISODES_PATH.format(**numbers("meta/episodes"))]
        names += [self.video_path.format(video_key=key, **numbers(f"videos/{key}")) for key in self.video_keys]
        for path in (self.root / name for name in names):
            files.sync(path)
            files.sync(path.parent)


class DurableWriter(DatasetWriter):
    """LeRobot's writer, which ends an episode's files when it saves the episode."""

    _batch_encoding_size: int
    _depth_encoder: DepthEncoderConfig
    _streaming_encoder: StreamingVideoEncoder | None

    def __init__(self, meta: LeRobotDatasetMetadata, *args: Any, **kwargs: Any) -> None:
        super().__init__(meta, *args, **kwargs)
        self._lock = contextlib.ExitStack()
        self._lock.enter_context(lock_output(resolve_output(meta.root), optional=True))
        meta.__class__ = DurableMetadata  # the same data, written otherwise
        self._depth_encoder = in_order(self._depth_encoder)
        if self._streaming_encoder is not None:
            self._streaming_encoder._depth_encoder = in_order(self._streaming_encoder._depth_encoder)
        if self._batch_encoding_size > 1:
            _log.warning(
                "video_encoding_batch_size = %d would leave saved episodes without videos until so many are saved: it "
                "is 1 for this robot. For quick saving: --dataset.streaming_encoding=true",
                self._batch_encoding_size,
            )
            self._batch_encoding_size = 1

    def finalize(self) -> None:
        """As LeRobot's; from then on another process may write the dataset, or repair it."""
        super().finalize()
        self._lock.close()

    def _save_episode_data(self, episode_buffer: dict[str, Any]) -> dict[str, Any]:
        """Writes the rows, and the end of their file."""
        metadata: dict[str, Any] = super()._save_episode_data(episode_buffer)
        self.close_writer()
        return metadata


def in_order(encoder: DepthEncoderConfig) -> DepthEncoderConfig:
    """Returns an encoder of depth whose frames are stored as they come; another codec's as it is.

    x265 otherwise looks ahead, and one time in four a video of one or two frames cannot be written ("pts/dts pair
    unsupported"), which would end the session of who ends an episode as soon as it has begun.
    """
    given = str(encoder.extra_options.get(_X265, ""))
    if encoder.vcodec not in ("hevc", "libx265") or "bframes" in given:
        return encoder
    options = {**encoder.extra_options, _X265: ":".join(filter(None, (given, "bframes=0")))}
    return replace(encoder, extra_options=options)


def _keep_calibrations(root: Path) -> None:
    """Writes where the connected robot's cameras stand beside its first episode: the pictures alone do not tell."""
    session = BOARD.find()
    if session is None or (root / CALIBRATIONS).exists():
        return
    for key, calibration in session.calibrations.items():
        save_calibration(root / CALIBRATIONS, key, calibration)


def _keep_safety(root: Path) -> None:
    """Writes the limits of the connected robot's safety filter: a roll-out does not tell which target was accepted."""
    session = BOARD.find()
    if session is not None and isinstance(session.safety, SafetyLimits) and not (root / SAFETY).exists():
        files.write_atomically(root / SAFETY, session.safety.to_json().encode())


def _write_atomically(root: Path, write: Callable[[Path], None]) -> None:
    """Lets LeRobot write a file of metadata elsewhere, and puts it into its place in one step."""
    with tempfile.TemporaryDirectory() as scratch:
        write(Path(scratch))
        for path in Path(scratch).rglob("*"):
            if path.is_file():
                files.write_atomically(root / path.relative_to(scratch), path.read_bytes())
