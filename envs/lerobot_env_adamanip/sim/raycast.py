"""Depth by ray casting, with one ray per pixel.

This Embree binding has neither instances nor moving meshes. Each link therefore has its own scene, and rays are
transformed into its frame. The depth of one link bounds the rays cast at the next.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_env_adamanip.sim.camera import PinholeCamera, Pose
from lerobot_env_adamanip.sim.triangles import Triangles

Slots = NDArray[np.int64]
"""Indices of rays."""
Depth = NDArray[np.float32]
_MARGIN = 0.004
"""Margin of the workspace for ray hits [m], because points are truncated to whole millimetres along three axes."""
_KEPT_SCENES = 512
"""Number of links cached in a process, enough for some fifty objects; 5,000 triangles take 2 MB."""
_SPLITS = 3
"""Halvings of a link's triangles: its silhouette is approximated by 2^3 boxes."""


class LinkMesh:
    """Triangles of a link (N, 3, 3) [m], link frame, in Embree."""

    def __init__(self, triangles: Triangles) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(_device(), robust=True)
        TriangleMesh(self._scene, triangles)
        self.corners = _corners(_clusters(triangles, _SPLITS))
        """(8 M, 3) corners of M boxes around all triangles [m], link frame."""

    def depths(self, origin: NDArray[np.float64], directions: NDArray[np.float32], farthest: Depth) -> Depth:
        """Returns the depth of each ray's hit with this mesh, at most ``farthest`` (N,)."""
        origins = np.empty_like(directions)
        origins[:] = origin
        reached: Depth = self._scene.run(origins, directions, dists=farthest, query="DISTANCE")
        return np.minimum(reached, farthest)


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
    """Depth of the workspace in one camera's image, link by link. Casts only the K rays that can end in it."""

    def __init__(self, camera: PinholeCamera, workspace: Workspace, beside: tuple[float, float] = (0.0, 0.0)) -> None:
        self._camera = camera
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

    def met(self, depth: Depth) -> Slots:
        """Returns the rays (M,) whose depths (K,) have a hit inside the workspace."""
        return np.flatnonzero(depth < self._farthest)

    def _view(self, mesh: LinkMesh, pose: Pose) -> _View:
        rotation, shift = self._rotation @ pose[:3, :3], self._rotation @ pose[:3, 3] + self._shift
        corners = mesh.corners @ rotation.T + shift
        slots = _within(self._slots, self._camera.rectangles(corners))
        return _View(slots[slots >= 0], rotation, shift, float(-corners[:, 2].max()))

    def _depths(self, mesh: LinkMesh, view: _View, slots: Slots, farthest: Depth) -> Depth:
        directions = self.rays.take(slots, axis=0) @ view.rotation.astype(np.float32)
        return mesh.depths(-view.shift @ view.rotation, directions, farthest)


def _within(slots: Slots, rectangles: NDArray[np.int64]) -> Slots:
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
