"""Pictures on demand: what the physics scene looks like, by a renderer that starts when the first one is asked for."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.envs.utils.system.backend import parse_sim_and_render_backend
from mani_skill.sensors.camera import Camera, CameraConfig
from mani_skill.utils.building.ground import build_ground
from numpy.typing import NDArray
from sapien.wrapper.actor_builder import ActorBuilder

from lerobot_adamanip.util.errors import no_vulkan_device
from lerobot_env_adamanip.sim.articulation import add_visual
from lerobot_env_adamanip.sim.camera import pinhole, take_image
from lerobot_env_adamanip.sim.render_device import MANISKILL_NAMES, has_vulkan_driver, resolve_render_backend
from lerobot_env_adamanip.sim.rendering import keep_shaders, without_reflections
from lerobot_env_adamanip.sim.scene import Visible, add_lights
from lerobot_env_adamanip.sim.triangles import robot_outlines


class PictureScene:
    """A second scene that is only looked at: the looks of the first one's bodies, at their poses of the moment.

    The scene in which physics runs has no renderer and is not touched.

    Args:
        visible: all to be seen but arm and ground.
        robot: SAPIEN's articulation of the arm.
        urdf: its description.
        ground_z: height of the ground [m].
        camera: what takes the pictures.
        render_backend: see `lerobot_adamanip.episode.options.RENDER_BACKENDS`.

    Raises:
        SimulatorError: there is nothing to render with.
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
        self._scene = _empty_scene(render_backend)
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
        """Returns a picture (H, W, 3) of this moment."""
        for look, entity in self._looks:
            look.pose = entity.pose
            if (outline := self._outlines.get(entity.name)) is not None:
                _show(look.components[0], self._pinhole.may_see(outline, entity.pose.to_transformation_matrix()))
        self._scene.update_render(update_sensors=True, update_human_render_cameras=False)
        return take_image(self._camera)

    def _add(self, entity: Any, component: Any) -> None:
        look = sapien.Entity()
        look.add_component(component)
        self._scene.sub_scenes[0].add_entity(look)
        self._looks.append((look, entity))


def _show(component: Any, seen: bool) -> None:
    """Leaves out what is beside the picture: an arm's links are three quarters of a picture's work without a GPU."""
    if seen and not component.is_enabled:
        component.enable()
    elif not seen and component.is_enabled:
        component.disable()


def _empty_scene(render_backend: str) -> ManiSkillScene:
    if not has_vulkan_driver():  # SAPIEN would print errors of its own first
        raise no_vulkan_device("no Vulkan driver is installed")
    backend = parse_sim_and_render_backend("physx_cpu", MANISKILL_NAMES[resolve_render_backend(render_backend)])
    try:
        keep_shaders(backend.render_device)
        raw = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem(backend.render_device)])
    except RuntimeError as error:
        raise no_vulkan_device(error) from error
    return ManiSkillScene([raw], device=backend.device, backend=backend)


def _component(body: Visible) -> Any:
    builder = ActorBuilder()
    for shape in body.shapes:
        if shape.visible:
            add_visual(builder, shape)
    return builder.build_render_component()


def _robot_components(scene: ManiSkillScene, urdf: Path) -> dict[str, Any]:
    """Link name -> what ManiSkill's own loader makes of its visuals."""
    loader = scene.create_urdf_loader()
    loader.name = "looks"
    links = loader.parse(str(urdf))["articulation_builders"][0].link_builders
    return {link.name: link.build_render_component() for link in links if link.visual_records}
