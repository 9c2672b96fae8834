"""Pinhole cameras: rays, projections and calibration, without a renderer."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import PIXEL_CONVENTION
from lerobot_adamanip.contract.pointcloud import Cloud

if TYPE_CHECKING:
    from mani_skill.sensors.camera import CameraConfig

Pose = NDArray[np.float64]
OPENCV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])
GL_FROM_BODY = np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Transform between an OpenGL camera and SAPIEN's camera body, which looks along x with z up."""
_BEHIND = 1e-3
"""Minimum depth of points for projection [m]."""
_EDGE = 0.01
"""Margin around an image's edge [m]."""


@dataclass(frozen=True)
class PinholeCamera:
    """A square camera with a centred principal point; x right, y up, looking along -z.

    It has a pose (4, 4) in the world, ``size`` pixels along a side, and a focal length [px].
    """

    pose: Pose
    size: int
    focal: float

    @functools.cached_property
    def world_to_camera(self) -> Pose:
        """Transform (4, 4) from world to camera frame."""
        inverse: Pose = np.linalg.inv(self.pose).astype(np.float64, copy=False)
        return inverse

    def rays(self, beside: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
        """Returns the directions (size^2, 3) of all pixels in scan order, in the camera frame, with depth 1.

        ``beside`` is the offset to the right of and below the pixel's middle [px].
        """
        across, down = ((np.arange(self.size) + 0.5 - self.size / 2 + shift) / self.focal for shift in beside)
        columns, rows = np.meshgrid(across, -down)
        return np.stack([columns.ravel(), rows.ravel(), np.full(columns.size, -1.0)], axis=1)

    def may_see(self, points: NDArray[np.float64], pose: Pose) -> bool:
        """Returns False if a body lies completely outside of the image.

        ``points`` (N, 3) are corners of its convex hull in its own frame [m], ``pose`` (4, 4) is its pose in the world.
        """
        in_camera = self.world_to_camera @ pose
        x, y, z = (points @ in_camera[:3, :3].T + in_camera[:3, 3]).T
        half = -z * (0.5 * self.size / self.focal) + _EDGE
        beside = x > half, x < -half, y > half, y < -half, z > _EDGE
        return not any(side.all() for side in beside)

    def rectangles(self, corners_in_camera: NDArray[np.float64]) -> NDArray[np.int64]:
        """Returns the pixels that may see each of M boxes: (M, 4) with first row, first column, end row, end column.

        The boxes are given by their eight corners, box by box: (8 M, 3) [m], camera frame.
        """
        depth = -corners_in_camera[:, 2]
        # One more pixel on each side, because rays pass through the middles of pixels.
        scale = self.focal / np.maximum(depth, _BEHIND)
        rows = (self.size / 2 - scale * corners_in_camera[:, 1]).reshape(-1, 8)
        columns = (self.size / 2 + scale * corners_in_camera[:, 0]).reshape(-1, 8)
        edges = np.stack([rows.min(1) - 1, columns.min(1) - 1, rows.max(1) + 2, columns.max(1) + 2], axis=1)
        edges[depth.reshape(-1, 8).min(1) < _BEHIND] = (0, 0, self.size, self.size)
        return np.clip(edges, 0, self.size).astype(np.int64)


def pinhole(config: CameraConfig) -> PinholeCamera:
    """Returns ManiSkill's camera for a configuration."""
    pose = config.pose.sp.to_transformation_matrix().astype(np.float64) @ GL_FROM_BODY
    return PinholeCamera(pose, config.width, 0.5 * config.width / np.tan(0.5 * config.fov))


def points_in_world(points: Cloud, camera_in_world: NDArray[Any]) -> Cloud:
    """Transforms points (M, 3) from a camera's frame to the world by its pose (4, 4). Rounds all clouds alike."""
    rotation, position = camera_in_world[:3, :3].astype(np.float32), camera_in_world[:3, 3].astype(np.float32)
    return points @ rotation.T + position


def camera_parameters(camera: PinholeCamera) -> dict[str, Any]:
    """Returns a camera's calibration as a JSON-serialisable dictionary; the robot's base is the world's origin.

    Keys: ``intrinsics`` (3, 3) [px], ``extrinsics`` (4, 4) pose in the robot's base frame, OpenCV axes [m], ``width``
    and ``height`` [px], ``convention`` (`PIXEL_CONVENTION`).
    """
    focal, middle = float(camera.focal), 0.5 * (camera.size - 1)
    return {
        "convention": PIXEL_CONVENTION,
        "intrinsics": [[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]],
        "extrinsics": (camera.pose @ OPENCV_FROM_GL).tolist(),
        "width": camera.size,
        "height": camera.size,
    }
