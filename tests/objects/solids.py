"""Points in solids: what a shape is made of, independent of any simulator. Run as a program, prints fingerprints."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.objects import ArticulatedObject, Link, Shape


def face_planes(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals (F, 3) and offsets (F,) of a mesh's faces."""
    assert shape.vertices is not None
    assert shape.faces is not None
    corners = shape.vertices[shape.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals, np.sum(normals * corners[:, 0], axis=1)


def contains(shape: Shape, points: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Which points (N, 3), in the link's frame, lie in the shape blown up by ``margin`` [m]."""
    local = (points - shape.pose_in_link[:3, 3]) @ shape.pose_in_link[:3, :3]
    if shape.kind == "box":
        return np.all(np.abs(local) <= np.asarray(shape.size) + margin, axis=1)
    if shape.kind == "mesh":
        normals, offsets = face_planes(shape)
        return np.all(local @ normals.T <= offsets + margin, axis=1)
    radius, half = shape.size
    beyond = np.abs(local[:, 0]) - half
    across = np.hypot(local[:, 1], local[:, 2])
    if shape.kind == "cylinder":
        return (beyond <= margin) & (across <= radius + margin)
    return np.hypot(np.maximum(beyond, 0), across) <= radius + margin


def box_points(lower: Any, upper: Any, step: float) -> np.ndarray:
    """A grid of points (N, 3) filling a box, its faces included."""
    axes = [np.linspace(a, b, max(2, int(np.ceil((b - a) / step)) + 1)) for a, b in zip(lower, upper, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def link_origin(obj: ArticulatedObject, link: Link) -> np.ndarray:
    """Where a link's frame is in the object's, joints at zero (all axes are parallel)."""
    origin = np.zeros(3)
    while link.joint is not None:
        origin = origin + link.joint.origin
        link = next(parent for parent in obj.links if parent.name == link.parent)
    return origin


def solid(obj: ArticulatedObject, points: np.ndarray, margin: float = 0.0, *, links: Any = None) -> np.ndarray:
    """Which points (N, 3), in the object's frame with joints at zero, lie in a shape that collides."""
    inside = np.zeros(len(points), bool)
    for link in obj.links:
        if links is None or link.name in links:
            local = points - link_origin(obj, link)
            for shape in link.shapes:
                if shape.collides:
                    inside |= contains(shape, local, margin)
    return inside


def fingerprint(thing: Any) -> str:
    """A digest of all that an object consists of, to the last bit."""
    digest = hashlib.sha256()
    if is_dataclass(thing):
        for item in fields(thing):
            digest.update(f"{item.name}:{fingerprint(getattr(thing, item.name))}".encode())
    elif isinstance(thing, np.ndarray):
        digest.update(f"{thing.dtype}{thing.shape}".encode() + thing.tobytes())
    elif isinstance(thing, tuple):
        digest.update("".join(map(fingerprint, thing)).encode())
    else:
        digest.update(repr(float(thing) if isinstance(thing, np.floating) else thing).encode())
    return digest.hexdigest()


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(name, fingerprint(make_object(name)))
