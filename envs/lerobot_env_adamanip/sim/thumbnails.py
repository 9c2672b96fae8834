"""Thumbnails: an object in a small studio, from the front. For people only; no training uses them."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils import sapien_utils
from numpy.typing import NDArray

from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.articulation import build_object
from lerobot_env_adamanip.sim.renderer import empty_scene
from lerobot_env_adamanip.sim.simulation import named_joints

FIELD_OF_VIEW = np.deg2rad(26)
OVERSAMPLING = 2
"""Supersampling factor along each side, because SAPIEN's rasteriser does not smooth edges."""
_FLOOR_COLOR = (0.60, 0.61, 0.63)


def render_thumbnail(obj: ArticulatedObject, *, size: int = 256, open_fraction: float = 0.0) -> NDArray[np.uint8]:
    """Returns an image (size, size, 3) of an object; raises `SimulatorError` if this machine cannot render.

    Doors and lids are open by ``open_fraction`` of their range; knobs stay at rest.
    """
    scene = _studio(obj)
    articulation = build_object(scene, obj, np.eye(4))._objs[0]
    articulation.set_qpos(_posture(obj, articulation, open_fraction))
    pixels = size * OVERSAMPLING
    camera = scene.sub_scenes[0].add_camera("portrait", pixels, pixels, FIELD_OF_VIEW, 0.05, 20.0)
    camera.entity.set_pose(_camera_pose(obj))
    scene.sub_scenes[0].update_render()
    camera.take_picture()
    rendered = np.asarray(camera.get_picture("Color"))[..., :3]
    if rendered.dtype == np.uint8:
        # SAPIEN's image format is global, and ManiSkill's cameras set it to bytes.
        rendered = rendered / np.float32(255)
    smooth = rendered.reshape(size, OVERSAMPLING, size, OVERSAMPLING, 3).mean(axis=(1, 3))
    picture: NDArray[np.uint8] = np.clip(255 * smooth + 0.5, 0, 255).astype(np.uint8)
    return picture


def _posture(obj: ArticulatedObject, articulation: Any, open_fraction: float) -> NDArray[np.float32]:
    positions = []
    names = [link.joint.name for link in obj.links if link.joint is not None]
    for name in named_joints(articulation, names):
        joint = obj.joint(name)
        lower, upper = joint.limits
        # A joint that moves both ways from rest is a knob; one that rests at its limit opens.
        positions.append(open_fraction * upper if lower == 0.0 else 0.0)
    return np.asarray(positions, np.float32)


def _camera_pose(obj: ArticulatedObject) -> sapien.Pose:
    """Returns a pose that looks at the object's middle from the front and above, past an open door to the inside."""
    width, depth, height = obj.size
    joints = [link.joint for link in obj.links if link.joint is not None]
    height += sum(joint.limits[1] * max(0.0, joint.axis[2]) for joint in joints if joint.kind == "prismatic")
    radius = 0.5 * float(np.linalg.norm((width, depth, height)))
    target = np.array([-0.5 * depth + min(0.04, 0.15 * depth), 0.0, 0.48 * height])
    direction = np.array([1.0, 0.52 * _camera_side(obj), 0.42])
    distance = radius / np.sin(FIELD_OF_VIEW / 2)
    eye = target + distance * direction / np.linalg.norm(direction)
    return sapien_utils.look_at(eye, target).sp


def _camera_side(obj: ArticulatedObject) -> float:
    """Returns the sign of the camera's y: away from the hinges."""
    joints = [link.joint for link in obj.links if link.joint is not None]
    hinges = [joint.origin[1] for joint in joints if joint.kind == "revolute" and joint.limits[0] == 0.0]
    return -float(np.sign(hinges[0])) if hinges and hinges[0] else 1.0


def _studio(obj: ArticulatedObject) -> ManiSkillScene:
    """Returns a scene with an endless floor, soft ambient light, and a lamp that casts a shadow."""
    scene = empty_scene()
    raw = scene.sub_scenes[0]
    raw.set_environment_map(_surroundings())
    side = _camera_side(obj)
    raw.set_ambient_light([0.10, 0.10, 0.10])
    key, fill = [-0.75, 0.5 * side, -1.0], [-1.0, -0.9 * side, -0.35]
    raw.add_directional_light(key, [2.0, 1.95, 1.87], shadow=True, shadow_scale=1.0, shadow_map_size=2048)
    raw.add_directional_light(fill, [0.7, 0.73, 0.8])
    floor = raw.create_actor_builder()
    material = sapien.render.RenderMaterial(base_color=[*_FLOOR_COLOR, 1.0], roughness=0.95, specular=0.1)
    floor.add_box_visual(sapien.Pose([0, 0, -0.01]), half_size=[8, 8, 0.01], material=material)
    floor.set_initial_pose(sapien.Pose())
    floor.build_static(name="floor")
    return scene


@functools.cache
def _surroundings() -> Any:
    from sapien.asset import create_dome_envmap

    with tempfile.TemporaryDirectory() as folder:
        return create_dome_envmap(
            str(Path(folder) / "dome.ktx"),
            sky_color=[0.55, 0.55, 0.56],
            ground_color=[0.26, 0.255, 0.25],
            blend=0.4,
            resolution=128,
        )
