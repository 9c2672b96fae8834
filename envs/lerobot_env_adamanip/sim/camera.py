"""The rendered camera: image and points of one moment."""

from __future__ import annotations

from typing import Any

import numpy as np
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import Camera, CameraConfig
from numpy.typing import NDArray
from PIL import Image

from lerobot_adamanip.contract.pointcloud import Cloud
from lerobot_env_adamanip.sim.observation import CameraParameters
from lerobot_env_adamanip.sim.raycast import PinholeCamera

OPENCV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])
GL_FROM_BODY = np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""SAPIEN poses a camera as a body that looks along x, with z up."""


def capture(scene: ManiSkillScene, camera: Camera) -> tuple[NDArray[np.uint8], Cloud]:
    """Renders once. Returns the image (H, W, 3) and the points (M, 3) [m], one of each pixel that sees something.

    Points are in the world's frame and in scan order.
    """
    scene.update_render(update_sensors=True, update_human_render_cameras=False)
    camera.capture()
    data = camera.get_obs(rgb=True, depth=False, position=True, segmentation=False)
    image: NDArray[np.uint8] = data["rgb"][0].cpu().numpy()
    millimetres = data["position"][0].cpu().numpy().reshape(-1, 3)
    seen = millimetres[millimetres[:, 2] < -1].astype(np.float32) * np.float32(1e-3)
    camera_in_world = camera.get_params()["cam2world_gl"][0].cpu().numpy()
    return image, points_in_world(seen, camera_in_world)


def points_in_world(points: Cloud, camera_in_world: NDArray[Any]) -> Cloud:
    """(M, 3) in a camera's frame -> in the world's, by the camera's pose (4, 4); one way to round for all sensors."""
    rotation, position = camera_in_world[:3, :3].astype(np.float32), camera_in_world[:3, 3].astype(np.float32)
    return points @ rotation.T + position


def take_image(camera: Camera) -> NDArray[np.uint8]:
    """Returns the image (H, W, 3) of one more camera of a scene that `capture` has just brought up to date."""
    camera.capture()
    data = camera.get_obs(rgb=True, depth=False, position=False, segmentation=False)
    image: NDArray[np.uint8] = data["rgb"][0].cpu().numpy()
    return image


def resized(image: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Returns the image (size, size, 3), each of its pixels the mean of those it stands for."""
    if image.shape[0] == size:
        return image
    return np.asarray(Image.fromarray(image).resize((size, size), Image.Resampling.BOX))


def pinhole(config: CameraConfig) -> PinholeCamera:
    """Returns the camera that ManiSkill makes of a configuration. No renderer is asked."""
    pose = config.pose.sp.to_transformation_matrix().astype(np.float64) @ GL_FROM_BODY
    return PinholeCamera(pose, config.width, 0.5 * config.width / np.tan(0.5 * config.fov))


def camera_parameters(camera: PinholeCamera, size: int) -> CameraParameters:
    """Returns a camera's parameters for an image of ``size`` [px]; the robot's base is the world's origin."""
    focal, middle = camera.focal * size / camera.size, 0.5 * size
    intrinsics = np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    return CameraParameters(intrinsics, camera.pose @ OPENCV_FROM_GL, width=size, height=size)
