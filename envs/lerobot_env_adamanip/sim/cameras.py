"""Cameras of one episode: point clouds and images, rendered or by ray casting, created on request."""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import Camera, CameraConfig
from mani_skill.utils.building.ground import build_ground
from numpy.typing import NDArray
from sapien.wrapper.actor_builder import ActorBuilder

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT, TOOL
from lerobot_adamanip.contract.pointcloud import Cloud, depth_size
from lerobot_adamanip.episode.options import RAYCAST, EnvironmentOptions
from lerobot_adamanip.hardware.calibration.hand_shape import FINGER_TRAVEL_M
from lerobot_adamanip.hardware.calibration.self_calibration import SelfCalibration
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip.sim.articulation import add_visual
from lerobot_env_adamanip.sim.ray_picture import RayPictures
from lerobot_env_adamanip.sim.raycast import (
    AROUND,
    Body,
    PinholeCamera,
    RaycastSensor,
    camera_parameters,
    pinhole,
    pinhole_at,
    points_in_world,
    visible_bodies,
)
from lerobot_env_adamanip.sim.renderer import empty_scene, without_reflections
from lerobot_env_adamanip.sim.scene import ObjectScene, add_lights, camera_config
from lerobot_env_adamanip.sim.sensing import SensorErrors
from lerobot_env_adamanip.sim.triangles import robot_outlines

Pair = tuple[NDArray[np.uint8], NDArray[np.uint16]]
"""Colour (H, W, 3) RGB and depth (H, W) [mm], 0 for invalid pixels."""
FARTHEST = 4000
"""Range of the depth camera [mm]."""
_warn_once = functools.cache(logging.getLogger(__name__).warning)


@dataclass
class Cameras:
    """Cameras of one episode. Clouds have the pixels of a depth image of `depth_size`.

    Attributes:
        objects: bodies of the scene, except arm and ground.
        robot: SAPIEN articulation of the arm.
        urdf: its URDF.
        poses: camera -> its true pose in the frame of its link.
        options: image size, workspace, source of clouds, rendering device.
        shader: shader pack of ManiSkill's cameras.
        errors: errors of depth and of reported poses; None without errors.
        calibration: corrects each cloud by the hand in it; None for clouds as they are reported.
    """

    objects: ObjectScene
    robot: Any
    urdf: Path
    poses: Mapping[str, sapien.Pose]
    options: EnvironmentOptions
    shader: str
    errors: SensorErrors | None = None
    calibration: SelfCalibration | None = None
    _rendered: dict[tuple[str, int], RenderedCamera] = field(default_factory=dict)

    def config(self, name: str = FRONT, size: int | None = None) -> CameraConfig:
        """Returns a camera's configuration in the frame of its link, by default for images."""
        return camera_config(name, self.poses[name], size or self.options.image_size, self.shader)

    def view(self, name: str = FRONT) -> PinholeCamera:
        """Returns a camera at its present pose, for images."""
        pose = self.poses[name] if (mount := self.mount(name)) is None else mount.pose * self.poses[name]
        return pinhole_at(pose, self.options.image_size, CAMERAS[name].field_of_view)

    def mount(self, name: str) -> Any:
        """Returns the SAPIEN entity of the link that carries a camera; None if the camera rests."""
        link = CAMERAS[name].link
        return self._links[link] if link else None

    @property
    def tcp_in_base(self) -> NDArray[np.float64]:
        """Present pose (4, 4) of the tool, robot base frame."""
        return np.asarray(self._links[TOOL].pose.to_transformation_matrix(), np.float64)

    @functools.cached_property
    def _links(self) -> dict[str, Any]:
        return {link.entity.name: link.entity for link in self.robot.links}

    @property
    def cloud_config(self) -> CameraConfig:
        """Configuration of the front camera for clouds."""
        return self.config(size=depth_size(self.options.num_points))

    def points(self) -> Cloud:
        """Returns the present points (M, 3) [m], robot base frame, in scan order, covering at least the workspace."""
        if self.errors is not None:
            points = self.errors.reported(self.rays.points(self.errors.cloud_depths), self.tcp_in_base)
        else:
            points = self.depth_scene.points() if self.options.cloud_source == "render" else self.rays.points()
        if self.calibration is not None:
            gripper = float(np.mean(self.robot.get_qpos()[-2:])) / FINGER_TRAVEL_M
            self.calibration.update(points, self.tcp_in_base, gripper)
            points = self.calibration.corrected(points)
        return points

    def image(self, name: str = FRONT) -> NDArray[np.uint8]:
        """Returns a camera's present image (H, W, 3) from the source of the options.

        Raises:
            SimulatorError: the source is ``render``, but this machine cannot render.
        """
        return self.raycast_image(name) if self.options.images_from == RAYCAST else self.rendered_image(name)

    def picture(self) -> NDArray[np.uint8]:
        """Returns the front camera's image (H, W, 3); without a renderer, by ray casting."""
        if self.options.images_from == RAYCAST or (rendered := self._front) is None:
            return self.raycast_image()
        return rendered.take()

    def rendered_image(self, name: str = FRONT) -> NDArray[np.uint8]:
        """Returns a camera's present image (H, W, 3) by the renderer; raises `SimulatorError` if there is none."""
        return self._camera(self.config(name)).take()

    def raycast_image(self, name: str = FRONT) -> NDArray[np.uint8]:
        """Returns a camera's present image (H, W, 3) without a renderer, see `sim.ray_picture`."""
        return self._ray_pictures.take(self.view(name))

    @functools.cached_property
    def _ray_pictures(self) -> RayPictures:
        return RayPictures(self.bodies, self.objects.ground_z)

    def color_and_depth(self, source: str = "render") -> Pair:
        """Returns the front camera's present colour and depth, of one moment.

        ``source`` is ``render`` or ``raycast``. Without a renderer, always ``raycast``. Depth with errors is ray-cast.
        """
        rendered = self._front if source == "render" else None
        if rendered is not None and self.errors is None:
            return rendered.color_and_depth()
        size = self.options.image_size
        pixels, millimetres = self._wide_rays.pixels(None if self.errors is None else self.errors.depths)
        depth = np.zeros(size * size, np.uint16)
        depth[pixels] = -millimetres[:, 2]
        return self.raycast_image() if rendered is None else rendered.take(), depth.reshape(size, size)

    @functools.cached_property
    def rays(self) -> RaycastSensor:
        """Ray-cast front camera of the workspace."""
        workspace = self.options.workspace
        return RaycastSensor(
            self.cloud_config, self.bodies, workspace if self.errors is None else self.errors.around(workspace)
        )

    @functools.cached_property
    def _wide_rays(self) -> RaycastSensor:
        return RaycastSensor(self.config(), self.bodies, AROUND)

    @property
    def depth_scene(self) -> RenderedCamera:
        """Rendered front camera with the size of `rays`."""
        return self._camera(self.cloud_config)

    @functools.cached_property
    def _front(self) -> RenderedCamera | None:
        """Returns the rendered front camera; None, with one warning, if this machine cannot render."""
        try:
            return self._camera(self.config())
        except SimulatorError as error:
            _warn_once("Images are drawn by ray casting: " + str(error).split("\n")[0])
            return None

    def _camera(self, config: CameraConfig) -> RenderedCamera:
        key = config.uid, config.width
        if key not in self._rendered:
            self._rendered[key] = RenderedCamera(self._scene, config, self.mount(config.uid))
        return self._rendered[key]

    @functools.cached_property
    def _scene(self) -> RenderedScene:
        return RenderedScene(self.objects, self.robot, self.urdf, self.options.render_backend)

    @functools.cached_property
    def bodies(self) -> list[Body]:
        """Returns the bodies for ray casting."""
        return visible_bodies(self.objects.visible, self.robot, self.urdf)

    def parameters(self) -> dict[str, Any]:
        """Returns the front camera's calibration for its image as it is reported, see `camera_parameters`."""
        camera = pinhole(self.config())
        return camera_parameters(
            camera if self.errors is None else replace(camera, pose=self.errors.camera @ camera.pose)
        )


class RenderedScene:
    """Copies the physics scene's bodies at their present poses into a second scene; the first has no renderer.

    Raises `SimulatorError` if this machine cannot render.
    """

    def __init__(self, objects: ObjectScene, robot: Any, urdf: Path, render_backend: str) -> None:
        self.scene = empty_scene(render_backend)
        build_ground(self.scene, altitude=objects.ground_z)
        self._looks: list[tuple[Any, Any]] = []
        self._outlines = robot_outlines(urdf)
        for body in objects.visible:
            builder = ActorBuilder()
            for shape in body.shapes:
                if shape.visible:
                    add_visual(builder, shape)
            self._add(body.entity, builder.build_render_component())
        components = _robot_components(self.scene, urdf)
        for link in robot.links:
            if (component := components.get(link.entity.name)) is not None:
                self._add(link.entity, component)
        add_lights(self.scene, shadow=False)

    def update(self, camera: PinholeCamera) -> None:
        """Moves the copies. Disables links that a camera cannot see: without a GPU they take most of the time."""
        for look, entity in self._looks:
            look.pose = entity.pose
            if (outline := self._outlines.get(entity.name)) is not None:
                component = look.components[0]
                is_seen = camera.may_see(outline, entity.pose.to_transformation_matrix())
                if is_seen != component.is_enabled:
                    (component.enable if is_seen else component.disable)()
        self.scene.update_render(update_sensors=True, update_human_render_cameras=False)

    def _add(self, entity: Any, component: Any) -> None:
        look = sapien.Entity()
        look.add_component(component)
        self.scene.sub_scenes[0].add_entity(look)
        self._looks.append((look, entity))


class RenderedCamera:
    """Camera of a rendered scene, on the SAPIEN entity ``mount`` of the physics scene, or at rest."""

    def __init__(self, scene: RenderedScene, config: CameraConfig, mount: Any) -> None:
        self._scene, self._config, self._mount = scene, config, mount
        self._camera = Camera(without_reflections(config), scene.scene)

    def take(self) -> NDArray[np.uint8]:
        """Returns an image (H, W, 3) of the present scene."""
        self._render()
        image: NDArray[np.uint8] = self.texture("rgb")
        return image

    def color_and_depth(self) -> Pair:
        """Returns colour and depth of one render."""
        image, depth = self.take(), self.texture("depth")[..., 0]
        return image, np.where((depth > 0) & (depth < FARTHEST), depth, 0).astype(np.uint16)

    def points(self) -> Cloud:
        """Returns (M, 3) [m], robot base frame, in scan order: one point per pixel with a hit."""
        self._render()
        millimetres = self.texture("position").reshape(-1, 3)
        seen = millimetres[millimetres[:, 2] < -1].astype(np.float32) * np.float32(1e-3)
        return points_in_world(seen, self._camera.get_params()["cam2world_gl"][0].cpu().numpy())

    def texture(self, name: str) -> NDArray[Any]:
        """Returns ``rgb``, ``depth`` or ``position`` (H, W, C) of the latest image."""
        names = {"rgb": False, "depth": False, "position": False, "segmentation": False, name: True}
        return np.asarray(self._camera.get_obs(**names)[name][0].cpu().numpy())

    def _render(self) -> None:
        pose = None if self._mount is None else self._mount.pose
        if pose is not None:
            self._camera.camera._render_cameras[0].entity.pose = pose
        self._scene.update(pinhole(self._config, pose))
        self._camera.capture()


def _robot_components(scene: ManiSkillScene, urdf: Path) -> dict[str, Any]:
    """Returns link name -> component from ManiSkill's loader for its visuals."""
    loader = scene.create_urdf_loader()
    loader.name = "looks"
    links = loader.parse(str(urdf))["articulation_builders"][0].link_builders
    return {link.name: link.build_render_component() for link in links if link.visual_records}
