"""Cameras of the simulated environments: one row each. A second camera is a second row, here."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lerobot_adamanip.contract.schema import FRONT_IMAGE


@dataclass(frozen=True)
class CameraView:
    """A camera that stands still.

    Attributes:
        column: of its pictures in datasets.
        eye, target: where it is and what it looks at, robot base frame [m]; both are drawn around these.
        field_of_view: [rad].
    """

    column: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float


FRONT = "front"
"""Camera whose depth makes the cloud, and which `render` shows."""
CAMERAS = {
    # Third person, beside and above the arm (paper: one camera adjacent to the robot).
    FRONT: CameraView(FRONT_IMAGE, (0.0, -0.58, 1.16), (0.60, 0.02, 0.70), math.radians(52)),
}
"""Name in observations (``pixels``) -> camera. A row's draws follow those of the rows before it."""
