"""Where the points of an observation come from: rendered, or cast as rays. Both give the same cloud."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from mani_skill.sensors.camera import CameraConfig
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import Cloud, Workspace
from lerobot_env_adamanip.sim.camera import capture, pinhole, points_in_world, resized, take_image
from lerobot_env_adamanip.sim.raycast import Hits, LinkMesh, RayScene, link_mesh
from lerobot_env_adamanip.sim.scene import Visible
from lerobot_env_adamanip.sim.triangles import robot_triangles, shapes_triangles


@dataclass(frozen=True)
class Body:
    """Something rigid that rays can meet: its mesh, and the SAPIEN entity that knows where it is.

    Attributes:
        mesh: of its triangles.
        entity: has a pose.
        rests: whether it stays where it is most of the time, as all of an object does and no link of an arm.
    """

    mesh: LinkMesh
    entity: Any
    rests: bool = False

    def pose(self) -> NDArray[np.float64]:
        """Returns where it is now (4, 4), world frame [m]."""
        return np.asarray(self.entity.pose.to_transformation_matrix(), np.float64)


def visible_bodies(visible: Iterable[Visible], robot: Any, urdf: Path) -> list[Body]:
    """Returns what rays can meet: bodies of our shapes, and an arm's links as its description has them."""
    seen = [(body.entity, shapes_triangles(body.shapes)) for body in visible]
    bodies = [Body(link_mesh(triangles), entity, rests=True) for entity, triangles in seen if len(triangles)]
    meshes = _robot_meshes(urdf)
    root = robot.links[0].entity
    for entity in (link.entity for link in robot.links):
        if (mesh := meshes.get(entity.name)) is not None:
            bodies.append(Body(mesh, entity, rests=entity == root))
    return bodies


@functools.cache
def _robot_meshes(urdf: Path) -> Mapping[str, LinkMesh]:
    """Link name -> mesh: made once a process, in a third of a second."""
    return {name: LinkMesh(triangles) for name, triangles in robot_triangles(urdf).items()}


class Sensor(Protocol):
    """What sees points."""

    def points(self) -> Cloud:
        """Returns (M, 3) [m], robot base frame, in scan order: what is seen now, at least all in the workspace."""


class RenderedSensor:
    """A depth camera of SAPIEN's renderer: all that it sees.

    Args:
        scene: ManiSkill's.
        camera: in it.
        image_camera: takes the image, if that is not the depth camera's.
        image_size: of the image [px].
    """

    def __init__(self, scene: Any, camera: Any, image_camera: Any | None, image_size: int) -> None:
        self._scene, self._camera, self._image_camera, self._size = scene, camera, image_camera, image_size
        self._image: NDArray[np.uint8] | None = None

    def points(self) -> Cloud:
        """Returns (M, 3) [m], robot base frame, in scan order."""
        self._image, points = capture(self._scene, self._camera)
        return points

    def image(self) -> NDArray[np.uint8]:
        """Returns the image (H, W, 3) that belongs to the latest points."""
        if self._image_camera is not None:
            return take_image(self._image_camera)
        if self._image is None:
            self.points()
        assert self._image is not None
        return resized(self._image, self._size)


class RaycastSensor:
    """The same camera by ray casting: what it sees of the workspace.

    Args:
        config: of the camera.
        bodies: what rays can meet.
        workspace: of which points are wanted.
        beside: how far right and below its pixel's middle each ray goes [px].
    """

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
        self._poses: list[NDArray[np.float64] | None] = [None] * len(self._resting)
        self._hits: list[Hits | None] = [None] * len(self._resting)
        self._behind = self._scene.empty()

    def points(self) -> Cloud:
        """Returns (M, 3) [m], robot base frame, in scan order: those of rays that end in the workspace, or near it."""
        millimetres = self.pixels()[1]
        return points_in_world(millimetres * np.float32(1e-3), self._camera.pose)

    def pixels(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Returns pixels (M,), as numbers in scan order, and their points (M, 3), camera frame, in whole mm."""
        self._update_resting()
        depth = self._behind.copy()
        self._scene.cast([(body.mesh, body.pose()) for body in self._moving], depth)
        met = self._scene.met(depth)
        # Cut towards the camera, as ManiSkill's position image has them: both kinds go together.
        points = self._scene.rays.take(met, axis=0) * (np.float32(1e3) * depth[met])[:, None]
        return self._scene.pixels[met], np.trunc(points, out=points)

    def _update_resting(self) -> None:
        """Casts anew at what has moved of what seldom moves; what rays meet of the rest was kept."""
        changed = False
        for index, body in enumerate(self._resting):
            pose = body.pose()
            known = self._poses[index]
            if known is None or not np.array_equal(pose, known):
                self._poses[index], self._hits[index] = pose, self._scene.hits(body.mesh, pose)
                changed = True
        if changed:
            self._behind = self._scene.empty()
            for hits in filter(None, self._hits):
                hits.lower(self._behind)
