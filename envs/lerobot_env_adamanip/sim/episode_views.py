"""What is seen of one episode: points and images, each made when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mani_skill.sensors.camera import CameraConfig
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import Cloud, Workspace
from lerobot_env_adamanip.sim.camera import camera_parameters, pinhole
from lerobot_env_adamanip.sim.observation import CameraParameters
from lerobot_env_adamanip.sim.raycast_shading import shaded_picture
from lerobot_env_adamanip.sim.render_on_demand import PictureScene
from lerobot_env_adamanip.sim.robot import joint_snapshot, set_joints
from lerobot_env_adamanip.sim.scene import ObjectScene
from lerobot_env_adamanip.sim.sensors import Body, RaycastSensor, RenderedSensor, Sensor, visible_bodies


@dataclass
class Views:
    """The front camera of one episode, in whatever way it sees.

    Attributes:
        objects: what stands before the arm.
        agent: ManiSkill's, of the arm.
        camera: returns the camera's configuration for a picture of so many pixels along a side.
        image_size: of the image [px].
        depth_size: of the picture whose pixels are the points [px].
        workspace: of which points are wanted.
        render_backend: what renders pictures, see `lerobot_adamanip.episode.options.RENDER_BACKENDS`.
        rendered: sees points and image in a scene that is rendered anyway; None where points are cast as rays.
    """

    objects: ObjectScene
    agent: Any
    camera: Callable[[int], CameraConfig]
    image_size: int
    depth_size: int
    workspace: Workspace
    render_backend: str
    rendered: RenderedSensor | None = None
    _cast: RaycastSensor | None = field(default=None, init=False)
    _pictures: PictureScene | None = field(default=None, init=False)

    @property
    def sensor(self) -> Sensor:
        """What sees the points."""
        if self.rendered is not None:
            return self.rendered
        if self._cast is None:
            self._cast = RaycastSensor(self.camera(self.depth_size), self.bodies(), self.workspace)
        return self._cast

    def points(self) -> Cloud:
        """Returns (M, 3) [m], robot base frame: what is seen now, at least all in the workspace."""
        return self.sensor.points()

    def image(self) -> NDArray[np.uint8]:
        """Returns the image (H, W, 3) of this moment; raises `SimulatorError` if there is nothing to render with."""
        if self.rendered is not None:
            return self.rendered.image()
        if self._pictures is None:
            self._pictures = PictureScene(
                self.objects.visible,
                self._robot,
                self._urdf,
                ground_z=self.objects.ground_z,
                camera=self.camera(self.image_size),
                render_backend=self.render_backend,
            )
        return self._pictures.take()

    def shaded_image(self) -> NDArray[np.uint8]:
        """Returns a picture (H, W, 3) of this moment that needs no renderer: shapes without colours of their own."""
        return shaded_picture(self.camera(self.image_size), self.bodies())

    def bodies(self) -> list[Body]:
        """Returns what rays can meet."""
        return visible_bodies(self.objects.visible, self._robot, self._urdf)

    def joints(self) -> NDArray[np.float32]:
        """Returns the positions of everything that moves, (13,), see `lerobot_adamanip.contract.schema.JOINT_NAMES`."""
        return joint_snapshot(self._robot, self.objects.articulation._objs[0])

    def set_joints(self, joints: NDArray[np.float32]) -> None:
        """Puts everything where `joints` (13,) had it, at rest, to be looked at. No physics is stepped."""
        set_joints(self._robot, self.objects.articulation._objs[0], joints)

    def camera_parameters(self) -> CameraParameters:
        """Returns the camera's parameters for the image."""
        return camera_parameters(pinhole(self.camera(self.image_size)), self.image_size)

    @property
    def _robot(self) -> Any:
        return self.agent.robot._objs[0]

    @property
    def _urdf(self) -> Path:
        return Path(self.agent.urdf_path)
