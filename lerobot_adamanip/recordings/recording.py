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
from lerobot_adamanip.contract.dense_codec import pose_of_delta
from lerobot_adamanip.contract.memory import instruction_of
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, read_calibrations
from lerobot_adamanip.hardware.features import (
    ARM,
    CALIBRATIONS,
    CAMERA_NAMES,
    DEPTH_SUFFIX,
    FRONT_CAMERA,
    INTERVENTION,
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
                f"{schema.STATE} and {schema.ACTION} with the names of `lerobot_adamanip.contract.control`",
                "lerobot-record --robot.type=adamanip_franka",
            )
        depth = image_column(camera) + DEPTH_SUFFIX
        if depth not in dataset.features:
            pictures = [key for key in dataset.features if is_image_column(key)]
            hint = "--camera with a depth camera; lerobot-record --robot.depth=true"
            raise _unusable(dataset.root, f"pictures {pictures}", depth, hint)
        recording = cls(dataset, camera)
        if not set(schema.STATE_NAMES) <= set(recording._names):
            names = f"{schema.STATE} with {', '.join(recording._names)}"
            raise _unusable(dataset.root, names, f"a column {ARM}", "lerobot-record --robot.state=full")
        return recording

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

    def calibration_of(self, number: int, calibration: CameraCalibration) -> CameraCalibration:
        """Returns the calibration with the camera's pose in an episode, if its rows hold one: the latest."""
        if self.camera != FRONT_CAMERA or not set(CAMERA_NAMES) <= set(self._names):
            return calibration
        columns = self.dataset.columns(self.dataset.episode(number))
        pose = columns[ARM][-1, [self._names.index(name) for name in CAMERA_NAMES]]
        return calibration.at(pose_from_vector([*pose, 0.0])[0]) if pose.any() else calibration

    def __len__(self) -> int:
        return len(self.dataset)

    def episode(self, number: int) -> DenseEpisode:
        """Returns an episode's columns. Raises `DatasetError` for values that are not finite."""
        episode = self.dataset.episode(number)
        columns = self.dataset.columns(episode)
        readings = columns[ARM if ARM in columns else schema.STATE]
        names = self._names

        def numbers(selected: Sequence[str], default: float) -> NDArray[np.float32]:
            if not set(selected) <= set(names):
                return np.full((len(readings), len(selected)), default, np.float32)
            return readings[:, [names.index(name) for name in selected]].astype(np.float32, copy=False)

        state, effort = numbers(schema.STATE_NAMES, np.nan), numbers(schema.EFFORT_NAMES, 0.0)
        if not np.isfinite(state).all() or not np.isfinite(effort).all() or len(state) < 2:
            got = f"episode {number}: {len(state)} ticks, NaN or infinity in the arm's state or effort"
            raise _unusable(self.root, got, "two ticks or more, finite", "lerobot-edit-dataset to delete it")
        requested = self._targets(columns[schema.ACTION].astype(np.float32, copy=False), state)
        sent = numbers(SENT_NAMES, np.nan) if SENT_NAMES[0] in names else self._accepted(requested, state[0, :10])
        success, corrected = columns.get(schema.SUCCESS, np.zeros(len(state))), columns.get(INTERVENTION)
        return DenseEpisode(
            state=state,
            effort=effort,
            sent=_known_targets(sent, state),
            stamp=numbers([STAMP_NAME], 0.0)[:, 0].astype(np.float64),
            outcome=np.rint(numbers([OUTCOME_NAME], -1.0)[:, 0]).astype(np.int64),
            success=success.reshape(-1) > 0.5,
            task=instruction_of(self.dataset.tasks[int(columns["task_index"][0])]),
            asked=requested,
            corrected=None if corrected is None else corrected.reshape(-1).astype(bool),
        )

    @property
    def _names(self) -> list[str]:
        """Names of the arm's numbers: in the column `ARM`, or in the state of a recording without it."""
        return names_of(self.dataset.features.get(ARM, self.dataset.features[schema.STATE]))

    def _targets(self, actions: NDArray[np.float32], state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns the requested targets (T, 10) of actions of either kind."""
        names = names_of(self.dataset.features[schema.ACTION])
        if not set(schema.POSE_NAMES) <= set(names):
            poses = [pose_from_vector(row[: schema.ACTION_DIM])[0] for row in state]
            return np.stack([pose_of_delta(action, pose) for action, pose in zip(actions, poses, strict=True)])
        return actions[:, [names.index(name) for name in schema.POSE_NAMES]]

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

    @cached_property
    def has_success(self) -> bool:
        """Whether any episode reports a success, by the success key or a twin. Then the others are no successes."""
        return any(self.episode(number).success.any() for number in range(len(self)))

    def pictures(self, number: int, tick: int) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint16]]:
        """Returns the colour (H, W, 3), if recorded, and depth (H, W) [mm] of a tick."""
        item = self._frames[self.dataset.episodes[number].start + tick]
        depth = np.asarray(item[image_column(self.camera) + DEPTH_SUFFIX]).squeeze()
        colour = item.get(image_column(self.camera))
        if colour is not None:
            colour = np.rint(np.asarray(colour).transpose(1, 2, 0) * 255.0).astype(np.uint8)
        return colour, depth.round().astype(np.uint16)


def _known_targets(sent: NDArray[np.float32], state: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns accepted targets, or the tool pose before the first accepted target."""
    rotation = sent[:, schema.ROTATION_DIMS].reshape(-1, 2, 3)
    known = np.isfinite(sent).all(axis=1) & (np.abs(np.linalg.norm(rotation, axis=2) - 1.0) < _ROTATION_OFF).all(axis=1)
    return np.where(known[:, None], sent, state[:, : schema.ACTION_DIM]).astype(np.float32)


def _unusable(root: Path, got: str, allowed: str, hint: str) -> DatasetError:
    what = f"{root.name} cannot be converted to key frames."
    return DatasetError(what, got=got, allowed=allowed, hint=hint)
