"""Point clouds and images of one episode, created on request."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mani_skill.sensors.camera import CameraConfig
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.keyframes import Feedback
from lerobot_adamanip.contract.pointcloud import Cloud, Workspace
from lerobot_adamanip.contract.schema import JOINT_NAMES
from lerobot_env_adamanip.sim.camera import camera_parameters, pinhole
from lerobot_env_adamanip.sim.picture_scene import PictureScene
from lerobot_env_adamanip.sim.ray_camera import Body, RaycastSensor, shaded_picture, visible_bodies
from lerobot_env_adamanip.sim.scene import ObjectScene


@dataclass(frozen=True)
class SimObservation:
    """State and images of the simulator at one moment."""

    images: dict[str, NDArray[np.uint8]]
    """Camera -> (H, W, 3); empty unless requested."""
    points_in_base: Cloud
    """(M, 3) [m], robot base frame, in scan order: points of the front camera, covering at least the workspace."""
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    effort: NDArray[np.float64]
    """External joint torque of the arm (7,) [N m]; before it joint positions [rad] and velocities [rad/s]."""
    feedback: Feedback


@dataclass
class Views:
    """Cameras of one episode.

    ``camera`` maps a size [px] and a name to a configuration. Clouds have the pixels of a depth image of ``depth_size``
    [px]. ``render_backend`` and ``cloud_source`` are options of `EnvironmentOptions`.
    """

    objects: ObjectScene
    agent: Any
    camera: Callable[[int, str], CameraConfig]
    image_size: int
    depth_size: int
    workspace: Workspace
    render_backend: str
    cloud_source: str
    _scenes: dict[str, PictureScene] = field(default_factory=dict)

    def points(self) -> Cloud:
        """Returns the present points (M, 3) [m], robot base frame, covering at least the workspace."""
        return self.depth_scene.points() if self.cloud_source == "render" else self.rays.points()

    def image(self, name: str = FRONT) -> NDArray[np.uint8]:
        """Returns a camera's present image (H, W, 3); raises `SimulatorError` if this machine cannot render."""
        if name not in self._scenes:
            self._scenes[name] = self._picture_scene(self.image_size, name)
        return self._scenes[name].take()

    def shaded_image(self) -> NDArray[np.uint8]:
        """Returns the front camera's image (H, W, 3) without a renderer: shapes without their own colours."""
        return shaded_picture(self.camera(self.image_size, FRONT), self.bodies())

    @functools.cached_property
    def rays(self) -> RaycastSensor:
        """Ray-cast front camera."""
        return RaycastSensor(self.camera(self.depth_size, FRONT), self.bodies(), self.workspace)

    @functools.cached_property
    def depth_scene(self) -> PictureScene:
        """Rendered front camera with the size of `rays`."""
        return self._picture_scene(self.depth_size, FRONT)

    def _picture_scene(self, size: int, name: str) -> PictureScene:
        return PictureScene(
            self.objects.visible,
            self._robot,
            self._urdf,
            ground_z=self.objects.ground_z,
            camera=self.camera(size, name),
            render_backend=self.render_backend,
        )

    def bodies(self) -> list[Body]:
        """Returns the bodies for ray casting."""
        return visible_bodies(self.objects.visible, self._robot, self._urdf)

    def joints(self) -> NDArray[np.float32]:
        """Returns the positions of all joints, (13,), see `lerobot_adamanip.contract.schema.JOINT_NAMES`."""
        positions = np.concatenate([each.get_qpos() for each in self._articulations])
        return np.pad(positions, (0, len(JOINT_NAMES) - len(positions))).astype(np.float32)

    def set_joints(self, joints: NDArray[np.float32]) -> None:
        """Sets all joints to ``joints`` (13,), at rest, without a physics step."""
        ends = np.cumsum([each.dof for each in self._articulations])
        for articulation, positions in zip(self._articulations, np.split(joints, ends), strict=False):
            articulation.set_qpos(positions)
            articulation.set_qvel(np.zeros_like(positions))

    def camera_parameters(self) -> dict[str, Any]:
        """Returns the front camera's calibration for its image, see `sim.camera.camera_parameters`."""
        return camera_parameters(pinhole(self.camera(self.image_size, FRONT)))

    @property
    def _robot(self) -> Any:
        return self.agent.robot._objs[0]

    @property
    def _articulations(self) -> tuple[Any, Any]:
        return self._robot, self.objects.articulation._objs[0]

    @property
    def _urdf(self) -> Path:
        return Path(self.agent.urdf_path)
