"""The rendered camera: image and points of one moment."""

from __future__ import annotations

from typing import Any

import numpy as np
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import Camera
from numpy.typing import NDArray

from lerobot_adamanip.pointcloud import Cloud
from lerobot_env_adamanip.sim.observation import CameraParameters

CLOUD_RESOLUTION = 128
"""Pixels along a side that go into the cloud, whatever the image's size: some 16,000 rays."""
OPENCV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])


def capture(scene: ManiSkillScene, camera: Camera) -> tuple[NDArray[np.uint8], Cloud]:
    """Renders once. Returns the image (H, W, 3) and the points (M, 3) [m] seen, world frame, in scan order."""
    scene.update_render(update_sensors=True, update_human_render_cameras=False)
    camera.capture()
    data = camera.get_obs(rgb=True, depth=False, position=True, segmentation=False)
    image: NDArray[np.uint8] = data["rgb"][0].cpu().numpy()
    stride = max(1, image.shape[0] // CLOUD_RESOLUTION)
    millimetres = data["position"][0, ::stride, ::stride].cpu().numpy().reshape(-1, 3)
    seen = millimetres[millimetres[:, 2] < -1].astype(np.float32) * 1e-3
    camera_in_world = camera.get_params()["cam2world_gl"][0].cpu().numpy()
    return image, seen @ camera_in_world[:3, :3].T + camera_in_world[:3, 3]


def camera_parameters(camera: Camera) -> CameraParameters:
    """Returns a camera's parameters; the robot's base stands at the world's origin."""
    parameters: dict[str, Any] = camera.get_params()
    pose = parameters["cam2world_gl"][0].cpu().numpy() @ OPENCV_FROM_GL
    return CameraParameters(
        parameters["intrinsic_cv"][0].cpu().numpy(), pose, width=camera.config.width, height=camera.config.height
    )
