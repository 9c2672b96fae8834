"""Frames of depth cameras, and their calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.arm_process.encoding import message


@message
@dataclass(frozen=True)
class Frame:
    """One exposure.

    Attributes:
        stamp: when it was exposed, `time.perf_counter()` [s]; never later than ``arrival``.
        arrival: when it reached this process [s, same clock].
        color: (H, W, 3) uint8 RGB; None where not asked for.
        depth: (H, W) uint16 millimetres, 0 where nothing was seen; None where not asked for.
        number: counts the exposures of a camera; a gap is a dropped one.
    """

    stamp: float
    arrival: float
    color: NDArray[np.uint8] | None
    depth: NDArray[np.uint16] | None
    number: int


@dataclass(frozen=True)
class Intrinsics:
    """Projection of an imager, OpenCV's model.

    Attributes:
        matrix: (3, 3) [px].
        distortion: 0, 5 or 8 coefficients, OpenCV's order.
        width, height: of the picture they belong to [px].
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    width: int
    height: int


@dataclass(frozen=True)
class CameraCalibration:
    """Pose and projection of a camera, which turn its depth into a cloud.

    Attributes:
        camera: serial number or name.
        depth: of the imager of depth; colour is registered to it or not used.
        depth_in_base: (4, 4) pose of that imager, robot base frame, OpenCV axes [m]; None for a camera on the hand.
        depth_in_tcp: likewise in the tool's frame, for a camera on the hand; None otherwise.
        color: of the colour imager, if it was calibrated.
        depth_in_color: (4, 4) pose of the depth imager in the colour imager's frame [m]; identity if they are one.
    """

    camera: str
    depth: Intrinsics
    depth_in_base: NDArray[np.float64] | None
    depth_in_tcp: NDArray[np.float64] | None = None
    color: Intrinsics | None = None
    depth_in_color: NDArray[np.float64] | None = None


def simulated_calibration(camera: Mapping[str, Any], name: str = "simulated") -> CameraCalibration:
    """Returns the calibration of a simulated camera, colour and depth being one picture.

    Its principal point counts from the picture's corner, OpenCV's from the middle of the first pixel: without the half
    pixel, the cloud is 1.5 mm beside the scene.

    Args:
        camera: ``intrinsics`` (3, 3) [px], ``extrinsics`` (4, 4) pose in the base frame, OpenCV axes [m], ``width`` and
            ``height`` [px].
        name: of the camera.
    """
    matrix = np.array(camera["intrinsics"], np.float64)
    matrix[:2, 2] -= 0.5
    imager = Intrinsics(matrix, np.zeros(0), int(camera["width"]), int(camera["height"]))
    pose = np.array(camera["extrinsics"], np.float64)
    return CameraCalibration(name, imager, pose, color=imager, depth_in_color=np.eye(4))
