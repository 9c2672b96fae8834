"""The rendered camera: image and points of one moment."""

from __future__ import annotations

from typing import Any

import numpy as np
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import Camera
from numpy.typing import NDArray
from PIL import Image

from lerobot_adamanip.pointcloud import Cloud
from lerobot_env_adamanip.sim.observation import CameraParameters

RENDER_SIZE = 320
"""Side of what is rendered for an observation [px], whatever the image's size: each of its pixels is a point."""
OPENCV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])


def capture(scene: ManiSkillScene, camera: Camera) -> tuple[NDArray[np.uint8], Cloud]:
    """Renders once. Returns the image (H, W, 3) and the points (M, 3) [m], one of each pixel that sees something.

    Points are in the world's frame and in scan order.
    """
    scene.update_render(update_sensors=True, update_human_render_cameras=False)
    camera.capture()
    data = camera.get_obs(rgb=True, depth=False, position=True, segmentation=False)
    image: NDArray[np.uint8] = data["rgb"][0].cpu().numpy()
    millimetres = data["position"][0].cpu().numpy().reshape(-1, 3)
    seen = millimetres[millimetres[:, 2] < -1].astype(np.float32) * 1e-3
    camera_in_world = camera.get_params()["cam2world_gl"][0].cpu().numpy()
    return image, seen @ camera_in_world[:3, :3].T + camera_in_world[:3, 3]


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


def camera_parameters(camera: Camera, size: int) -> CameraParameters:
    """Returns a camera's parameters for an image of ``size`` [px]; the robot's base is the world's origin."""
    parameters: dict[str, Any] = camera.get_params()
    pose = parameters["cam2world_gl"][0].cpu().numpy() @ OPENCV_FROM_GL
    scale = np.diag([size / camera.config.width, size / camera.config.height, 1.0])
    return CameraParameters(scale @ parameters["intrinsic_cv"][0].cpu().numpy(), pose, width=size, height=size)
