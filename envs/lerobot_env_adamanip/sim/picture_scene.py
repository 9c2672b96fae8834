"""Rendered images: a second scene with the bodies of the physics scene, created for the first image."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import Camera, CameraConfig
from mani_skill.utils.building.ground import build_ground
from numpy.typing import NDArray
from sapien.wrapper.actor_builder import ActorBuilder

from lerobot_adamanip.contract.pointcloud import Cloud
from lerobot_env_adamanip.sim.articulation import add_visual
from lerobot_env_adamanip.sim.camera import pinhole, points_in_world
from lerobot_env_adamanip.sim.renderer import empty_scene, without_reflections
from lerobot_env_adamanip.sim.scene import Visible, add_lights
from lerobot_env_adamanip.sim.triangles import robot_outlines


class PictureScene:
    """Looks of the physics scene's bodies at their present poses. The physics scene has no renderer.

    Takes all visible bodies except arm and ground, SAPIEN's articulation of the arm, its URDF, and the ground's height
    [m]. Raises `SimulatorError` if this machine cannot render.
    """

    def __init__(
        self,
        visible: Iterable[Visible],
        robot: Any,
        urdf: Path,
        *,
        ground_z: float,
        camera: CameraConfig,
        render_backend: str = "auto",
    ) -> None:
        self._scene = empty_scene(render_backend)
        build_ground(self._scene, altitude=ground_z)
        self._looks: list[tuple[Any, Any]] = []
        self._pinhole, self._outlines = pinhole(camera), robot_outlines(urdf)
        for body in visible:
            self._add(body.entity, _component(body))
        components = _robot_components(self._scene, urdf)
        for link in robot.links:
            if (component := components.get(link.entity.name)) is not None:
                self._add(link.entity, component)
        add_lights(self._scene, shadow=False)
        self._camera = Camera(without_reflections(camera), self._scene)

    def take(self) -> NDArray[np.uint8]:
        """Returns an image (H, W, 3) of the present scene."""
        self._render()
        image: NDArray[np.uint8] = self.texture("rgb")
        return image

    def points(self) -> Cloud:
        """Returns (M, 3) [m], robot base frame, in scan order: one point per pixel with a hit."""
        self._render()
        millimetres = self.texture("position").reshape(-1, 3)
        seen = millimetres[millimetres[:, 2] < -1].astype(np.float32) * np.float32(1e-3)
        return points_in_world(seen, self._camera.get_params()["cam2world_gl"][0].cpu().numpy())

    def texture(self, name: str) -> NDArray[Any]:
        """Returns ``rgb``, ``depth`` or ``position`` (H, W, C) of the latest image."""
        wanted = {"rgb": False, "depth": False, "position": False, "segmentation": False, name: True}
        return np.asarray(self._camera.get_obs(**wanted)[name][0].cpu().numpy())

    def _render(self) -> None:
        for look, entity in self._looks:
            look.pose = entity.pose
            if (outline := self._outlines.get(entity.name)) is not None:
                _show(look.components[0], self._pinhole.may_see(outline, entity.pose.to_transformation_matrix()))
        self._scene.update_render(update_sensors=True, update_human_render_cameras=False)
        self._camera.capture()

    def _add(self, entity: Any, component: Any) -> None:
        look = sapien.Entity()
        look.add_component(component)
        self._scene.sub_scenes[0].add_entity(look)
        self._looks.append((look, entity))


def _show(component: Any, seen: bool) -> None:
    """Disables bodies outside of the image: without a GPU an arm's links take three quarters of the time."""
    if seen and not component.is_enabled:
        component.enable()
    elif not seen and component.is_enabled:
        component.disable()


def _component(body: Visible) -> Any:
    builder = ActorBuilder()
    for shape in body.shapes:
        if shape.visible:
            add_visual(builder, shape)
    return builder.build_render_component()


def _robot_components(scene: ManiSkillScene, urdf: Path) -> dict[str, Any]:
    """Returns link name -> component from ManiSkill's loader for its visuals."""
    loader = scene.create_urdf_loader()
    loader.name = "looks"
    links = loader.parse(str(urdf))["articulation_builders"][0].link_builders
    return {link.name: link.build_render_component() for link in links if link.visual_records}
