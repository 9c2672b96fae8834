"""Camera images of the robot's observation."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from lerobot.cameras.camera import Camera
from numpy.typing import NDArray

from lerobot_adamanip.hardware.cameras.base import FrameReader, max_latency
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

ARRIVAL_STAMPED = frozenset(("OpenCVCamera", "RealSenseCamera"))
"""LeRobot's cameras of this machine. They stamp pictures (``latest_timestamp``) when these arrive."""
POLL_S = 0.005


def camera_features(cameras: dict[str, Camera], *, depth: bool) -> dict[str, tuple[int, int, int]]:
    """Returns image shapes by name: colour under the camera's key, depth, if wanted, under the key with a suffix."""
    features: dict[str, tuple[int, int, int]] = {}
    for key, camera in cameras.items():
        if getattr(camera, "use_rgb", True):
            features[key] = (camera.height, camera.width, 3)
        if depth and getattr(camera, "use_depth", False):
            features[f"{key}{DEPTH_SUFFIX}"] = (camera.height, camera.width, 1)
    return features


def check_cameras(cameras: Mapping[str, Camera], *, key_frames: bool) -> None:
    """Checks that the cameras can deliver what the robot promises.

    Raises:
        ConfigurationError: a camera has depth in unknown units, or, with key frames, no exposure time.
    """
    for key, camera in cameras.items():
        if isinstance(camera, FrameReader):
            continue
        if getattr(camera, "use_depth", False):
            raise ConfigurationError(
                f"The depth of camera {key} cannot be used.",
                got=f"{type(camera).__name__}: raw counts of the sensor (0.1 mm on a D405), without exposure times",
                allowed="depth in millimetres, of the same exposure as the colour",
                hint=f'--robot.cameras with "type": "adamanip_realsense", or "use_depth": false for {key}',
            )
        if key_frames and not ARRIVAL_STAMPED & {cls.__name__ for cls in type(camera).__mro__}:
            raise ConfigurationError(
                f"Camera {key} does not report whether a picture was taken after a key frame.",
                got=f"{type(camera).__name__} with execution=keyframe",
                allowed=f"a FrameReader of this project, {', '.join(sorted(ARRIVAL_STAMPED))}",
                hint="--robot.execution=stream, or another camera",
            )


def pictures(key: str, camera: Camera, *, max_age: float, after: float | None) -> dict[str, NDArray[Any]]:
    """Returns a camera's images by name. A `FrameReader` returns colour and depth of one exposure.

    Args:
        key: camera key.
        camera: connected camera that `check_cameras` accepts.
        max_age: maximum age of a frame [s], and maximum wait for one.
        after: time at which the arm came to rest, `time.perf_counter()` [s]. Returns a frame exposed after it;
            None returns the latest.

    Raises:
        RobotError: the camera is frozen or has failed. LeRobot's own cameras raise TimeoutError instead.
    """
    if not isinstance(camera, FrameReader):
        if after is not None:
            _wait_for_arrival(key, camera, after, max_age)
        return {key: camera.read_latest(int(max_age * 1000))}
    if after is None:
        frame = camera.latest_frame(max_age)
    else:
        frame = camera.frame_after(max(after, time.perf_counter() - max_age), max_age)
    images: dict[str, NDArray[Any]] = {}
    if camera.use_rgb and frame.color is not None:
        images[key] = frame.color
    if camera.use_depth and frame.depth is not None:
        images[f"{key}{DEPTH_SUFFIX}"] = frame.depth[..., None]
    return images


def _wait_for_arrival(key: str, camera: Any, rest: float, timeout: float) -> None:
    """Waits until the camera's latest picture arrived so late that it was exposed after ``rest``.

    Raises:
        RobotError: no such picture arrived within ``timeout`` [s] of the earliest time.
    """
    earliest = rest + max_latency(camera.fps)
    until = max(earliest, time.perf_counter()) + timeout
    while (camera.latest_timestamp or float("-inf")) < earliest:
        if time.perf_counter() > until:
            raise RobotError(
                f"Camera {key}: it is frozen.",
                got=f"no picture that was taken after the arm came to rest, for {timeout:g} s",
                allowed="pictures at its rate",
                hint="check cable and port; a larger --robot.camera_age waits longer",
            )
        time.sleep(POLL_S)
