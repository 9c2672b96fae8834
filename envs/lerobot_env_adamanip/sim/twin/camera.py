"""Camera of the twin: renders colour and depth together, or ray-casts without a renderer."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip.sim.camera import camera_parameters, pinhole
from lerobot_env_adamanip.sim.picture_scene import PictureScene
from lerobot_env_adamanip.sim.ray_camera import RaycastSensor, shaded_picture
from lerobot_env_adamanip.sim.views import Views

Pair = tuple[NDArray[np.uint8], NDArray[np.uint16]]
"""Colour (H, W, 3) RGB and depth (H, W) [mm], 0 for invalid pixels."""
FARTHEST = 4000
"""Range of the depth camera [mm]."""
_ROUND = Workspace((-0.8, -1.2, -1.2), (1.8, 1.2, 1.8))
"""Volume of ray casting, robot base frame [m]."""
_logger = logging.getLogger(__name__)


class _DepthScene(PictureScene):
    """Scene that returns colour and depth of one render."""

    def take_pair(self) -> Pair:
        """Returns the current colour and depth."""
        image = self.take()
        told = self._camera.get_obs(rgb=False, depth=True, position=False, segmentation=False)
        depth = told["depth"][0].cpu().numpy()[..., 0]
        return image, np.where((depth > 0) & (depth < FARTHEST), depth, 0).astype(np.uint16)


class TwinEye:
    """The front camera of one episode.

    Args:
        views: views of the episode.
        robot: SAPIEN articulation of the arm.
        urdf: URDF of the arm.
        size: side length of the pictures [px].
        source: ``render``, or ``raycast`` for shapes without colours. Without a renderer, always ``raycast``.
        render_backend: see `lerobot_adamanip.episode.options.RENDER_BACKENDS`.
    """

    def __init__(
        self, views: Views, robot: Any, urdf: Path, *, size: int, source: str = "render", render_backend: str = "auto"
    ) -> None:
        self._views, self._robot, self._urdf = views, robot, urdf
        self._size, self.source, self._render_backend = size, source, render_backend
        self._config = views.camera(size, FRONT)
        self._scene: _DepthScene | None = None
        self._rays: RaycastSensor | None = None
        self._ready = False

    def get_ready(self) -> None:
        """Takes the first picture, which takes ten times as long as later ones. Later calls do nothing."""
        if not self._ready:
            self.take()
            self._ready = True

    def take(self) -> Pair:
        """Returns the current colour and depth."""
        if self.source == "render" and (rendered := self._rendered()) is not None:
            return rendered.take_pair()
        if self._rays is None:
            self._rays = RaycastSensor(self._config, self._views.bodies(), _ROUND)
        pixels, millimetres = self._rays.pixels()
        depth = np.zeros(self._size * self._size, np.uint16)
        depth[pixels] = -millimetres[:, 2]
        return shaded_picture(self._config, self._views.bodies()), depth.reshape(self._size, self._size)

    def parameters(self) -> dict[str, Any]:
        """Returns intrinsics and pose in the base frame, see `camera_parameters`. Renders nothing."""
        return camera_parameters(pinhole(self._config))

    def _rendered(self) -> _DepthScene | None:
        """Returns the scene to render, created at the first picture; None without a renderer."""
        if self._scene is None:
            visible, ground_z = self._views.objects.visible, self._views.objects.ground_z
            try:
                self._scene = _DepthScene(
                    visible,
                    self._robot,
                    self._urdf,
                    ground_z=ground_z,
                    camera=self._config,
                    render_backend=self._render_backend,
                )
            except SimulatorError as error:
                self.source = "raycast"
                _logger.warning("The twin's camera uses ray casting, without colours: %s", str(error).split("\n")[0])
        return self._scene
