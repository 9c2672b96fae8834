"""From a rendered camera to the contract's observation: image, cropped and farthest-point ordered cloud, state."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.experts.base import Feedback
from lerobot_adamanip.pointcloud import Cloud, Workspace, farthest_point_order
from lerobot_adamanip.rotations import pose_vector

CLOUD_RESOLUTION = 128
"""Pixels along a side that go into the cloud, whatever the image's size: some 16,000 rays."""


def capture(scene: Any, camera: Any) -> tuple[NDArray[np.uint8], Cloud]:
    """Renders once. Returns the image (H, W, 3) and the points (M, 3) [m] seen, world frame, in scan order."""
    scene.update_render(update_sensors=True, update_human_render_cameras=False)
    camera.capture()
    data = camera.get_obs(rgb=True, depth=False, position=True, segmentation=False)
    image = data["rgb"][0].cpu().numpy()
    stride = max(1, image.shape[0] // CLOUD_RESOLUTION)
    millimetres = data["position"][0, ::stride, ::stride].cpu().numpy().reshape(-1, 3)
    seen = millimetres[millimetres[:, 2] < -1].astype(np.float32) * 1e-3
    camera_in_world = camera.get_params()["cam2world_gl"][0].cpu().numpy()
    return image, seen @ camera_in_world[:3, :3].T + camera_in_world[:3, 3]


def workspace_cloud(points_in_base: Cloud, workspace: Workspace, num_points: int) -> Cloud:
    """Crops (M, 3) to the workspace and orders ``num_points`` of it farthest first. -> (num_points, 3)."""
    return farthest_point_order(points_in_base[workspace.contains(points_in_base)], num_points)


def state_vector(feedback: Feedback, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> NDArray[np.float32]:
    """Returns the (24,) state of the contract: tool pose, gripper, joint positions and velocities."""
    pose = pose_vector(feedback.tcp_in_base, feedback.gripper)
    return np.concatenate([pose, qpos, qvel]).astype(np.float32)
