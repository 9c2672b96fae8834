"""The calibration of a simulated camera, of which everything is known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics


def simulated_calibration(camera: Mapping[str, Any], name: str = "simulated") -> CameraCalibration:
    """Returns the calibration of a camera that simulated episodes tell of, colour and depth being one picture.

    Their principal point counts from the picture's corner, so that a pixel's middle is half a pixel further; OpenCV
    counts from the middle of the first pixel. Taken for OpenCV's, the cloud is 1.5 mm beside the scene.

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
