"""Colours and smooth normals of the triangles that rays hit, one row per triangle of `sim.triangles`."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.urdf import Geometry, read_urdf
from lerobot_adamanip.objects import Shape
from lerobot_env_adamanip.sim.triangles import Triangles, box_triangles, mesh_file_triangles, placed, shape_triangles

Floats = NDArray[np.float32]
SMOOTH_BELOW = np.deg2rad(30.0)
"""Faces that meet at a smaller angle share a normal [rad]."""
ROBOT_GLOSS, ROBOT_GREY = 0.9, (0.8, 0.8, 0.8)
"""Gloss of the arm, and the colour of its meshes without a material."""
METAL_DARKER = 0.6
"""Share of a metal's light that is missing, because the scene has no surroundings to reflect."""
_SAME_POINT_M = 1e-5


class Look(NamedTuple):
    """Looks of N triangles: normals at their corners (N, 3, 3), linear colours (N, 3) and gloss (N,), both 0 to 1."""

    normals: Floats
    colors: Floats
    gloss: Floats


def shapes_look(shapes: Iterable[Shape]) -> Look:
    """Returns the looks of a link's visible shapes, one row per triangle of `triangles.shapes_triangles`."""
    parts = []
    for shape in shapes:
        if shape.visible:
            triangles = placed(shape_triangles(shape), shape.pose_in_link)
            # SAPIEN gets meshes with a normal per face, see `sim.mesh_files`.
            normals = flat_normals(triangles) if shape.kind == "mesh" else smooth_normals(triangles)
            material = shape.material
            color = np.asarray(material.color) * (1.0 - METAL_DARKER * material.metallic)
            parts.append(_uniform(normals, color, 1.0 - material.roughness))
    return _joined(parts)


@functools.cache
def robot_look(urdf: Path, link: str) -> Look:
    """Returns the looks of a robot's link, one row per triangle of `triangles.robot_triangles`."""
    return _joined(_visual(urdf, geometry) for geometry in read_urdf(urdf).links[link].visuals)


def _visual(urdf: Path, geometry: Geometry) -> Look:
    if geometry.kind == "box":
        triangles = placed(box_triangles(size / 2 for size in geometry.size), geometry.pose)
        return _uniform(flat_normals(triangles), ROBOT_GREY, ROBOT_GLOSS)
    parts = []
    for corners, mesh in mesh_file_triangles(urdf.parent / geometry.mesh):
        triangles = placed((corners * np.asarray(geometry.size)).astype(np.float32), geometry.pose)
        color = getattr(getattr(mesh.visual, "material", None), "baseColorFactor", None)
        linear = ROBOT_GREY if color is None else np.asarray(color[:3]) / 255  # linear in glTF
        parts.append(_uniform(smooth_normals(triangles), linear, ROBOT_GLOSS))
    return _joined(parts)


def _uniform(normals: Floats, color: Iterable[float], gloss: float) -> Look:
    count = len(normals)
    colors = np.tile(np.asarray(tuple(color), np.float32), (count, 1))
    return Look(normals, colors, np.full(count, gloss, np.float32))


def _joined(parts: Iterable[Look]) -> Look:
    parts = tuple(parts)
    empty = np.zeros((0, 3, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    return Look(*(np.concatenate([none, *column]) for none, *column in zip(empty, *parts, strict=True)))


def flat_normals(triangles: Triangles) -> Floats:
    """Returns each triangle's unit normal at its corners, (N, 3, 3)."""
    return np.repeat(_unit(_area_normals(triangles))[:, None], 3, axis=1).astype(np.float32)


def smooth_normals(triangles: Triangles) -> Floats:
    """Returns unit normals at the corners of N triangles (N, 3, 3).

    A corner's normal is the mean over the triangles that share the point, weighted by area. If it differs from the
    triangle's own normal by more than `SMOOTH_BELOW`, the own normal is used.
    """
    flat = _area_normals(triangles)
    _, point = np.unique(np.round(triangles.reshape(-1, 3) / _SAME_POINT_M), axis=0, return_inverse=True)
    point = point.reshape(-1)
    total: NDArray[np.float64] = np.stack(
        [np.bincount(point, np.repeat(flat[:, axis], 3)) for axis in range(3)], axis=1
    )
    mean, own = _unit(total)[point].reshape(-1, 3, 3), _unit(flat)[:, None]
    sharp = (mean * own).sum(2, keepdims=True) < np.cos(SMOOTH_BELOW)
    return np.where(sharp, own, mean).astype(np.float32)


def _area_normals(triangles: Triangles) -> NDArray[np.float64]:
    corners = triangles.astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals.astype(np.float64, copy=False)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    unit: NDArray[np.float64] = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-20)
    return unit
