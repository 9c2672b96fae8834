"""Observation of the robot: named scalars and camera images."""

from __future__ import annotations

from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.cameras.base import FrameReader
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, SCALAR_NAMES

NO_OUTCOME = -1.0


def camera_features(cameras: dict[str, Camera]) -> dict[str, tuple[int, int, int]]:
    """Returns image shapes by name: colour under the camera's key, depth under the key with a suffix."""
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
        reading: arm reading.
        sent: (10,) last accepted target.
        connected: connection time of the robot, `time.perf_counter()` [s].
        success: task success, from the operator or the twin.
    """
    pose = pose_vector(reading.tcp_in_base, reading.gripper)
    outcome = NO_OUTCOME if reading.outcome is None else float(reading.outcome)
    parts = (pose, reading.qpos, reading.qvel, reading.effort, sent, (outcome, reading.stamp - connected, success))
    values = np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])
    return dict(zip(SCALAR_NAMES, values.tolist(), strict=True))


def pictures(key: str, camera: Camera, *, max_age: float, after: float | None) -> dict[str, NDArray[Any]]:
    """Returns a camera's images by name. A `FrameReader` returns colour and depth of one exposure.

    Args:
        key: camera key.
        camera: connected camera.
        max_age: maximum age of a frame [s].
        after: time at which the arm came to rest, `time.perf_counter()` [s]. Returns a frame exposed after it;
            None returns the latest.

    Raises:
        RobotError: the camera is frozen or has failed. LeRobot's own cameras raise TimeoutError instead.
    """
    found: dict[str, NDArray[Any]] = {}
    if isinstance(camera, FrameReader):
        frame = camera.latest_frame(max_age)
        if after is not None and frame.stamp < after:
            frame = camera.frame_after(after)
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
