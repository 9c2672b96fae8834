"""Frames of depth cameras, and their calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import PIXEL_CONVENTION
from lerobot_adamanip.hardware.arm_process.encoding import message
from lerobot_adamanip.util.errors import ConfigurationError


@message
@dataclass(frozen=True)
class Frame:
    """One camera exposure.

    Attributes:
        stamp: exposure time, `time.perf_counter()` [s]; never later than ``arrival``.
        arrival: arrival time in this process [s, same clock].
        color: (H, W, 3) uint8 RGB; None if disabled.
        depth: (H, W) uint16 [mm], 0 for invalid pixels; None if disabled.
        number: exposure counter of the camera; a gap means dropped frames.
    """

    stamp: float
    arrival: float
    color: NDArray[np.uint8] | None
    depth: NDArray[np.uint16] | None
    number: int


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of an imager in OpenCV's model.

    Attributes:
        matrix: (3, 3) camera matrix [px].
        distortion: 0, 5 or 8 coefficients in OpenCV's order.
        width, height: image size of these intrinsics [px].
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    width: int
    height: int


@dataclass(frozen=True)
class CameraCalibration:
    """Calibration of a camera: pose and intrinsics that turn its depth into a point cloud.

    Attributes:
        camera: serial number or name.
        depth: intrinsics of the depth imager; colour is registered to it or not used.
        depth_in_base: (4, 4) pose of the depth imager, base frame, OpenCV axes [m]; None for a camera on the hand.
        depth_in_tcp: (4, 4) pose in the tool frame for a camera on the hand [m]; None otherwise.
        color: intrinsics of the colour imager, if it was calibrated.
        depth_in_color: (4, 4) pose of the depth imager in the colour frame [m]; identity if they are the same.
    """

    camera: str
    depth: Intrinsics
    depth_in_base: NDArray[np.float64] | None
    depth_in_tcp: NDArray[np.float64] | None = None
    color: Intrinsics | None = None
    depth_in_color: NDArray[np.float64] | None = None


def simulated_calibration(camera: Mapping[str, Any], name: str = "simulated") -> CameraCalibration:
    """Returns the calibration of a simulated camera, which has one imager for colour and depth.

    Args:
        camera: ``intrinsics`` (3, 3) [px], ``extrinsics`` (4, 4) pose in the base frame, OpenCV axes [m], ``width`` and
            ``height`` [px], ``convention`` of the pixel coordinates.
        name: camera name.

    Raises:
        ConfigurationError: other pixel coordinates, or unnamed ones. Half a pixel moves the cloud by 1.5 mm.
    """
    if (convention := camera.get("convention")) != PIXEL_CONVENTION:
        raise ConfigurationError(
            "The intrinsics of a camera have unknown pixel coordinates.",
            got=f"convention={convention!r}",
            allowed=f"{PIXEL_CONVENTION!r}: the centre of the first pixel is (0, 0)",
            hint="data of this version",
        )
    matrix = np.array(camera["intrinsics"], np.float64)
    imager = Intrinsics(matrix, np.zeros(0), int(camera["width"]), int(camera["height"]))
    pose = np.array(camera["extrinsics"], np.float64)
    return CameraCalibration(name, imager, pose, color=imager, depth_in_color=np.eye(4))
