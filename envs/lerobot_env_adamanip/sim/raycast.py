"""Pinhole cameras, and depth and clouds by ray casting, without a renderer. One ray per pixel.

This Embree binding has neither instances nor moving meshes. Each link therefore has its own scene, and rays are
transformed into its frame. The depth of one link bounds the rays cast at the next.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import PIXEL_CONVENTION
from lerobot_adamanip.contract.pointcloud import Cloud, Workspace
from lerobot_env_adamanip.sim.looks import Look, robot_look, shapes_look
from lerobot_env_adamanip.sim.triangles import Triangles, robot_triangles, shapes_triangles

if TYPE_CHECKING:  # so that it can be imported without a simulator
    import sapien
    from mani_skill.sensors.camera import CameraConfig

    from lerobot_env_adamanip.sim.scene import Visible

Pose = NDArray[np.float64]
OPENCV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])
GL_FROM_BODY = np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Transform between an OpenGL camera and SAPIEN's camera body, which looks along x with z up."""
_BEHIND = 1e-3
"""Minimum depth of points for projection [m]."""
_EDGE = 0.01
"""Margin around an image's edge [m]."""
Slots = NDArray[np.int64]
"""Indices of rays."""
Depth = NDArray[np.float32]
_MARGIN = 0.004
"""Margin of the workspace for ray hits [m], because points are truncated to whole millimetres along three axes."""
_KEPT_SCENES = 512
"""Number of links cached in a process, enough for some fifty objects; 5,000 triangles take 2 MB."""
_SPLITS = 3
"""Halvings of a link's triangles: its silhouette is approximated by 2^3 boxes."""
AROUND = Workspace((-0.8, -1.2, -1.2), (1.8, 1.2, 1.8))
"""Space in depth images, robot base frame [m]."""


# Cameras ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PinholeCamera:
    """A square camera with a centred principal point; x right, y up, looking along -z.

    It has a pose (4, 4) in the world, ``size`` pixels along a side, and a focal length [px].
    """

    pose: Pose
    size: int
    focal: float

    @functools.cached_property
    def world_to_camera(self) -> Pose:
        """Transform (4, 4) from world to camera frame."""
        inverse: Pose = np.linalg.inv(self.pose).astype(np.float64, copy=False)
        return inverse

    def rays(self, beside: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
        """Returns the directions (size^2, 3) of all pixels in scan order, in the camera frame, with depth 1.

        ``beside`` is the offset to the right of and below the pixel's middle [px].
        """
        across, down = ((np.arange(self.size) + 0.5 - self.size / 2 + shift) / self.focal for shift in beside)
        columns, rows = np.meshgrid(across, -down)
        return np.stack([columns.ravel(), rows.ravel(), np.full(columns.size, -1.0)], axis=1)

    def may_see(self, points: NDArray[np.float64], pose: Pose) -> bool:
        """Returns False if a body lies completely outside of the image.

        ``points`` (N, 3) are corners of its convex hull in its own frame [m], ``pose`` (4, 4) is its pose in the world.
        """
        in_camera = self.world_to_camera @ pose
        x, y, z = (points @ in_camera[:3, :3].T + in_camera[:3, 3]).T
        half = -z * (0.5 * self.size / self.focal) + _EDGE
        beside = x > half, x < -half, y > half, y < -half, z > _EDGE
        return not any(side.all() for side in beside)

    def rectangles(self, corners_in_camera: NDArray[np.float64]) -> NDArray[np.int64]:
        """Returns the pixels that may see each of M boxes: (M, 4) with first row, first column, end row, end column.

        The boxes are given by their eight corners, box by box: (8 M, 3) [m], camera frame.
        """
        depth = -corners_in_camera[:, 2]
        # One more pixel on each side, because rays pass through the middles of pixels.
        scale = self.focal / np.maximum(depth, _BEHIND)
        rows = (self.size / 2 - scale * corners_in_camera[:, 1]).reshape(-1, 8)
        columns = (self.size / 2 + scale * corners_in_camera[:, 0]).reshape(-1, 8)
        edges = np.stack([rows.min(1) - 1, columns.min(1) - 1, rows.max(1) + 2, columns.max(1) + 2], axis=1)
        edges[depth.reshape(-1, 8).min(1) < _BEHIND] = (0, 0, self.size, self.size)
        return np.clip(edges, 0, self.size).astype(np.int64)


def pinhole(config: CameraConfig, mount: sapien.Pose | None = None) -> PinholeCamera:
    """Returns ManiSkill's camera for a configuration, on a link at the pose ``mount``, or at rest."""
    return pinhole_at(config.pose.sp if mount is None else mount * config.pose.sp, config.width, config.fov)


def pinhole_at(pose: sapien.Pose, size: int, field_of_view: float) -> PinholeCamera:
    """Returns ManiSkill's camera at a pose in the world, with ``size`` [px] and ``field_of_view`` [rad]."""
    matrix = pose.to_transformation_matrix().astype(np.float64) @ GL_FROM_BODY
    return PinholeCamera(matrix, size, 0.5 * size / np.tan(0.5 * field_of_view))


def points_in_world(points: Cloud, camera_in_world: NDArray[Any]) -> Cloud:
    """Transforms points (M, 3) from a camera's frame to the world by its pose (4, 4). Rounds all clouds alike."""
    rotation, position = camera_in_world[:3, :3].astype(np.float32), camera_in_world[:3, 3].astype(np.float32)
    return points @ rotation.T + position


def camera_parameters(camera: PinholeCamera) -> dict[str, Any]:
    """Returns a camera's calibration as a JSON-serialisable dictionary; the robot's base is the world's origin.

    Keys: ``intrinsics`` (3, 3) [px], ``extrinsics`` (4, 4) pose in the robot's base frame, OpenCV axes [m], ``width``
    and ``height`` [px], ``convention`` (`PIXEL_CONVENTION`).
    """
    focal, middle = float(camera.focal), 0.5 * (camera.size - 1)
    return {
        "convention": PIXEL_CONVENTION,
        "intrinsics": [[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]],
        "extrinsics": (camera.pose @ OPENCV_FROM_GL).tolist(),
        "width": camera.size,
        "height": camera.size,
    }


# Rays at meshes -----------------------------------------------------------------------------------------------------


class LinkMesh:
    """Triangles of a link (N, 3, 3) [m], link frame, in Embree."""

    def __init__(self, triangles: Triangles) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(_device(), robust=True)
        TriangleMesh(self._scene, triangles)
        self.corners = _corners(_clusters(triangles, _SPLITS))
        """(8 M, 3) corners of M boxes around all triangles [m], link frame."""
        lower, upper = self.corners.min(0), self.corners.max(0)
        self.center, self.radius = (lower + upper) / 2, float(np.linalg.norm(upper - lower)) / 2
        """Sphere around all triangles: centre (3,) and radius [m], link frame."""

    def depths(self, origin: NDArray[np.float64], directions: NDArray[np.float32], farthest: Depth) -> Depth:
        """Returns the depth of each ray's hit with this mesh, at most ``farthest`` (N,)."""
        reached: Depth = self._scene.run(_rows(origin, directions), directions, dists=farthest, query="DISTANCE")
        return np.minimum(reached, farthest)

    def hits(
        self, origin: NDArray[np.float64], directions: NDArray[np.float32], farthest: Depth, nearest: float
    ) -> dict[str, Any]:
        """Returns each ray's first hit at a depth between ``nearest`` and ``farthest`` (N,).

        They are ``tfar`` (N,), the depth from ``nearest`` on, ``primID`` (N,) triangle or -1, ``u`` and ``v`` (N,).
        """
        near = np.float32(nearest)
        origins = _rows(origin, directions) + near * directions
        met: dict[str, Any] = self._scene.run(origins, directions, dists=farthest - near, output=1)
        return met

    def first_hits(
        self, origins: NDArray[np.float32], direction: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Returns distance (N,) and triangle (N,), or -1, that rays from ``origins`` (N, 3) along (3,) hit first."""
        met: dict[str, Any] = self._scene.run(origins, _rows(direction, origins), output=1)
        return np.asarray(met["tfar"], np.float64), np.asarray(met["primID"], np.int64)

    def hides(self, origins: NDArray[np.float32], direction: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Returns whether rays from ``origins`` (N, 3) along one direction (3,) hit this mesh."""
        hidden: NDArray[np.bool_] = self._scene.run(origins, _rows(direction, origins), query="OCCLUDED") >= 0
        return hidden


def _rows(vector: NDArray[Any], like: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns ``vector`` (3,) in every row of an array like ``like`` (N, 3)."""
    rows = np.empty_like(like)
    rows[:] = vector
    return rows


def _clusters(triangles: Triangles, splits: int) -> list[Triangles]:
    """Halves triangles (N, 3, 3) along the longest side, recursively, into up to 2^splits parts."""
    if splits == 0 or len(triangles) < 2:
        return [triangles]
    middles = triangles.mean(1)
    axis = int(np.argmax(np.ptp(triangles.reshape(-1, 3), axis=0)))
    order, half = np.argsort(middles[:, axis], kind="stable"), len(triangles) // 2
    one, other = triangles[order[:half]], triangles[order[half:]]
    return _clusters(one, splits - 1) + _clusters(other, splits - 1)


def _corners(parts: list[Triangles]) -> NDArray[np.float64]:
    """Returns the corners (8 M, 3) of the boxes around M sets of triangles."""
    lower, upper = (np.stack([edge(part.reshape(-1, 3), axis=0) for part in parts]) for edge in (np.min, np.max))
    choices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return np.where(choices, upper[:, None], lower[:, None]).reshape(-1, 3).astype(np.float64)


@functools.cache
def _device() -> Any:
    from embreex.rtcore import EmbreeDevice

    return EmbreeDevice()


_meshes: dict[str, LinkMesh] = {}


def link_mesh(triangles: Triangles) -> LinkMesh:
    """Returns the mesh of triangles (N, 3, 3), cached."""
    digest = hashlib.sha256(np.ascontiguousarray(triangles)).hexdigest()
    mesh = _meshes.pop(digest, None) or LinkMesh(triangles)
    _meshes[digest] = mesh  # moved to the end as the latest
    if len(_meshes) > _KEPT_SCENES:
        del _meshes[next(iter(_meshes))]
    return mesh


class _View(NamedTuple):
    """A link in the camera's frame: rays (M,) that may hit it, its rotation, shift and minimum depth [m]."""

    slots: Slots
    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]
    nearest: float


class RayScene:
    """Depth of the workspace in one camera's image, link by link. Casts only the K rays that pass the workspace."""

    def __init__(self, camera: PinholeCamera, workspace: Workspace, beside: tuple[float, float] = (0.0, 0.0)) -> None:
        self.camera = camera
        into_camera = camera.world_to_camera
        self._rotation, self._shift = into_camera[:3, :3], into_camera[:3, 3]
        rays = camera.rays(beside)
        farthest = _farthest(camera, rays, workspace)
        self.pixels: Slots = np.flatnonzero(farthest > 0.0)
        """Pixel indices of the rays, in scan order (K,)."""
        self.rays = rays[self.pixels].astype(np.float32)
        """Directions of the rays (K, 3), camera frame."""
        self._farthest = farthest[self.pixels].astype(np.float32)
        slots = np.full(camera.size**2, -1, np.int64)
        slots[self.pixels] = np.arange(len(self.pixels))
        self._slots = slots.reshape(camera.size, camera.size)

    def empty(self) -> Depth:
        """Returns the depth at which each ray leaves the workspace (K,) [m]."""
        return self._farthest.copy()

    def hits(self, mesh: LinkMesh, pose: Pose) -> tuple[Slots, Depth]:
        """Returns the rays that may hit one link at ``pose`` (4, 4), world frame, and their depths [m]."""
        view = self._view(mesh, pose)
        return view.slots, self._depths(mesh, view, view.slots, self._farthest[view.slots])

    def cast(self, links: Sequence[tuple[LinkMesh, Pose]], depth: Depth) -> None:
        """Reduces ``depth`` (K,) [m] to the hits with links at their poses (4, 4), world frame."""
        views = [(mesh, self._view(mesh, pose)) for mesh, pose in links]
        # Nearest link first, because it bounds the rays at links behind it.
        for mesh, view in sorted(views, key=lambda each: each[1].nearest):
            farthest, slots = depth[view.slots], view.slots
            if view.nearest > 0.0:
                slots = view.slots[farthest > view.nearest]
                farthest = depth[slots]
            if len(slots):
                depth[slots] = self._depths(mesh, view, slots, farthest)

    def triangles(self, mesh: LinkMesh, pose: Pose, slots: Slots) -> NDArray[np.int64]:
        """Returns the triangle of one link at ``pose`` (4, 4), world frame, that each of the rays (M,) hits."""
        view = self._view(mesh, pose)
        directions = self.rays.take(slots, axis=0) @ view.rotation.astype(np.float32)
        hits = mesh.hits(-view.shift @ view.rotation, directions, self._farthest[slots], 0.0)
        return np.asarray(hits["primID"], np.int64)

    def met(self, depth: Depth) -> Slots:
        """Returns the rays (M,) with a hit inside the workspace, from the depths (K,) of all rays."""
        return np.flatnonzero(depth < self._farthest)

    def _view(self, mesh: LinkMesh, pose: Pose) -> _View:
        rotation, shift = self._rotation @ pose[:3, :3], self._rotation @ pose[:3, 3] + self._shift
        corners = mesh.corners @ rotation.T + shift
        slots = pixels_within(self._slots, self.camera.rectangles(corners))
        return _View(slots[slots >= 0], rotation, shift, float(-corners[:, 2].max()))

    def _depths(self, mesh: LinkMesh, view: _View, slots: Slots, farthest: Depth) -> Depth:
        directions = self.rays.take(slots, axis=0) @ view.rotation.astype(np.float32)
        return mesh.depths(-view.shift @ view.rotation, directions, farthest)


def pixels_within(slots: Slots, rectangles: NDArray[np.int64]) -> Slots:
    """Returns the values of ``slots`` (H, W) at the pixels within any of rectangles (M, 4), in scan order."""
    top, left = rectangles[:, :2].min(0).tolist()
    bottom, right = rectangles[:, 2:].max(0).tolist()
    inside = np.zeros((bottom - top, right - left), np.bool_)
    for first_row, first_column, end_row, end_column in (rectangles - (top, left, top, left)).tolist():
        inside[first_row:end_row, first_column:end_column] = True
    return slots[top:bottom, left:right][inside]


def _farthest(camera: PinholeCamera, rays: NDArray[np.float64], workspace: Workspace) -> NDArray[np.float64]:
    """Returns the depth (N,) at which each ray (N, 3) leaves the workspace [m]; 0 if it never enters it."""
    directions, eye = camera.pose[:3, :3] @ rays.T, camera.pose[:3, 3]
    lower, upper = np.asarray(workspace.lower) - _MARGIN, np.asarray(workspace.upper) + _MARGIN
    enters, leaves = np.full(len(rays), -np.inf), np.full(len(rays), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for along, low, high in zip(directions, lower - eye, upper - eye, strict=True):
            one, other = low / along, high / along
            # A ray in one of the box's planes gives NaN along that axis; fmax and fmin ignore it.
            np.fmax(enters, np.minimum(one, other), out=enters)
            np.fmin(leaves, np.maximum(one, other), out=leaves)
    return np.where((leaves > 0.0) & (leaves >= enters), leaves, 0.0)


# Rays at the bodies of a scene --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Body:
    """A rigid body for ray casting.

    Attributes:
        mesh: triangles of the body.
        entity: SAPIEN's entity, which has the pose.
        make_look: returns the looks of the mesh's triangles; called for the first image.
        rests: whether it rarely moves: true for an object's links, false for an arm's.
    """

    mesh: LinkMesh
    entity: Any
    make_look: Callable[[], Look]
    rests: bool = False

    @functools.cached_property
    def look(self) -> Look:
        """Looks of the mesh's triangles."""
        return self.make_look()

    def pose(self) -> Pose:
        """Returns the present pose (4, 4), world frame [m]."""
        return np.asarray(self.entity.pose.to_transformation_matrix(), np.float64)


def visible_bodies(visible: Iterable[Visible], robot: Any, urdf: Path) -> list[Body]:
    """Returns the bodies for ray casting: visible shapes, and the arm's links from its URDF."""
    bodies = []
    for body in visible:
        if len(triangles := shapes_triangles(body.shapes)):
            look = functools.partial(shapes_look, body.shapes)
            bodies.append(Body(link_mesh(triangles), body.entity, look, rests=True))
    meshes, root = _robot_meshes(urdf), robot.links[0].entity
    for entity in (link.entity for link in robot.links if link.entity.name in meshes):
        look = functools.partial(robot_look, urdf, entity.name)
        bodies.append(Body(meshes[entity.name], entity, look, rests=entity == root))
    return bodies


@functools.cache
def _robot_meshes(urdf: Path) -> Mapping[str, LinkMesh]:
    return {name: LinkMesh(triangles) for name, triangles in robot_triangles(urdf).items()}


Measure = Callable[[Depth, "RaycastSensor"], Depth]
"""Turns the exact depths (K,) [m] of a sensor's rays into measured ones; infinity where it measures none."""


class RaycastSensor:
    """Depth camera of the workspace. ``beside`` is the offset of rays right of and below the pixel's middle [px]."""

    def __init__(
        self,
        config: CameraConfig,
        bodies: Iterable[Body],
        workspace: Workspace,
        beside: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.scene = RayScene(pinhole(config), workspace, beside)
        bodies = tuple(bodies)
        self._resting = tuple(body for body in bodies if body.rests)
        self._moving = tuple(body for body in bodies if not body.rests)
        self._hits: list[tuple[Pose, tuple[Slots, Depth]] | None] = [None] * len(self._resting)
        self._behind = self.scene.empty()

    def points(self, measure: Measure | None = None) -> Cloud:
        """Returns (M, 3) [m], robot base frame, in scan order: ray hits in or near the workspace, see `pixels`."""
        millimetres = self.pixels(measure)[1]
        return points_in_world(millimetres * np.float32(1e-3), self.scene.camera.pose)

    def pixels(self, measure: Measure | None = None) -> tuple[Slots, Cloud]:
        """Returns pixels (M,), as indices in scan order, and their points (M, 3), camera frame, in whole mm.

        ``measure`` returns the depths (K,) of all rays as a sensor measures them; without it they are exact.
        """
        changed = False
        for index, body in enumerate(self._resting):
            pose, known = body.pose(), self._hits[index]
            if known is None or not np.array_equal(pose, known[0]):
                self._hits[index] = pose, self.scene.hits(body.mesh, pose)
                changed = True
        if changed:  # a resting body has moved
            self._behind = self.scene.empty()
            for _, (slots, depths) in filter(None, self._hits):
                self._behind[slots] = np.minimum(self._behind[slots], depths)
        depth = self._behind.copy()
        self.scene.cast([(body.mesh, body.pose()) for body in self._moving], depth)
        if measure is not None:
            depth = measure(depth, self)
        met = self.scene.met(depth)
        # Truncated towards the camera, as in ManiSkill's position image, so that both sources are interchangeable.
        points = self.scene.rays.take(met, axis=0) * (np.float32(1e3) * depth[met])[:, None]
        return self.scene.pixels[met], np.trunc(points, out=points)

    def resting_surfaces(self, depth: Depth) -> Iterator[tuple[Body, Slots, NDArray[np.int64]]]:
        """Yields each resting body, the rays (M,) that end on it, and the triangle that each of them hits.

        ``depth`` (K,) is the exact depth of all rays.
        """
        for body, (pose, (slots, depths)) in zip(self._resting, filter(None, self._hits), strict=True):
            ending = slots[(depths <= depth[slots]) & (depths < self.scene.empty()[slots])]
            triangles = self.scene.triangles(body.mesh, pose, ending)
            yield body, ending[triangles >= 0], triangles[triangles >= 0]
