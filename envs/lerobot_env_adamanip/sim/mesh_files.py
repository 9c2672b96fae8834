"""Mesh files for SAPIEN, named by a content hash, in the system's temporary folder."""

from __future__ import annotations

import functools
import hashlib
import os
import stat
import tempfile
from pathlib import Path

import numpy as np

from lerobot_adamanip.objects import Shape
from lerobot_adamanip.util.files import write_atomically


def mesh_file(shape: Shape) -> Path:
    """Returns a file with a mesh shape's triangles, flat shaded: each face has its own vertices and normals."""
    assert shape.vertices is not None
    assert shape.faces is not None
    digest = hashlib.sha256(shape.vertices.tobytes() + shape.faces.tobytes()).hexdigest()[:24]
    path = cache_folder() / f"{digest}.obj"
    if not path.is_file():
        _write(path, shape)
    return path


@functools.cache
def cache_folder() -> Path:
    """Returns this user's mesh folder in the system's temporary folder; creates a new one if others can write to it."""
    folder = Path(tempfile.gettempdir()) / f"adamanip_meshes_{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if not is_private(folder):
        return Path(tempfile.mkdtemp(prefix="adamanip_meshes_"))
    return folder


def is_private(folder: Path) -> bool:
    """Returns whether a folder is not a link, belongs to this user, and is not writable for others."""
    told = folder.lstat()
    return (
        stat.S_ISDIR(told.st_mode) and told.st_uid == os.getuid() and not told.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    )


def _write(path: Path, shape: Shape) -> None:
    import trimesh

    assert shape.vertices is not None
    assert shape.faces is not None
    corners = shape.vertices[shape.faces].reshape(-1, 3)
    flat = trimesh.Trimesh(corners, np.arange(shape.faces.size).reshape(-1, 3), process=False)
    content = str(flat.export(file_type="obj", include_normals=True)).rstrip().encode() + b"\n"
    write_atomically(path, content)
