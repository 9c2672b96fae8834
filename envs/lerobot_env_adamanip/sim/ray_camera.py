"""Point clouds and images by ray casting, without a renderer."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mani_skill.sensors.camera import CameraConfig
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import Cloud, Workspace
from lerobot_env_adamanip.sim.camera import Pose, pinhole, points_in_world
from lerobot_env_adamanip.sim.raycast import Depth, LinkMesh, RayScene, Slots, link_mesh
from lerobot_env_adamanip.sim.scene import Visible
from lerobot_env_adamanip.sim.triangles import robot_triangles, shapes_triangles

_AROUND = Workspace((-0.8, -1.2, -1.2), (1.8, 1.2, 1.8))
"""Space in shaded images, robot base frame [m]."""
_BACKGROUND = np.array((0.36, 0.37, 0.40), np.float32)
_COLORS = np.array(
    ((0.80, 0.80, 0.82), (0.72, 0.56, 0.36), (0.45, 0.60, 0.78), (0.62, 0.74, 0.50), (0.80, 0.48, 0.42)), np.float32
)
"""Colours of the arm, then of the other bodies in turn."""
_LIGHT = np.array((-0.3, 0.5, 0.8), np.float32)
"""Direction of the light source in the camera frame, with any length."""
_AMBIENT = 0.3


@dataclass(frozen=True)
class Body:
    """A rigid body for ray casting.

    Attributes:
        mesh: triangles of the body.
        entity: SAPIEN's entity, which has the pose.
        rests: whether it rarely moves: true for an object's links, false for an arm's.
    """

    mesh: LinkMesh
    entity: Any
    rests: bool = False

    def pose(self) -> Pose:
        """Returns the present pose (4, 4), world frame [m]."""
        return np.asarray(self.entity.pose.to_transformation_matrix(), np.float64)


def visible_bodies(visible: Iterable[Visible], robot: Any, urdf: Path) -> list[Body]:
    """Returns the bodies for ray casting: visible shapes, and the arm's links from its URDF."""
    seen = [(body.entity, shapes_triangles(body.shapes)) for body in visible]
    bodies = [Body(link_mesh(triangles), entity, rests=True) for entity, triangles in seen if len(triangles)]
    meshes, root = _robot_meshes(urdf), robot.links[0].entity
    links = [link.entity for link in robot.links if link.entity.name in meshes]
    return [*bodies, *(Body(meshes[entity.name], entity, rests=entity == root) for entity in links)]


@functools.cache
def _robot_meshes(urdf: Path) -> Mapping[str, LinkMesh]:
    return {name: LinkMesh(triangles) for name, triangles in robot_triangles(urdf).items()}


class RaycastSensor:
    """Depth camera of the workspace. ``beside`` is the offset of rays right of and below the pixel's middle [px]."""

    def __init__(
        self,
        config: CameraConfig,
        bodies: Iterable[Body],
        workspace: Workspace,
        beside: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._camera = pinhole(config)
        self._scene = RayScene(self._camera, workspace, beside)
        bodies = tuple(bodies)
        self._resting = tuple(body for body in bodies if body.rests)
        self._moving = tuple(body for body in bodies if not body.rests)
        self._hits: list[tuple[Pose, tuple[Slots, Depth]] | None] = [None] * len(self._resting)
        self._behind = self._scene.empty()

    def points(self) -> Cloud:
        """Returns (M, 3) [m], robot base frame, in scan order: ray hits in or near the workspace."""
        millimetres = self.pixels()[1]
        return points_in_world(millimetres * np.float32(1e-3), self._camera.pose)

    def pixels(self) -> tuple[Slots, Cloud]:
        """Returns pixels (M,), as indices in scan order, and their points (M, 3), camera frame, in whole mm."""
        self._update_resting()
        depth = self._behind.copy()
        self._scene.cast([(body.mesh, body.pose()) for body in self._moving], depth)
        met = self._scene.met(depth)
        # Truncated towards the camera, as in ManiSkill's position image, so that both sources are interchangeable.
        points = self._scene.rays.take(met, axis=0) * (np.float32(1e3) * depth[met])[:, None]
        return self._scene.pixels[met], np.trunc(points, out=points)

    def _update_resting(self) -> None:
        """Recasts the rays at resting bodies that have moved."""
        changed = False
        for index, body in enumerate(self._resting):
            pose, known = body.pose(), self._hits[index]
            if known is None or not np.array_equal(pose, known[0]):
                self._hits[index] = pose, self._scene.hits(body.mesh, pose)
                changed = True
        if changed:
            self._behind = self._scene.empty()
            for _, (slots, depths) in filter(None, self._hits):
                self._behind[slots] = np.minimum(self._behind[slots], depths)


def shaded_picture(config: CameraConfig, bodies: Sequence[Body]) -> NDArray[np.uint8]:
    """Returns an image (H, W, 3) of the bodies at their present poses, without their own colours."""
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


def _brightness(points: Cloud) -> NDArray[np.float32]:
    """Returns the brightness (H, W) of points (H, W, 3), camera frame, from the surface through neighbouring points."""
    right, down = (np.roll(points, -1, axis=axis) - points for axis in (1, 0))
    normal = np.cross(down, right)
    length = np.maximum(np.linalg.norm(normal, axis=2), 1e-12)
    facing = (normal @ (_LIGHT / np.linalg.norm(_LIGHT))) / length
    # A pixel without a hit has no surface: it is as dark as a surface that faces away from the light.
    return np.asarray(np.nan_to_num(_AMBIENT + (1 - _AMBIENT) * np.clip(facing, 0, 1), nan=_AMBIENT), np.float32)
