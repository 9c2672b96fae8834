"""Reads a dense recording of LeRobot's recorder: columns by name, episodes and images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import image_column, is_image_column
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, read_calibrations
from lerobot_adamanip.hardware.features import (
    CALIBRATIONS,
    DEPTH_SUFFIX,
    FRONT_CAMERA,
    INTERVENTION,
    LABEL_NAME,
    OUTCOME_NAME,
    SAFETY,
    SENT_NAMES,
    STAMP_NAME,
    is_dense,
    names_of,
)
from lerobot_adamanip.hardware.safety import accepted, limits_from_json
from lerobot_adamanip.recordings.keyframe_choice import DenseEpisode
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

_ROTATION_OFF = 0.05
"""Maximum error of a valid target rotation. A larger error means that the robot has not accepted a target yet."""


@dataclass(frozen=True)
class DenseRecording:
    """A dataset that `lerobot-record` or `lerobot-rollout` recorded with one of our robots.

    Attributes:
        dataset: the recording.
        camera: key of the camera whose depth becomes the cloud.
    """

    dataset: Dataset
    camera: str = FRONT_CAMERA

    @classmethod
    def open(cls, root: Path, camera: str = FRONT_CAMERA) -> DenseRecording:
        """Opens a recording. Raises `DatasetError` if it is missing, from another robot, or without depth."""
        dataset = Dataset(root, recordings=True)
        if not is_dense(dataset.features):
            raise _unusable(
                dataset.root,
                "columns " + ", ".join(sorted(dataset.features)),
                "observation.state with the names of `lerobot_adamanip.hardware.features.SCALAR_NAMES`",
                "lerobot-record --robot.type=adamanip_franka",
            )
        depth = image_column(camera) + DEPTH_SUFFIX
        if depth not in dataset.features:
            pictures = [key for key in dataset.features if is_image_column(key)]
            raise _unusable(dataset.root, f"pictures {pictures}", depth, "--camera with a depth camera")
        return cls(dataset, camera)

    @property
    def root(self) -> Path:
        """Folder of the recording."""
        return self.dataset.root

    @cached_property
    def _frames(self) -> Any:
        """The complete recording as a LeRobotDataset, which decodes its videos."""
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        return LeRobotDataset(f"local/{self.root.name}", root=self.root, video_backend="pyav")

    def calibration(self, path: Path | None = None) -> CameraCalibration:
        """Returns the calibration of the camera, from a file or from the recording.

        Raises:
            DatasetError: there is no calibration of this camera.
            ConfigurationError: the file contains no calibrations.
        """
        chosen = path or self.root / CALIBRATIONS
        if path is None and not chosen.exists():
            got, hint = f"no {CALIBRATIONS} in {self.root.name}", "adamanip keyframes --calibration FILE"
            raise _unusable(self.root, got, "the robot's camera calibration", hint)
        known = read_calibrations(chosen)
        if self.camera not in known:
            raise _unusable(self.root, f"calibrations of {', '.join(known)}", self.camera, "--camera, --calibration")
        return known[self.camera]

    def __len__(self) -> int:
        return len(self.dataset)

    def episode(self, number: int) -> DenseEpisode:
        """Returns an episode's columns. Raises `DatasetError` for values that are not finite."""
        episode = self.dataset.episode(number)
        columns = self.dataset.columns(episode)
        states, asked = (columns[key].astype(np.float32, copy=False) for key in (schema.STATE, schema.ACTION))
        names, asked_names = (names_of(self.dataset.features[key]) for key in (schema.STATE, schema.ACTION))

        def scalars(selected: Sequence[str], default: float) -> NDArray[np.float32]:
            if not self._has(selected):
                return np.full((len(states), len(selected)), default, np.float32)
            return states[:, [names.index(name) for name in selected]]

        state = scalars(schema.STATE_NAMES, np.nan)
        if not np.isfinite(state).all() or len(state) < 2:
            got = f"episode {number}: {len(state)} ticks, NaN or infinity in {schema.STATE}"
            raise _unusable(self.root, got, "two ticks or more, finite", "lerobot-edit-dataset to delete it")
        asked = asked[:, [asked_names.index(name) for name in schema.POSE_NAMES]]
        sent = scalars(SENT_NAMES, np.nan) if self._has(SENT_NAMES) else self._accepted(asked, state[0, :10])
        corrected = columns.get(INTERVENTION)
        return DenseEpisode(
            state=state,
            effort=scalars(schema.EFFORT_NAMES, 0.0),
            sent=_targets(sent, state),
            stamp=scalars([STAMP_NAME], 0.0)[:, 0].astype(np.float64),
            outcome=np.rint(scalars([OUTCOME_NAME], -1.0)[:, 0]).astype(np.int64),
            success=scalars([LABEL_NAME], 0.0)[:, 0] > 0.5,
            task=self.dataset.tasks[int(columns["task_index"][0])],
            asked=asked,
            corrected=None if corrected is None else corrected.reshape(-1).astype(bool),
        )

    def _accepted(self, asked: NDArray[np.float32], first: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns the accepted target at each tick of a rollout (T, 10). A rollout records only the requested actions.

        It is the action of the previous tick, passed through the safety filter if the filter's limits are recorded.
        """
        path = self.root / SAFETY
        if not path.exists():
            return np.concatenate([first[None], asked[:-1]])
        try:
            limits = limits_from_json(path.read_bytes())
        except (OSError, ValueError, ConfigurationError) as error:
            got = f"{SAFETY}: {error}"
            hint = f"rename {SAFETY}: rows then say what was asked"
            raise _unusable(self.root, got, "the file that the recorder wrote", hint) from error
        sent = [first]
        for target in asked[:-1]:
            allowed = accepted(target, limits)
            sent.append(sent[-1] if allowed is None else allowed)
        return np.stack(sent)

    def _has(self, selected: Sequence[str]) -> bool:
        return set(selected) <= set(names_of(self.dataset.features[schema.STATE]))

    @property
    def has_success(self) -> bool:
        """Whether the recording contains success. Rollouts do not."""
        return self._has([LABEL_NAME])

    def pictures(self, number: int, tick: int) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint16]]:
        """Returns the colour (H, W, 3), if recorded, and depth (H, W) [mm] of a tick."""
        item = self._frames[self.dataset.episodes[number].start + tick]
        depth = np.asarray(item[image_column(self.camera) + DEPTH_SUFFIX]).squeeze()
        colour = item.get(image_column(self.camera))
        if colour is not None:
            colour = np.rint(np.asarray(colour).transpose(1, 2, 0) * 255.0).astype(np.uint8)
        return colour, depth.round().astype(np.uint16)


def _targets(sent: NDArray[np.float32], state: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns accepted targets, or the tool pose before the first accepted target."""
    rotation = sent[:, schema.ROTATION_DIMS].reshape(-1, 2, 3)
    known = np.isfinite(sent).all(axis=1) & (np.abs(np.linalg.norm(rotation, axis=2) - 1.0) < _ROTATION_OFF).all(axis=1)
    return np.where(known[:, None], sent, state[:, : schema.ACTION_DIM]).astype(np.float32)


def _unusable(root: Path, got: str, allowed: str, hint: str) -> DatasetError:
    what = f"{root.name} cannot be converted to key frames."
    return DatasetError(what, got=got, allowed=allowed, hint=hint)
