"""Triangles of all visible shapes and of the robot's visual meshes, without a renderer.

Round shapes are divided as in SAPIEN's renderer, so that rays hit exactly the rendered facets.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from lerobot_adamanip.assets.urdf import Geometry, read_urdf
from lerobot_adamanip.objects import Shape
from lerobot_adamanip.util.errors import SimulatorError

Triangles = NDArray[np.float32]
"""(N, 3, 3) corners [m]."""
_AROUND, _ALONG = 32, 8
"""Facets of SAPIEN's round shapes: around the axis, and from the edge of a capsule's end to its tip."""
_NONE: Triangles = np.zeros((0, 3, 3), np.float32)


def shapes_triangles(shapes: Iterable[Shape]) -> Triangles:
    """Returns the visible triangles of a link's shapes, (N, 3, 3) [m] in its frame."""
    return _joined(placed(shape_triangles(shape), shape.pose_in_link) for shape in shapes if shape.visible)


_UNMOVED = 0.01
"""Tolerance at which Assimp, SAPIEN's file reader, treats a node's transform as the identity. The Panda's fourth link
is rendered 3 mm beside its position in the file."""


def shape_triangles(shape: Shape) -> Triangles:
    """Returns a shape's surface, (N, 3, 3) [m] in its own frame; the axis of round shapes is x."""
    if shape.kind == "box":
        return box_triangles(shape.size)
    if shape.kind == "cylinder":
        radius, half = shape.size
        return _revolved([(half, 0.0), (half, radius), (-half, radius), (-half, 0.0)])
    if shape.kind == "capsule":
        radius, half = shape.size
        angles = np.linspace(0.0, np.pi / 2, _ALONG + 1)
        end = [(half + radius * np.cos(angle), radius * np.sin(angle)) for angle in angles]
        return _revolved([*end, *((-x, r) for x, r in reversed(end))])
    assert shape.vertices is not None
    assert shape.faces is not None
    return np.asarray(shape.vertices[shape.faces], np.float32)


def box_triangles(half_size: Iterable[float]) -> Triangles:
    """Returns the twelve triangles of a box with these half extents [m], (12, 3, 3)."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    sides = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
    quads = (corners * np.asarray(tuple(half_size), np.float32))[sides]
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _revolved(profile: Iterable[tuple[float, float]]) -> Triangles:
    """Revolves points (x, radius) about x, facet by facet; omits facets without area."""
    outline = np.array(tuple(profile))
    angles = 2 * np.pi * np.arange(_AROUND) / _AROUND
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    along = np.broadcast_to(outline[:, None, :1], (len(outline), _AROUND, 1))
    rings = np.concatenate([along, outline[:, None, 1:] * around], axis=2).astype(np.float32)
    a, b = rings[:-1], rings[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    facets = np.concatenate([np.stack(three, axis=2).reshape(-1, 3, 3) for three in ((a, b, c), (a, c, d))])
    area = np.linalg.norm(np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), axis=1)
    faceted: Triangles = facets[area > 1e-12]
    return faceted


@functools.cache
def robot_triangles(urdf: Path) -> Mapping[str, Triangles]:
    """Returns link name -> (N, 3, 3) [m] in that link's frame, for the visual meshes of a robot's URDF.

    Raises:
        SimulatorError: a visual is neither a mesh nor a box.
    """
    links = read_urdf(urdf).links.values()
    visuals = {link.name: _joined(_visual(urdf, visual) for visual in link.visuals) for link in links}
    return {name: triangles for name, triangles in visuals.items() if len(triangles)}


@functools.cache
def robot_outlines(urdf: Path) -> Mapping[str, NDArray[np.float64]]:
    """Returns link name -> corners (N, 3) [m] of the convex hull of its `robot_triangles`."""
    points = {name: triangles.reshape(-1, 3).astype(np.float64) for name, triangles in robot_triangles(urdf).items()}
    return {name: corners[ConvexHull(corners).vertices] for name, corners in points.items()}


def _visual(urdf: Path, geometry: Geometry) -> Triangles:
    if geometry.kind == "box":
        return placed(box_triangles(size / 2 for size in geometry.size), geometry.pose)
    if geometry.kind != "mesh":
        raise SimulatorError(
            "Rays cannot be cast at a robot's visual shape.", got=f"{geometry.kind} in {urdf}", allowed="mesh, box"
        )
    parts = [triangles for triangles, _ in mesh_file_triangles(urdf.parent / geometry.mesh)]
    corners = np.concatenate(parts) * np.asarray(geometry.size)
    return placed(corners.astype(np.float32), geometry.pose)


def mesh_file_triangles(path: Path) -> Iterator[tuple[NDArray[np.float64], Any]]:
    """Yields the triangles (N, 3, 3) of each mesh in a file as SAPIEN places them, in the file's unit, and the mesh."""
    import trimesh

    scene = trimesh.load_scene(path, process=False)
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        mesh = scene.geometry[name]
        unmoved = np.abs(pose - np.eye(4)).max() <= _UNMOVED
        corners = np.asarray(mesh.vertices if unmoved else trimesh.transform_points(mesh.vertices, pose), np.float64)
        yield corners[mesh.faces], mesh


def placed(triangles: Triangles, pose: NDArray[np.float64]) -> Triangles:
    """Returns triangles (N, 3, 3) at a pose (4, 4)."""
    moved: Triangles = (triangles @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    return moved


def _joined(parts: Iterable[Triangles]) -> Triangles:
    return np.concatenate([_NONE, *parts])
