"""Observation of the robot: scalars by name, and the cameras' pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.cameras.base import FrameReader
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, SCALAR_NAMES

NO_OUTCOME = -1.0
MAX_SKEW = 0.05
"""Largest distance in time of a picture and a state of one moment [s]: 5 mm at the arm's 0.1 m/s."""


@dataclass
class SkewWatch:
    """Counts the rows of one camera whose picture is not of the state's moment."""

    rows: int = 0
    skewed: int = 0
    worst: float = 0.0

    def count(self, frame_stamp: float, state_stamp: float) -> None:
        """Counts a row by the stamps of its frame and its state [s, same clock]."""
        skew = abs(frame_stamp - state_stamp)
        self.rows, self.skewed = self.rows + 1, self.skewed + (skew > MAX_SKEW)
        self.worst = max(self.worst, skew)

    def __str__(self) -> str:
        share = f"{self.skewed} of {self.rows} rows"
        return f"{share} skewed by more than {1e3 * MAX_SKEW:.0f} ms, at worst {1e3 * self.worst:.0f} ms"


def camera_features(cameras: dict[str, Camera]) -> dict[str, tuple[int, int, int]]:
    """Returns the pictures' shapes by name: colour under a camera's key, depth under that and a suffix."""
    features: dict[str, tuple[int, int, int]] = {}
    for key, camera in cameras.items():
        if getattr(camera, "use_rgb", True):
            features[key] = (camera.height, camera.width, 3)
        if getattr(camera, "use_depth", False):
            features[f"{key}{DEPTH_SUFFIX}"] = (camera.height, camera.width, 1)
    return features


def scalars(reading: ArmReading, sent: NDArray[np.float32], connected: float, success: bool) -> dict[str, float]:
    """Returns all scalars by name, in the order of `features.SCALAR_NAMES`.

    Args:
        reading: of the arm.
        sent: (10,) last accepted target.
        connected: when the robot was connected, `time.perf_counter()` [s].
        success: of the task, by the operator or the twin.
    """
    pose = pose_vector(reading.tcp_in_base, reading.gripper)
    outcome = NO_OUTCOME if reading.outcome is None else float(reading.outcome)
    parts = (pose, reading.qpos, reading.qvel, reading.effort, sent, (outcome, reading.stamp - connected, success))
    values = np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])
    return dict(zip(SCALAR_NAMES, values.tolist(), strict=True))


def pictures(
    key: str, camera: Camera, reading: ArmReading, skew: SkewWatch | None, *, max_age: float, after: float | None
) -> dict[str, NDArray[Any]]:
    """Returns a camera's pictures by name, of one exposure if it is a `FrameReader`.

    Args:
        key: of the camera.
        camera: connected.
        reading: of the same observation.
        skew: counts; None where pictures and states are of one moment by construction.
        max_age: of a frame [s].
        after: the arm is at rest since then, and the frame exposed after it (`time.perf_counter()`, [s]); None takes
            the latest.

    Raises:
        RobotError: the camera is frozen or has failed; LeRobot's own cameras raise TimeoutError.
    """
    found: dict[str, NDArray[Any]] = {}
    if isinstance(camera, FrameReader):
        frame = camera.latest_frame(max_age)
        if after is not None and frame.stamp < after:
            frame = camera.frame_after(after)
        if skew is not None:
            skew.count(frame.stamp, reading.stamp)
        if camera.use_rgb and frame.color is not None:
            found[key] = frame.color
        if camera.use_depth and frame.depth is not None:
            found[f"{key}{DEPTH_SUFFIX}"] = frame.depth[..., None]
        return found
    if getattr(camera, "use_rgb", True):
        found[key] = camera.async_read() if after is not None else camera.read_latest(int(max_age * 1000))
    if getattr(camera, "use_depth", False):
        found[f"{key}{DEPTH_SUFFIX}"] = camera.read_latest_depth(int(max_age * 1000))
    return found
