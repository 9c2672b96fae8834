"""Scene around the arm: an object on a plinth, lights, cameras."""

from __future__ import annotations

import contextlib
import gc
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import sapien_utils
from mani_skill.utils.building.ground import build_ground
from mani_skill.utils.structs import Articulation
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT
from lerobot_adamanip.objects import ArticulatedObject, Material, Shape
from lerobot_env_adamanip.sim.articulation import NO_SELF_COLLISION, add_visual, build_object, sapien_pose

PERSON_VIEW = 512
"""Side length of ManiSkill's image for people [px]."""
FULL_GC_EVERY = 16
"""Number of scenes between full garbage collections."""
_FROZEN_BY_PYTHON = 1000
"""Bound of the objects that the interpreter itself freezes at its start."""
_clears = itertools.count(1)
NEAREST, FARTHEST = 0.01, 10.0
"""Range of all cameras [m]."""
AMBIENT_LIGHT = [0.35, 0.35, 0.36]
DIRECTIONAL_LIGHTS = [[0.9, 0.5, -1.0], [1.5, 1.45, 1.4]], [[0.6, -0.8, -0.6], [0.6, 0.62, 0.7]]
"""Direction in the world and colour of each light; the first one may cast shadows."""
_PLINTH, _COLUMN = Material((0.45, 0.36, 0.27), 0.8), Material((0.25, 0.26, 0.28), 0.7)


@dataclass(frozen=True)
class Visible:
    """A visible rigid body: the SAPIEN entity with its pose, and its shapes."""

    entity: Any
    shapes: tuple[Shape, ...]


class ObjectScene:
    """An object at height ``floor_z`` [m] on a plinth that extends at least ``plinth_least`` [m] to each side.

    If the ground is below 0, the robot's base stands on a column.
    """

    def __init__(
        self, scene: ManiSkillScene, obj: ArticulatedObject, *, floor_z: float, ground_z: float, plinth_least: float
    ) -> None:
        self.obj = obj
        self.floor_z = floor_z
        self.ground_z = ground_z
        build_ground(scene, altitude=ground_z)
        column = (_build_column(scene, -ground_z),) if ground_z < 0.0 else ()
        plinth = (self._build_plinth(scene, plinth_least),) if floor_z > ground_z else ()
        self._plinth = plinth[0].entity if plinth else None
        self.articulation: Articulation = build_object(scene, obj, np.eye(4))
        entities = {link.entity.name: link.entity for link in self.articulation._objs[0].links}
        links = [Visible(entities[link.name], link.shapes) for link in obj.links]
        self.visible: tuple[Visible, ...] = (*column, *plinth, *links)
        """All visible bodies except the arm and the ground."""

    def _build_plinth(self, scene: ManiSkillScene, min_half: float) -> Visible:
        depth, width = self.obj.size[1] / 2 - 0.02, self.obj.size[0] / 2 - 0.04
        shape = Shape("box", (max(depth, min_half), max(width, min_half), self.floor_z / 2), np.eye(4), _PLINTH)
        builder = _builder(scene, shape)
        builder.add_box_collision(half_size=list(shape.size))
        builder.collision_groups = [1, 1, NO_SELF_COLLISION, 0]
        builder.initial_pose = sapien.Pose([2.0, 0, self.floor_z / 2])
        return Visible(builder.build_kinematic(name="plinth")._objs[0], (shape,))

    def place(self, object_in_base: NDArray[np.float64]) -> None:
        """Moves the object's root to a pose (4, 4) with its joints at zero, and the plinth below it."""
        self.articulation.set_pose(sapien_pose(object_in_base))
        self.articulation.set_qpos(np.zeros((1, self.articulation.max_dof), np.float32))
        if self._plinth is None:
            return
        plinth = object_in_base.copy()
        plinth[:3, 3] += object_in_base[:3, :3] @ (-self.obj.size[1] / 2, 0.0, 0.0)
        plinth[2, 3] = self.floor_z / 2
        self._plinth.set_pose(sapien_pose(plinth))


def _build_column(scene: ManiSkillScene, height: float) -> Visible:
    """Builds the column of the robot's base above lower ground; it is only visual, and nothing comes near it."""
    shape = Shape("box", (0.10, 0.10, height / 2), np.eye(4), _COLUMN, collides=False)
    builder = _builder(scene, shape)
    builder.initial_pose = sapien.Pose([-0.05, 0, -height / 2])
    return Visible(builder.build_static(name="column")._objs[0], (shape,))


def _builder(scene: ManiSkillScene, shape: Shape) -> Any:
    builder = scene.create_actor_builder()
    if scene.can_render():
        add_visual(builder, shape)
    return builder


def add_lights(scene: ManiSkillScene, *, shadow: bool) -> None:
    """Lights the scene from the front and one side."""
    scene.set_ambient_light(AMBIENT_LIGHT)
    for number, (direction, color) in enumerate(DIRECTIONAL_LIGHTS):
        scene.add_directional_light(direction, color, shadow=shadow and number == 0)


def draw_cameras(rng: np.random.Generator, shift: float) -> dict[str, sapien.Pose]:
    """Returns a pose for each of `CAMERAS` in the frame of its link.

    Eye and target are sampled within ``shift`` [m] along each axis, times the camera's ``spread``.
    """
    poses = {}
    for name, view in CAMERAS.items():
        eye = np.asarray(view.eye) + view.spread * rng.uniform(-shift, shift, 3)
        target = np.asarray(view.target) + view.spread * rng.uniform(-shift, shift, 3)
        poses[name] = sapien_utils.look_at(eye, target, view.up).sp
    return poses


def moved_camera(pose: sapien.Pose, move: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> sapien.Pose:
    """Returns a camera's pose after a motion of its matrix (4, 4)."""
    return sapien.Pose(move(np.asarray(pose.to_transformation_matrix(), np.float64)))


def camera_config(name: str, pose: sapien.Pose, size: int, shader: str, mount: Any = None) -> CameraConfig:
    """Returns one of `CAMERAS` at a pose in the frame of ``mount`` or of the world, for images of ``size`` [px]."""
    field = CAMERAS[name].field_of_view
    return CameraConfig(name, pose, size, size, field, NEAREST, FARTHEST, mount=mount, shader_pack=shader)


def person_camera() -> CameraConfig:
    """Returns the camera of ManiSkill's videos."""
    view = CAMERAS[FRONT]
    pose = sapien_utils.look_at(view.eye, view.target)
    return CameraConfig("render_camera", pose, PERSON_VIEW, PERSON_VIEW, view.field_of_view, NEAREST, FARTHEST)


@contextlib.contextmanager
def without_full_gc() -> Iterator[None]:
    """Makes a garbage collection inside the block cheap; ManiSkill runs a full one before each scene.

    A process with torch and LeRobot has a million objects; checking them took 0.26 s of every reset. Every
    `FULL_GC_EVERY`-th time the collection is full and frees the scenes before (7 MB of safes). Objects that the caller
    has frozen stay frozen.
    """
    if next(_clears) % FULL_GC_EVERY == 0 or gc.get_freeze_count() > _FROZEN_BY_PYTHON:
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
