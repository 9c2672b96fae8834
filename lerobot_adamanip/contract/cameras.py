"""Cameras of the simulated environments, one row each, used for observations and datasets."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class CameraView:
    """A fixed camera.

    Attributes:
        eye, target: nominal position and point of view, robot base frame [m]; each scene draws poses around them.
        field_of_view: [rad].
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float


FRONT = "front"
"""Camera whose depth gives the cloud, and which `render` shows."""
CAMERAS = {
    # Third person, beside and above the arm (paper: one camera adjacent to the robot).
    FRONT: CameraView((0.0, -0.58, 1.16), (0.60, 0.02, 0.70), math.radians(52)),
}
"""Name in observations (``pixels``) -> camera. A row's random draws follow those of earlier rows."""
PIXEL_CONVENTION = "opencv"
"""Pixel coordinates of all stored intrinsics, as OpenCV has them: x right, y down, (0, 0) at the first pixel's centre.

The middle of a picture is (size - 1) / 2. Resizing by a factor s moves a coordinate c to (c + 0.5) s - 0.5.
"""
_COLUMNS = "observation.images."


def image_column(camera: str) -> str:
    """Returns the dataset column of a camera's images."""
    return f"{_COLUMNS}{camera}"


def is_image_column(column: str) -> bool:
    """Returns whether a dataset column holds a camera's images."""
    return column.startswith(_COLUMNS)
