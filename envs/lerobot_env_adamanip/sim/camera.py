"""The rendered camera: image and points of one moment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.pointcloud import Cloud

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
