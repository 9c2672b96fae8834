"""Pictures without a renderer: what rays meet, shaded by how it is turned. For videos where no Vulkan device is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mani_skill.sensors.camera import CameraConfig
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_env_adamanip.sim.camera import pinhole
from lerobot_env_adamanip.sim.raycast import RayScene
from lerobot_env_adamanip.sim.sensors import Body

_AROUND = Workspace((-0.8, -1.2, -1.2), (1.8, 1.2, 1.8))
"""What is in the picture, robot base frame [m]."""
_BACKGROUND = np.array((0.36, 0.37, 0.40), np.float32)
_COLORS = np.array(
    ((0.80, 0.80, 0.82), (0.72, 0.56, 0.36), (0.45, 0.60, 0.78), (0.62, 0.74, 0.50), (0.80, 0.48, 0.42)), np.float32
)
"""Of the arm, then of the other bodies in turn."""
_LIGHT = np.array((-0.3, 0.5, 0.8), np.float32)
"""Where it comes from, camera frame; scaled to length 1 when used."""
_AMBIENT = 0.3


def shaded_picture(config: CameraConfig, bodies: Sequence[Body]) -> NDArray[np.uint8]:
    """Returns what a camera sees of bodies as they are now, (H, W, 3), without colours of their own."""
    camera = pinhole(config)
    scene = RayScene(camera, _AROUND)
    depth = scene.empty()
    owner = np.zeros(len(depth), np.int64)
    for number, body in enumerate(bodies):
        before = depth.copy()
        scene.cast([(body.mesh, body.pose())], depth)
        owner[depth < before] = 1 + number % (len(_COLORS) - 1) if body.rests else 0
    met = scene.met(depth)
    points = np.full((camera.size**2, 3), np.nan, np.float32)
    points[scene.pixels[met]] = scene.rays[met] * depth[met, None]
    light = _brightness(points.reshape(camera.size, camera.size, 3)).reshape(-1)
    picture = np.tile(_BACKGROUND, (camera.size**2, 1))
    picture[scene.pixels[met]] = _COLORS[owner[met]] * light[scene.pixels[met], None]
    return np.clip(255 * picture + 0.5, 0, 255).astype(np.uint8).reshape(camera.size, camera.size, 3)


def _brightness(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Brightness (H, W) of points (H, W, 3), camera frame, by the surface through each and its neighbours."""
    right, down = (np.roll(points, -1, axis=axis) - points for axis in (1, 0))
    normal = np.cross(down, right)
    length = np.maximum(np.linalg.norm(normal, axis=2), 1e-12)
    facing = (normal @ (_LIGHT / np.linalg.norm(_LIGHT))) / length
    # Where a neighbour sees nothing there is no surface to tell: as bright as what turns away from the light.
    return np.asarray(np.nan_to_num(_AMBIENT + (1 - _AMBIENT) * np.clip(facing, 0, 1), nan=_AMBIENT), np.float32)
