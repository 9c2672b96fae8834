"""Meshes of external assets: read from their folder only, coloured, and decomposed into convex collision parts."""

from __future__ import annotations

import hashlib
import io
import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.checked_xml import broken, numbers, parse_xml
from lerobot_adamanip.assets.paths import MAX_BYTES, inside, resolver
from lerobot_adamanip.assets.urdf import Geometry
from lerobot_adamanip.util.files import write_atomically

logger = logging.getLogger(__name__)

MESH_KINDS = (".obj", ".stl", ".dae", ".glb")
MAX_FACES = 1_000_000
GREY = (0.6, 0.6, 0.6)
NEARLY_CONVEX = 0.85
"""Fraction of the hull's volume above which a mesh collides as its hull."""
THIN = 1e-3
"""Collision thickness of flat meshes [m]."""
COACD_OPTIONS = {
    "threshold": 0.07, "max_convex_hull": 24, "seed": 0, "preprocess_resolution": 30, "resolution": 500,
    "mcts_iterations": 20, "mcts_nodes": 10, "mcts_max_depth": 2,
}  # fmt: skip
"""CoACD settings; its defaults take minutes for one open box, these take seconds for about as many parts."""


@dataclass(frozen=True)
class Surface:
    """A coloured triangle mesh: vertices (V, 3) [m] in its link's frame and faces (F, 3)."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    color: tuple[float, float, float]


def surfaces(folder: Path, geometry: Geometry) -> tuple[Surface, ...]:
    """Returns the surfaces of a visual or collision element, in its link's frame and the URDF's length unit.

    Raises:
        ConfigurationError: the mesh is missing, outside the folder, of an unknown type, or unreadable.
    """
    import trimesh

    to_link, size = geometry.pose.copy(), geometry.size
    if geometry.kind == "mesh":
        parts = _mesh_parts(folder, geometry.mesh)
        to_link[:3, :3] = to_link[:3, :3] * np.asarray(size)
    elif geometry.kind == "box":
        parts = ((trimesh.creation.box(extents=size), None),)
    elif geometry.kind == "sphere":
        parts = ((trimesh.creation.icosphere(subdivisions=2, radius=size[0]), None),)
    else:
        parts = ((trimesh.creation.cylinder(radius=size[0], height=size[1], sections=32), None),)
    placed = []
    for mesh, color in parts:
        faces = np.asarray(mesh.faces, np.int64)
        if np.linalg.det(to_link[:3, :3]) < 0:
            faces = faces[:, ::-1]
        vertices = np.asarray(mesh.vertices, np.float64) @ to_link[:3, :3].T + to_link[:3, 3]
        placed.append(Surface(vertices, faces, geometry.color or color or GREY))
    return tuple(placed)


def _mesh_parts(folder: Path, name: str) -> tuple[tuple[Any, tuple[float, float, float] | None], ...]:
    """Returns the triangle meshes of a file [m], in its frame, each with its main colour."""
    import trimesh

    path = inside(folder, name)
    kind, size = path.suffix.lower(), path.stat().st_size
    if kind not in MESH_KINDS or size > MAX_BYTES:
        allowed = f"{', '.join(MESH_KINDS)} up to {MAX_BYTES} bytes"
        raise broken(path, "not a mesh that can be read.", f"{kind}, {size} bytes", allowed, hint="convert it to .obj")
    data = path.read_bytes()
    unit = _collada_unit(path, data) if kind == ".dae" else 1.0
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:], resolver=resolver(folder, path.parent))
        meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    except Exception as error:
        got = f"{type(error).__name__}: {error}"
        raise broken(path, "cannot be read as a mesh.", got, f"a valid {kind} file") from error
    for mesh in meshes if unit != 1.0 else ():
        mesh.vertices = np.asarray(mesh.vertices) * unit
    if sum(len(mesh.faces) for mesh in meshes) > MAX_FACES or not all(np.isfinite(m.vertices).all() for m in meshes):
        what = "has too many faces, or vertices that are not finite."
        raise broken(path, what, f"{len(meshes)} meshes", f"finite vertices, {MAX_FACES} faces")
    if not meshes:
        logger.warning("%s has no triangles: left out", path)
    return tuple((mesh, _main_color(mesh)) for mesh in meshes)


def _collada_unit(path: Path, data: bytes) -> float:
    """Returns the metres per unit of a Collada file, which trimesh ignores; checks its XML like a URDF's."""
    asset = next((child for child in parse_xml(path, data) if child.tag.rpartition("}")[2] == "asset"), ())
    stated = next((child for child in asset if child.tag.rpartition("}")[2] == "unit"), None)
    unit = 1.0 if stated is None else numbers(path, stated.get("meter", "1"), 1, "the unit of length")[0]
    if unit <= 0:
        raise broken(path, "the unit of length is no length.", unit, "metres per unit, above 0")
    try:
        import collada  # noqa: F401
    except ModuleNotFoundError as error:
        what, hint = "Collada needs a package that is not installed.", "pip install 'lerobot_env_adamanip[assets]'"
        raise broken(path, what, "no module collada", "pycollada", hint=hint) from error
    return unit


def _main_color(mesh: Any) -> tuple[float, float, float] | None:
    """Returns the colour of a mesh's material, or the mean of its texture; None without either."""
    try:
        material = getattr(mesh.visual, "material", None)
        image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
        if image is not None:
            mean = np.asarray(image.convert("RGB").resize((16, 16)), np.float64).reshape(-1, 3).mean(axis=0)
        elif material is not None:
            mean = np.asarray(material.main_color, np.float64)[:3]
        elif mesh.visual.defined:
            mean = np.asarray(mesh.visual.main_color, np.float64)[:3]
        else:
            return None
    except Exception:  # an unreadable image loses the colour, not the object
        logger.warning("a material could not be read: grey instead")
        return None
    linear = (mean / 255) ** 2.2  # files contain sRGB, shaders use linear colours
    return float(linear[0]), float(linear[1]), float(linear[2])


def convex_parts(surface: Surface) -> tuple[tuple[NDArray[np.float64], NDArray[np.int64]], ...]:
    """Returns convex meshes (V, 3), (F, 3) that together cover a surface: its hull, or its CoACD parts."""
    import trimesh

    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=True)
    hull = _hull(surface.vertices)
    if _fills(mesh, hull):
        return ((np.asarray(hull.vertices), np.asarray(hull.faces)),)
    parts = [_hull(vertices) for vertices in _decomposed(mesh)] or [hull]
    return tuple((np.asarray(part.vertices), np.asarray(part.faces)) for part in parts)


def _hull(vertices: NDArray[np.float64]) -> Any:
    import trimesh

    extent = np.ptp(vertices, axis=0)
    thin = float(np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)[-1])
    if extent.min() < THIN or thin < 1e-6 * np.sqrt(len(vertices)):
        steps = THIN / 2 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        vertices = (vertices[:, None] + steps).reshape(-1, 3)
    return trimesh.convex.convex_hull(vertices)


def _fills(mesh: Any, hull: Any) -> bool:
    """Returns whether a mesh is close to its hull: by volume if closed, otherwise by their distance."""
    from scipy.spatial import cKDTree
    from trimesh.sample import sample_surface

    if mesh.is_watertight:
        return bool(abs(mesh.volume) > NEARLY_CONVEX * hull.volume)
    count = 4000
    own, around = (np.asarray(sample_surface(item, count, seed=0)[0]) for item in (mesh, hull))
    spacing = np.sqrt(float(mesh.area) / count)
    gap = cKDTree(own).query(around)[0].max()
    return bool(gap < max(0.006, 4 * spacing))


def _decomposed(mesh: Any) -> list[NDArray[np.float64]]:
    """Returns the vertices of CoACD's parts, cached between runs; empty if CoACD is missing or fails."""
    vertices, faces = np.ascontiguousarray(mesh.vertices, np.float64), np.ascontiguousarray(mesh.faces, np.int64)
    digest = hashlib.sha256(vertices.tobytes() + faces.tobytes() + f"{COACD_OPTIONS}".encode()).hexdigest()[:32]
    path = convex_cache_folder() / f"{digest}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            parts = [np.asarray(stored[key], np.float64) for key in stored.files]
        if all(part.ndim == 2 and part.shape[1] == 3 and len(part) >= 4 for part in parts):
            return parts
    except (OSError, ValueError, EOFError, BadZipFile):
        pass  # absent or damaged: cut again
    try:
        import coacd
    except ModuleNotFoundError:
        logger.warning(
            "a part collides as its hull; pip install 'lerobot_env_adamanip[assets]' cuts it into convex ones"
        )
        return []
    try:
        coacd.set_log_level("error")
        logger.info("cutting a part that is not convex into convex ones (once; kept in %s)", path.parent)
        cut = coacd.run_coacd(coacd.Mesh(vertices, faces), **COACD_OPTIONS)
    except Exception as error:
        logger.warning("CoACD failed (%s): a part that is not convex collides as its hull", error)
        return []
    hulls = [np.asarray(part[0], np.float64) for part in cut]
    content = io.BytesIO()
    np.savez(cast(Any, content), *hulls)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content.getvalue())
    except OSError as error:
        logger.warning("convex parts are not kept: %s", error)
    return hulls


def convex_cache_folder() -> Path:
    """Returns the folder of cached convex parts."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "lerobot_adamanip" / "convex"
