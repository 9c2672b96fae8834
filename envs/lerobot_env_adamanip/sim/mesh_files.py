"""Meshes as files, which is how SAPIEN reads them: written once under a name made of their content, and kept."""

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

MAX_CACHE_BYTES = 512 * 1024**2
"""A process that starts on a larger cache removes what was not used for longest, down to half of this."""
_SEAL = b"# sha256 "


def mesh_file(shape: Shape) -> Path:
    """Returns a file with a mesh shape's triangles, flat shaded: each face keeps its own vertices and normals."""
    assert shape.vertices is not None
    assert shape.faces is not None
    digest = hashlib.sha256(shape.vertices.tobytes() + shape.faces.tobytes()).hexdigest()[:24]
    path = cache_folder() / f"{digest}.obj"
    if not (path.is_file() and _is_whole(path)):
        _write(path, shape)
        _is_whole.cache_clear()
    return path


@functools.cache
def cache_folder() -> Path:
    """Returns this user's folder for meshes in the system's temporary one; a private one if it is somebody else's.

    On a shared machine anybody could make a folder of that name first, and put other meshes into it.
    """
    folder = Path(tempfile.gettempdir()) / f"adamanip_meshes_{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if not is_private(folder):
        return Path(tempfile.mkdtemp(prefix="adamanip_meshes_"))
    shrink(folder, MAX_CACHE_BYTES)
    return folder


def is_private(folder: Path) -> bool:
    """Returns whether a folder is a real one, this user's own, and nobody else can write to it."""
    told = folder.lstat()
    return (
        stat.S_ISDIR(told.st_mode) and told.st_uid == os.getuid() and not told.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    )


def shrink(folder: Path, limit: int) -> None:
    """Removes the files that were not used for longest, down to half of ``limit`` [bytes], if there is more than it."""
    files = []
    for path in folder.glob("*.obj"):
        try:
            told = path.stat()
        except OSError:
            continue  # another process cleans up, too
        files.append((told.st_mtime, told.st_size, path))
    total = sum(size for _, size, _ in files)
    if total <= limit:
        return
    for _, size, path in sorted(files):
        if total <= limit // 2:
            return
        path.unlink(missing_ok=True)
        total -= size


def _write(path: Path, shape: Shape) -> None:
    import trimesh

    assert shape.vertices is not None
    assert shape.faces is not None
    corners = shape.vertices[shape.faces].reshape(-1, 3)
    flat = trimesh.Trimesh(corners, np.arange(shape.faces.size).reshape(-1, 3), process=False)
    content = str(flat.export(file_type="obj", include_normals=True)).rstrip().encode() + b"\n"
    write_atomically(path, content + _SEAL + hashlib.sha256(content).hexdigest().encode() + b"\n")


@functools.lru_cache(maxsize=4096)
def _is_whole(path: Path) -> bool:
    """Whether a file holds what was written to it: its last line is a digest of the rest. Looked at once a process."""
    content, mark, seal = path.read_bytes().rpartition(_SEAL)
    if not mark or seal.strip().decode(errors="replace") != hashlib.sha256(content).hexdigest():
        return False
    os.utime(path)
    return True
