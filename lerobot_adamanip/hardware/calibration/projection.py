"""From points before a camera to pixels: OpenCV's model, for thousands of points at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.camera_frames import Intrinsics

Array = NDArray[np.float64]


def project(points_in_camera: Array, intrinsics: Intrinsics) -> Array:
    """Points (K, 3) [m] -> pixels (K, 2); what is not before the camera lands far outside of any picture."""
    depth = np.maximum(points_in_camera[:, 2], 1e-3)
    x, y = points_in_camera[:, 0] / depth, points_in_camera[:, 1] / depth
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([intrinsics.distortion, np.zeros(8)])[:8]
    square = x * x + y * y
    radial = (1 + square * (k1 + square * (k2 + square * k3))) / (1 + square * (k4 + square * (k5 + square * k6)))
    bent = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )
    matrix = intrinsics.matrix
    return np.asarray(bent * matrix[[0, 1], [0, 1]] + matrix[:2, 2])
