"""Cameras of the simulated environments, one row each, used for observations and datasets."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from lerobot_adamanip.util.errors import ConfigurationError


@dataclass(frozen=True)
class CameraView:
    """A camera, at rest in the scene or mounted on a link of the arm.

    Attributes:
        eye, target: nominal position and point of view, in ``link``'s frame [m]; each scene draws poses around them.
        field_of_view: [rad].
        link: link of the arm that carries the camera; empty for the robot's base, which rests.
        up: direction in ``link``'s frame that is up in images.
        spread: share of the scene's random shift of cameras: a mount is more exact than a tripod.
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float
    link: str = ""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    spread: float = 1.0


FRONT = "front"
"""Camera whose depth gives the cloud, and which `render` shows."""
WRIST = "wrist"
"""Camera on the hand, which sees the fingers and what they hold."""
HAND = "panda_hand"
"""Link of the Franka Hand: z to the fingertips, 0.1034 m away at the tool's centre, y along the fingers' motion."""
TOOL = "panda_hand_tcp"
"""Link at the tool's centre, with the axes of the hand."""
CAMERAS = {
    # Third person, beside and above the arm (paper: one camera adjacent to the robot).
    FRONT: CameraView((0.0, -0.58, 1.16), (0.60, 0.02, 0.70), math.radians(52)),
    # Where a RealSense is mounted on a Franka Hand (ManiSkill's panda_wristcam), tilted to the fingers, with the field
    # of view of robosuite's cameras in the hand.
    WRIST: CameraView((0.065, 0.0, 0.03), (0.02, 0.0, 0.20), math.radians(75), HAND, (1.0, 0.0, 0.0), 0.1),
}
"""Name in observations (``pixels``) -> camera. A row's random draws follow those of earlier rows."""
PIXEL_CONVENTION = "opencv"
"""Pixel coordinates of all stored intrinsics, as OpenCV has them: x right, y down, (0, 0) at the first pixel's centre.

The middle of a picture is (size - 1) / 2. Resizing by a factor s moves a coordinate c to (c + 0.5) s - 0.5.
"""
_COLUMNS = "observation.images."
_CAMERA_NAME = re.compile(r"[A-Za-z0-9_]+")


def image_column(camera: str) -> str:
    """Returns the dataset column of a camera's images."""
    return f"{_COLUMNS}{camera}"


def is_image_column(column: str) -> bool:
    """Returns whether a dataset column holds a camera's images."""
    return column.startswith(_COLUMNS)


def camera_names(cameras: Sequence[str], names: Sequence[str] | None) -> dict[str, str]:
    """Returns camera -> its name in observations: ``names`` in the order of the cameras, or their own.

    Raises:
        ConfigurationError: not one name per camera, a name twice, or another character than letters, digits and _.
    """
    names = cameras if names is None else [names] if isinstance(names, str) else names
    if len({*names}) != len(names) or len(names) != len(cameras) or not all(map(_CAMERA_NAME.fullmatch, names)):
        raise ConfigurationError(
            "Wrong names of cameras.",
            got=f"camera_names {list(names)} of the cameras {list(cameras)}",
            allowed="one name per camera, all different, of letters, digits and _",
            hint="--env.cameras='[front,wrist]' --env.camera_names='[camera1,camera2]'",
        )
    return dict(zip(cameras, names, strict=True))
