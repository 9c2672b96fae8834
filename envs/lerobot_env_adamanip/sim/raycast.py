"""A camera's depth by ray casting: exactly where each pixel's ray ends, without a renderer.

Embree knows neither instances nor moving meshes (in the binding used here), so each link has a scene of its own, and
rays are taken into the link's frame. What one link leaves of a ray is the most the next one may take of it.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_env_adamanip.sim.triangles import Triangles

Pose = NDArray[np.float64]
_MARGIN = 0.004
"""Rays that end this near the workspace are cast as well: points are cut to whole millimetres along three axes [m]."""
_KEPT_SCENES = 512
"""Of links, in a process: some fifty objects; one of 5,000 triangles takes 2 MB."""
_SPLITS = 3
"""A link's silhouette is taken for that of 2^3 boxes around parts of it: few rays beside it are cast."""
_BEHIND = 1e-3
"""What is nearer to the camera's plane than this cannot be projected [m]."""
_EDGE = 0.01
"""What is nearer than this to a picture's edge counts as in it [m]."""


@dataclass(frozen=True)
class PinholeCamera:
    """A square camera with its principal point in the middle; x right, y up, it looks along -z.

    Attributes:
        pose: (4, 4) in the world.
        size: pixels along a side.
        focal: length [px].
    """

    pose: Pose
    size: int
    focal: float

    @functools.cached_property
    def world_to_camera(self) -> Pose:
        """(4, 4)."""
        inverse: Pose = np.linalg.inv(self.pose).astype(np.float64, copy=False)
        return inverse

    def rays(self, beside: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
        """Returns the directions (size^2, 3) of all pixels in scan order, camera frame; of depth 1 each.

        Args:
            beside: how far right and below the pixel's middle [px].
        """
        across, down = ((np.arange(self.size) + 0.5 - self.size / 2 + shift) / self.focal for shift in beside)
        columns, rows = np.meshgrid(across, -down)
        return np.stack([columns.ravel(), rows.ravel(), np.full(columns.size, -1.0)], axis=1)

    def may_see(self, points: NDArray[np.float64], pose: Pose) -> bool:
        """Whether a body may be in the picture; False only if all of it is beside one of the picture's edges.

        Args:
            points: (N, 3) corners of its convex hull, in its own frame [m].
            pose: of the body in the world (4, 4).
        """
        in_camera = self.world_to_camera @ pose
        x, y, z = (points @ in_camera[:3, :3].T + in_camera[:3, 3]).T
        half = -z * (0.5 * self.size / self.focal) + _EDGE
        beside = x > half, x < -half, y > half, y < -half, z > _EDGE
        return not any(side.all() for side in beside)

    def rectangles(self, corners_in_camera: NDArray[np.float64]) -> NDArray[np.int64]:
        """Returns which pixels may see each of M boxes: (M, 4) of first row, first column, end row, end column.

        Args:
            corners_in_camera: (8 M, 3) [m], eight of each box after the other.
        """
        depth = -corners_in_camera[:, 2]
        # One pixel more on each side: a ray through a pixel's middle is meant.
        scale = self.focal / np.maximum(depth, _BEHIND)
        rows = (self.size / 2 - scale * corners_in_camera[:, 1]).reshape(-1, 8)
        columns = (self.size / 2 + scale * corners_in_camera[:, 0]).reshape(-1, 8)
        edges = np.stack([rows.min(1) - 1, columns.min(1) - 1, rows.max(1) + 2, columns.max(1) + 2], axis=1)
        behind = depth.reshape(-1, 8).min(1) < _BEHIND
        if behind.any():
            edges[behind] = (0, 0, self.size, self.size)
        return np.clip(edges, 0, self.size).astype(np.int64)


class LinkMesh:
    """A link's triangles, ready to be met by rays.

    Args:
        triangles: (N, 3, 3) [m], link frame.
    """

    def __init__(self, triangles: Triangles) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(_device(), robust=True)
        TriangleMesh(self._scene, triangles)
        self.corners = _corners(_clusters(triangles, _SPLITS))
        """(8 M, 3) of M boxes that hold all triangles [m], link frame."""

    def depths(
        self, origin: NDArray[np.float64], directions: NDArray[np.float32], farthest: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Returns how far each ray gets: to this mesh, or ``farthest`` (N,) if it is not met before that."""
        origins = np.empty_like(directions)
        origins[:] = origin
        reached: NDArray[np.float32] = self._scene.run(origins, directions, dists=farthest, query="DISTANCE")
        return np.minimum(reached, farthest)


def _clusters(triangles: Triangles, splits: int) -> list[Triangles]:
    """Halves triangles (N, 3, 3) by their middles along the longest side, again and again: up to 2^splits parts."""
    if splits == 0 or len(triangles) < 2:
        return [triangles]
    middles = triangles.mean(1)
    axis = int(np.argmax(np.ptp(triangles.reshape(-1, 3), axis=0)))
    order, half = np.argsort(middles[:, axis], kind="stable"), len(triangles) // 2
    one, other = triangles[order[:half]], triangles[order[half:]]
    return _clusters(one, splits - 1) + _clusters(other, splits - 1)


def _corners(parts: list[Triangles]) -> NDArray[np.float64]:
    """Returns the corners (8 M, 3) of the box around each of M sets of triangles."""
    lower, upper = (np.stack([edge(part.reshape(-1, 3), axis=0) for part in parts]) for edge in (np.min, np.max))
    choices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return np.where(choices, upper[:, None], lower[:, None]).reshape(-1, 3).astype(np.float64)


@functools.cache
def _device() -> Any:
    from embreex.rtcore import EmbreeDevice

    return EmbreeDevice()


_meshes: dict[str, LinkMesh] = {}


def link_mesh(triangles: Triangles) -> LinkMesh:
    """Returns the mesh of triangles (N, 3, 3): one that was made before for the same ones, if it is still kept."""
    digest = hashlib.sha256(np.ascontiguousarray(triangles)).hexdigest()
    mesh = _meshes.pop(digest, None) or LinkMesh(triangles)
    _meshes[digest] = mesh  # the latest comes last
    if len(_meshes) > _KEPT_SCENES:
        del _meshes[next(iter(_meshes))]
    return mesh


class RayScene:
    """What a camera that stands still sees of the workspace, link by link.

    Args:
        camera: of one episode.
        workspace: only rays that can end in it are cast.
        beside: see `PinholeCamera.rays`.
    """

    def __init__(self, camera: PinholeCamera, workspace: Workspace, beside: tuple[float, float] = (0.0, 0.0)) -> None:
        self._camera = camera
        into_camera = camera.world_to_camera
        self._rotation, self._shift = into_camera[:3, :3], into_camera[:3, 3]
        rays = camera.rays(beside)
        farthest = _farthest(camera, rays, workspace)
        self.pixels: NDArray[np.int64] = np.flatnonzero(farthest > 0.0)
        """Those whose rays are cast, in scan order (K,)."""
        self.rays = rays[self.pixels].astype(np.float32)
        """Their directions (K, 3), camera frame."""
        self._farthest = farthest[self.pixels].astype(np.float32)
        slots = np.full(camera.size**2, -1, np.int64)
        slots[self.pixels] = np.arange(len(self.pixels))
        self._slots = slots.reshape(camera.size, camera.size)

    def empty(self) -> NDArray[np.float32]:
        """Returns the depth at which each ray leaves the workspace (K,) [m]."""
        return self._farthest.copy()

    def hits(self, mesh: LinkMesh, pose: Pose) -> Hits:
        """Returns what rays meet of one link at ``pose`` (4, 4), world frame, whatever else is there."""
        view = self._view(mesh, pose)
        return Hits(view.slots, self._depths(mesh, view, view.slots, self._farthest[view.slots]))

    def cast(self, links: Sequence[tuple[LinkMesh, Pose]], depth: NDArray[np.float32]) -> None:
        """Lowers ``depth`` (K,) [m], of what was cast before, to that of links at their poses (4, 4), world frame."""
        views = [(mesh, self._view(mesh, pose)) for mesh, pose in links]
        # The nearest first: what lies behind it is soon done with.
        for mesh, view in sorted(views, key=lambda each: each[1].nearest):
            farthest = depth[view.slots]
            if view.nearest > 0.0:
                slots = view.slots[farthest > view.nearest]
                farthest = depth[slots]
            else:
                slots = view.slots
            if len(slots):
                depth[slots] = self._depths(mesh, view, slots, farthest)

    def met(self, depth: NDArray[np.float32]) -> NDArray[np.int64]:
        """Returns which rays (M,) of depths (K,) meet something before they leave the workspace."""
        return np.flatnonzero(depth < self._farthest)

    def _view(self, mesh: LinkMesh, pose: Pose) -> _View:
        rotation, shift = self._rotation @ pose[:3, :3], self._rotation @ pose[:3, 3] + self._shift
        corners = mesh.corners @ rotation.T + shift
        slots = _within(self._slots, self._camera.rectangles(corners))
        return _View(slots[slots >= 0], rotation, shift, float(-corners[:, 2].max()))

    def _depths(
        self, mesh: LinkMesh, view: _View, slots: NDArray[np.int64], farthest: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        directions = self.rays.take(slots, axis=0) @ view.rotation.astype(np.float32)
        return mesh.depths(-view.shift @ view.rotation, directions, farthest)


@dataclass(frozen=True)
class Hits:
    """What rays meet of one link: their indices (M,), and depths (M,) [m]."""

    slots: NDArray[np.int64]
    depths: NDArray[np.float32]

    def lower(self, depth: NDArray[np.float32]) -> None:
        """Lowers depths of all rays (K,) to these."""
        depth[self.slots] = np.minimum(depth[self.slots], self.depths)


@dataclass(frozen=True)
class _View:
    """A link as a camera has it.

    Attributes:
        slots: indices (M,) of rays that may meet it.
        rotation, shift: (3, 3), (3,) of its pose in the camera's frame [m].
        nearest: depth before which nothing of it lies [m].
    """

    slots: NDArray[np.int64]
    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]
    nearest: float


def _within(slots: NDArray[np.int64], rectangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the values of ``slots`` (H, W) at the pixels within any of rectangles (M, 4), in scan order."""
    top, left = rectangles[:, :2].min(0).tolist()
    bottom, right = rectangles[:, 2:].max(0).tolist()
    inside = np.zeros((bottom - top, right - left), np.bool_)
    for first_row, first_column, end_row, end_column in (rectangles - (top, left, top, left)).tolist():
        inside[first_row:end_row, first_column:end_column] = True
    return slots[top:bottom, left:right][inside]


def _farthest(camera: PinholeCamera, rays: NDArray[np.float64], workspace: Workspace) -> NDArray[np.float64]:
    """Depth at which each ray (N, 3) leaves the workspace [m]; 0 if it never is in it. -> (N,)."""
    directions, eye = camera.pose[:3, :3] @ rays.T, camera.pose[:3, 3]
    lower, upper = np.asarray(workspace.lower) - _MARGIN, np.asarray(workspace.upper) + _MARGIN
    enters, leaves = np.full(len(rays), -np.inf), np.full(len(rays), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for along, low, high in zip(directions, lower - eye, upper - eye, strict=True):
            one, other = low / along, high / along
            # A ray in one of the box's planes says nothing along that axis: NaN, which these pass over.
            np.fmax(enters, np.minimum(one, other), out=enters)
            np.fmin(leaves, np.maximum(one, other), out=leaves)
    return np.where((leaves > 0.0) & (leaves >= enters), leaves, 0.0)
