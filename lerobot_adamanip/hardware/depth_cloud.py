"""Converts a depth picture to a point cloud, with the same points and order as the simulator's camera.

Each pixel gives one point. Larger pictures are subsampled, so real and simulated clouds start from as many points.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.observation import workspace_cloud
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Cloud, Workspace, depth_size
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.util.errors import ConfigurationError

NOTHING_SEEN = 15.0
"""Maximum depth that counts as invalid [mm]: LeRobot's default depth video turns 0 into 10."""
JUMP = 20.0
"""Maximum depth difference of neighbours on one surface [mm]."""

Depth = NDArray[np.uint16] | NDArray[np.float32]


def depth_cloud(
    depth: Depth,
    calibration: CameraCalibration,
    num_points: int,
    workspace: Workspace = DEFAULT_WORKSPACE,
    tcp_in_base: NDArray[np.float64] | None = None,
) -> Cloud:
    """Returns the cloud (num_points, 3) [m], robot base frame, farthest point first; see `workspace_cloud`.

    Args:
        depth: (H, W) [mm], 0 for invalid pixels.
        calibration: calibration of the camera.
        num_points: number of points in the cloud.
        workspace: points outside are dropped.
        tcp_in_base: (4, 4) tool pose at the exposure, for a camera on the hand.

    Raises:
        ConfigurationError: the picture size differs from the calibration, or the tool pose is missing.
    """
    stride = max(1, round(depth.shape[0] / depth_size(num_points)))
    return workspace_cloud(points_in_base(depth, calibration, stride, tcp_in_base), workspace, num_points)


def points_in_base(
    depth: Depth,
    calibration: CameraCalibration,
    stride: int = 1,
    tcp_in_base: NDArray[np.float64] | None = None,
) -> Cloud:
    """Returns points (M, 3) [m], base frame, scan order, of every ``stride``-th pixel. See `depth_cloud`."""
    intrinsics = calibration.depth
    if depth.shape != (intrinsics.height, intrinsics.width):
        raise ConfigurationError(
            f"The depth of camera {calibration.camera} has another size than its calibration.",
            got=f"{depth.shape[1]} x {depth.shape[0]}",
            allowed=f"{intrinsics.width} x {intrinsics.height}",
            hint="the width and height that the camera had when it was calibrated",
        )
    camera_in_base = calibration.depth_in_base
    if camera_in_base is None:
        if calibration.depth_in_tcp is None or tcp_in_base is None:
            raise ConfigurationError(
                f"The pose of camera {calibration.camera} is unknown.",
                got="no pose" if calibration.depth_in_tcp is None else "a camera on the hand, and no pose of the tool",
                allowed="its pose in the robot's base, or on the tool with the tool's pose",
                hint="adamanip calibrate views --record robot.json --out FILE",
            )
        camera_in_base = tcp_in_base @ calibration.depth_in_tcp
    start = (stride - 1) // 2
    chosen = np.asarray(depth[start::stride, start::stride], np.float32)
    kept = np.flatnonzero(on_a_surface(depth, stride))
    matrix, lens = (np.asarray(part, np.float64).tobytes() for part in (intrinsics.matrix, intrinsics.distortion))
    rays = _rays(matrix, lens, depth.shape, stride)
    points = rays.take(kept, axis=0) * (chosen.ravel().take(kept) * np.float32(1e-3))[:, None]
    rotation, position = camera_in_base[:3, :3].astype(np.float32), camera_in_base[:3, 3].astype(np.float32)
    return np.asarray(points @ rotation.T + position, np.float32)


def on_a_surface(depth: Depth, stride: int = 1) -> NDArray[np.bool_]:
    """Returns a mask (h, w) of every ``stride``-th pixel of a depth image [mm] that is on a surface.

    It excludes pixels that differ from all neighbours, and flying pixels: nearer than one neighbour and farther than
    the opposite one by more than `JUMP`. Thin objects, nearer than both sides, stay.
    """
    start, (height, width) = (stride - 1) // 2, depth.shape
    padded = np.zeros((height + 2, width + 2), np.float32)
    padded[1:-1, 1:-1] = depth

    def beside(down: int, right: int) -> NDArray[np.float32]:
        return padded[1 + start + down : height + 1 + down : stride, 1 + start + right : width + 1 + right : stride]

    middle = beside(0, 0)
    seen = np.asarray(middle > NOTHING_SEEN)
    flying, alone = np.zeros_like(seen), np.ones_like(seen)
    for down, right in ((0, 1), (1, 0)):
        before, after = beside(-down, -right), beside(down, right)
        nearer = [side - middle > JUMP for side in (before, after)]
        farther = [middle - side > JUMP for side in (before, after)]
        between = (nearer[0] & farther[1]) | (farther[0] & nearer[1])
        flying |= between & (before > NOTHING_SEEN) & (after > NOTHING_SEEN)
        alone &= (nearer[0] | farther[0]) & (nearer[1] | farther[1])
    return np.asarray(seen & ~flying & ~alone)


@functools.lru_cache(maxsize=8)
def _rays(matrix: bytes, distortion: bytes, shape: tuple[int, int], stride: int) -> NDArray[np.float32]:
    """Returns undistorted rays (h * w, 3) of depth one through the pixel centres, in scan order."""
    camera, lens = np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion)
    rows, columns = (axis.ravel() for axis in np.mgrid[tuple(slice((stride - 1) // 2, size, stride) for size in shape)])
    pixels = np.stack([columns, rows], axis=1).astype(np.float64)
    if lens.any():
        import cv2

        ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
        plane = cv2.undistortPointsIter(pixels[:, None], camera, lens, np.eye(3), np.eye(3), ends)[:, 0]
    else:
        plane = (pixels - camera[:2, 2]) / camera[[0, 1], [0, 1]]
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=1).astype(np.float32)
    rays.setflags(write=False)
    return rays
