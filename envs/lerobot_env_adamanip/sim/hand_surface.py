"""Surface of the simulated hand, from its meshes: what rays from all sides hit."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import HAND, TOOL
from lerobot_adamanip.hardware.calibration.hand_shape import FINGER_TRAVEL_M, SPACING_M, HandShape
from lerobot_env_adamanip.sim.raycast import LinkMesh
from lerobot_env_adamanip.sim.triangles import Triangles, placed, robot_triangles

FINGERS = {"panda_leftfinger": 1.0, "panda_rightfinger": -1.0}
"""Link of each finger -> its direction of motion along the tool's y."""
RIGID = ("panda_link7", HAND, *FINGERS)
"""Links that are rigid with the tool, except for the fingers' motion."""
SIDES, SIDE_SPACING_M = 60, 0.003
"""Directions that rays come from, and the distance of neighbouring rays [m]."""


def hand_surface(robot: Any, urdf: Path) -> HandShape:
    """Returns the surface of a simulated arm's hand, fingers and last link. Computed once per process.

    Args:
        robot: SAPIEN articulation of the arm, in any posture.
        urdf: its URDF.
    """
    poses = {
        link.entity.name: np.asarray(link.entity.pose.to_transformation_matrix(), np.float64) for link in robot.links
    }
    tool = np.linalg.inv(poses[TOOL])
    in_tool = {name: tool @ poses[name] for name in RIGID}
    for name, direction in FINGERS.items():
        in_tool[name][1, 3] = direction * FINGER_TRAVEL_M  # open: rays reach the inner sides
    key = tuple((name, tuple(np.round(pose, 5).ravel().tolist())) for name, pose in in_tool.items())
    return _surface(urdf, key)


@functools.cache
def _surface(urdf: Path, poses: tuple[tuple[str, tuple[float, ...]], ...]) -> HandShape:
    meshes: Mapping[str, Triangles] = robot_triangles(urdf)
    parts = [placed(meshes[name], np.reshape(pose, (4, 4))) for name, pose in poses]
    owner = np.repeat([FINGERS.get(name, 0.0) for name, _ in poses], [len(part) for part in parts])
    triangles = np.concatenate(parts)
    points, normals, hit = _outside(triangles)
    # One point in each cell, so that the density does not depend on the directions.
    _, first = np.unique(np.round(points / SPACING_M).astype(int), axis=0, return_index=True)
    fingers = owner[hit[first]]
    points = points[first]
    points[:, 1] -= FINGER_TRAVEL_M * fingers
    return HandShape(points, normals[first], fingers)


def _outside(triangles: Triangles) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Returns points (N, 3), outward normals (N, 3) and triangles (N,) that parallel rays from all sides hit."""
    mesh = LinkMesh(triangles)
    edges = triangles[:, 1:].astype(np.float64) - triangles[:, :1]
    across = np.cross(edges[:, 0], edges[:, 1])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    offsets = np.arange(-mesh.radius, mesh.radius, SIDE_SPACING_M)
    grid = np.stack([*map(np.ravel, np.meshgrid(offsets, offsets))], axis=1)
    points, normals, hits = [], [], []
    for direction in _directions(SIDES):
        helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
        right = np.cross(direction, helper)
        right /= np.linalg.norm(right)
        origins = mesh.center + grid @ np.stack([right, np.cross(direction, right)]) - mesh.radius * direction
        distance, triangle = mesh.first_hits(origins.astype(np.float32), direction.astype(np.float32))
        met = np.flatnonzero(triangle >= 0)
        facing = across[triangle[met]] * -np.sign(across[triangle[met]] @ direction)[:, None]
        points.append(origins[met] + distance[met, None] * direction)
        normals.append(facing)
        hits.append(triangle[met])
    return np.concatenate(points), np.concatenate(normals), np.concatenate(hits)


def _directions(count: int) -> NDArray[np.float64]:
    """Returns directions (count, 3), evenly spread over the sphere (Fibonacci)."""
    number = np.arange(count) + 0.5
    z, angle = 1 - 2 * number / count, np.pi * (1 + 5**0.5) * number
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
