"""What the simulator lets an environment see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import Feedback
from lerobot_adamanip.contract.pointcloud import Cloud


@dataclass(frozen=True)
class SimObservation:
    """One moment of the simulator.

    Attributes:
        image: (H, W, 3) of the front camera; None if none was asked for.
        points_in_base: (M, 3) [m] what the camera sees, robot base frame, in scan order: at least all in the workspace.
        qpos: (7,) arm joint positions [rad].
        qvel: (7,) arm joint velocities [rad/s].
        effort: (7,) external joint torque of the arm [N m].
        feedback: what was felt at the latest key frame.
    """

    image: NDArray[np.uint8] | None
    points_in_base: Cloud
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    effort: NDArray[np.float64]
    feedback: Feedback


@dataclass(frozen=True)
class CameraParameters:
    """Of the front camera.

    Attributes:
        intrinsics: (3, 3) [px].
        camera_in_base: (4, 4) pose in the robot's base frame, OpenCV axes [m].
        width, height: of the image [px].
    """

    intrinsics: NDArray[np.float64]
    camera_in_base: NDArray[np.float64]
    width: int
    height: int

    def to_json(self) -> dict[str, Any]:
        """Returns ``intrinsics``, ``extrinsics``, ``width`` and ``height`` as lists and numbers."""
        return {
            "intrinsics": self.intrinsics.tolist(),
            "extrinsics": self.camera_in_base.tolist(),
            "width": self.width,
            "height": self.height,
        }
