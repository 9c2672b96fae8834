"""The twin's camera: colour and depth of one moment, rendered together, or by rays where nothing renders."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.errors import SimulatorError
from lerobot_adamanip.hardware.frames import CameraCalibration, Intrinsics
from lerobot_adamanip.pointcloud import Workspace
from lerobot_env_adamanip.sim.camera import camera_parameters, pinhole
from lerobot_env_adamanip.sim.pictures import PictureScene
from lerobot_env_adamanip.sim.sensors import RaycastSensor
from lerobot_env_adamanip.sim.shaded import shaded_picture
from lerobot_env_adamanip.sim.views import Views

Pair = tuple[NDArray[np.uint8], NDArray[np.uint16]]
"""(H, W, 3) RGB and (H, W) depth [mm], 0 where nothing was seen."""
FARTHEST = 4000
"""Beyond this a depth camera sees nothing [mm]."""
_ROUND = Workspace((-0.8, -1.2, -1.2), (1.8, 1.2, 1.8))
"""What rays meet, robot base frame [m]."""
_logger = logging.getLogger(__name__)


class _DepthScene(PictureScene):
    """One render gives both: the depth belongs to the picture that was just taken."""

    def take_pair(self) -> Pair:
        """Returns picture and depth of this moment."""
        image = self.take()
        told = self._camera.get_obs(rgb=False, depth=True, position=False, segmentation=False)
        depth = told["depth"][0].cpu().numpy()[..., 0]
        return image, np.where((depth > 0) & (depth < FARTHEST), depth, 0).astype(np.uint16)


class TwinEye:
    """The front camera of one episode.

    Args:
        views: of the episode.
        robot: SAPIEN's articulation of the arm.
        urdf: its description.
        size: of the pictures [px].
        source: ``render``, or ``raycast`` where pictures show shapes without colours.
        render_backend: see `lerobot_adamanip.options.RENDER_BACKENDS`.
    """

    def __init__(
        self, views: Views, robot: Any, urdf: Path, *, size: int, source: str = "render", render_backend: str = "auto"
    ) -> None:
        self._views, self._size = views, size
        self._config = views.camera(size)
        self._scene: _DepthScene | None = None
        self._rays: RaycastSensor | None = None
        if source == "render":
            try:
                self._scene = _DepthScene(
                    views.objects.visible,
                    robot,
                    urdf,
                    ground_z=views.objects.ground_z,
                    camera=self._config,
                    render_backend=render_backend,
                )
            except SimulatorError as error:
                _logger.warning("The twin's camera sees by rays, without colours: %s", str(error).split("\n")[0])

    @property
    def source(self) -> str:
        """What it sees by: ``render`` or ``raycast``."""
        return "raycast" if self._scene is None else "render"

    def take(self) -> Pair:
        """Returns colour and depth of this moment."""
        if self._scene is not None:
            return self._scene.take_pair()
        if self._rays is None:
            self._rays = RaycastSensor(self._config, self._views.bodies(), _ROUND)
        pixels, millimetres = self._rays.pixels()
        depth = np.zeros(self._size * self._size, np.uint16)
        depth[pixels] = -millimetres[:, 2]
        return shaded_picture(self._config, self._views.bodies()), depth.reshape(self._size, self._size)

    def calibration(self, name: str) -> CameraCalibration:
        """Returns how it sees and where it is: colour and depth have one imager."""
        told = camera_parameters(pinhole(self._config), self._size)
        imager = Intrinsics(told.intrinsics, np.zeros(0), told.width, told.height)
        return CameraCalibration(name, imager, told.camera_in_base, color=imager, depth_in_color=np.eye(4))
