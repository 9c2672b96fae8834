"""Coloured images by ray casting, without a renderer: materials, two lights and the shadows of the first.

Lights, ground and tone follow `sim.scene.add_lights`, ManiSkill's ground and SAPIEN's `minimal` shaders, whose images
differ in that they have no shadows. Vectors of M pixels are (3, M): numpy is several times slower on rows of three.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_env_adamanip.sim.looks import Floats, Look
from lerobot_env_adamanip.sim.raycast import Body, PinholeCamera, Pose, Slots, pixels_within
from lerobot_env_adamanip.sim.scene import AMBIENT_LIGHT, DIRECTIONAL_LIGHTS, FARTHEST, NEAREST

SHADOW_OFFSET = 2e-3
"""Distance from its surface at which a shadow ray starts [m]; less than the smallest parts, more than facets err."""
HIGHLIGHT_DOUBLINGS, HIGHLIGHT = 5, 0.05
"""Exponent, as a power of two, and strength of the highlight of a surface with gloss 1."""
GROUND_TILE = 4.0
"""Side length of the ground's texture [m]."""
_SHADOW_CELLS = 64
"""Cells along each side of the grid that shows which bodies may hide a point from the light."""
_LEVELS = 4096
_TO_SRGB = (255 * (np.arange(_LEVELS) / (_LEVELS - 1)) ** (1 / 2.2) + 0.5).astype(np.uint8)
_TO_LIGHTS = [(-np.asarray(way) / np.linalg.norm(way)).astype(np.float32) for way, _ in DIRECTIONAL_LIGHTS]
_LIGHTS = [np.asarray(color, np.float32) / np.float32(np.pi) for _, color in DIRECTIONAL_LIGHTS]


class _Hits(NamedTuple):
    """First hits of the rays of K pixels; all (K,).

    ``owner`` is the index of a body, for the ground the number of bodies, for nothing one more. ``triangle`` is a row
    of the scene's looks, ``u`` and ``v`` are barycentric coordinates in it; ``depth`` is in [m].
    """

    depth: Floats
    owner: NDArray[np.uint8]
    triangle: NDArray[np.int32]
    u: Floats
    v: Floats


class RayPictures:
    """Draws images (H, W, 3) of bodies at their present poses above the ground at height ``ground_z`` [m]."""

    def __init__(self, bodies: Iterable[Body], ground_z: float) -> None:
        self._bodies, self._ground_z = tuple(bodies), ground_z

    @functools.cached_property
    def _looks(self) -> tuple[Look, list[int]]:
        """Looks of the triangles of all bodies, and the first row of each body."""
        looks = [body.look for body in self._bodies]
        first = np.cumsum([0, *(len(look.gloss) for look in looks)]).tolist()
        empty = Look(np.zeros((0, 9), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
        rows = [empty, *(Look(look.normals.reshape(-1, 9), look.colors, look.gloss) for look in looks)]
        return Look(*map(np.concatenate, zip(*rows, strict=True))), first

    def take(self, camera: PinholeCamera) -> NDArray[np.uint8]:
        """Returns a camera's present image."""
        poses, number = [body.pose() for body in self._bodies], len(self._bodies)
        rows = _rays(camera.size, camera.focal) @ camera.pose[:3, :3].T.astype(np.float32)
        hits = self._cast(camera, rows, poses)
        # In the order of bodies, then the ground; what sees nothing is last and stays black, as in SAPIEN's images.
        order = np.argsort(hits.owner, kind="stable")
        ends = np.searchsorted(hits.owner[order], np.arange(number + 1), side="right").tolist()
        seen = order[: ends[-1]]
        depth, rays = hits.depth[seen], np.ascontiguousarray(rows.take(seen, axis=0).T)
        points = camera.pose[:3, 3].astype(np.float32)[:, None] + depth * rays
        to_eye = rays / -_length(rays)
        normals, colors, gloss = self._surface(hits, seen, poses, ends[:-1])
        ground = slice(ends[-2] if number else 0, None)
        colors[:, ground] = ground_colors(points[:, ground], depth[ground] / np.float32(camera.focal))
        normals *= np.copysign(1 / _length(normals), _dot(normals, to_eye))
        shadow = self._shadow(points + np.float32(SHADOW_OFFSET) * normals, _TO_LIGHTS[0] @ normals > 0, poses)
        light = colors * _diffuse(normals, shadow) + _highlight(normals, to_eye, gloss, shadow)
        picture = np.zeros((camera.size**2, 3), np.uint8)
        picture[seen] = _TO_SRGB[np.clip(light * (_LEVELS - 1) + 0.5, 0, _LEVELS - 1).astype(np.int16)].T
        return picture.reshape(camera.size, camera.size, 3)

    def _cast(self, camera: PinholeCamera, rays: Floats, poses: Sequence[Pose]) -> _Hits:
        """Returns what rays (K, 3) with depth 1, world frame, hit first."""
        count, eye = len(rays), camera.pose[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            ground = np.float32(self._ground_z - eye[2]) / rays[:, 2]
        met = (ground > 0) & (ground < FARTHEST)
        hits = _Hits(
            depth=np.where(met, ground, np.float32(FARTHEST)),
            owner=np.where(met, len(poses), len(poses) + 1).astype(np.uint8),
            triangle=np.zeros(count, np.int32),
            u=np.zeros(count, np.float32),
            v=np.zeros(count, np.float32),
        )
        pixels, into_camera = np.arange(count).reshape(camera.size, camera.size), camera.world_to_camera
        in_camera = [into_camera @ pose for pose in poses]
        boxes = [
            body.mesh.corners @ pose[:3, :3].T + pose[:3, 3] for body, pose in zip(self._bodies, in_camera, strict=True)
        ]
        # Nearest body first, because it bounds the rays at bodies behind it.
        for index in sorted(range(len(boxes)), key=lambda index: -boxes[index][:, 2].max()):
            nearest, farthest = -boxes[index][:, 2].max(), -boxes[index][:, 2].min()
            if farthest > NEAREST:
                slots = pixels_within(pixels, camera.rectangles(boxes[index]))
                slots = slots[hits.depth[slots] > nearest]
                if len(slots):
                    self._hit(hits, index, slots, poses[index], (eye, rays))
        return hits

    def _hit(self, hits: _Hits, index: int, slots: Slots, pose: Pose, view: tuple[NDArray[np.float64], Floats]) -> None:
        """Updates ``hits`` with those of the rays ``slots`` (M,) at one body; ``view`` is the eye and all rays."""
        eye, rays = view
        rotation = pose[:3, :3]
        directions = rays.take(slots, axis=0) @ rotation.astype(np.float32)
        met = self._bodies[index].mesh.hits((eye - pose[:3, 3]) @ rotation, directions, hits.depth[slots], NEAREST)
        rows = np.flatnonzero(met["primID"] >= 0)
        slots = slots[rows]
        hits.depth[slots], hits.owner[slots] = met["tfar"][rows] + np.float32(NEAREST), index
        hits.triangle[slots] = met["primID"][rows] + self._looks[1][index]
        hits.u[slots], hits.v[slots] = met["u"][rows], met["v"][rows]

    def _surface(
        self, hits: _Hits, seen: Slots, poses: Sequence[Pose], ends: Sequence[int]
    ) -> tuple[Floats, Floats, Floats]:
        """Returns normals (3, M), linear colours (3, M) and gloss (M,) at the pixels ``seen`` (M,).

        They are in the order of bodies, each up to one of ``ends``, then of the ground, whose colours are missing.
        """
        looks, count = self._looks[0], ends[-1] if ends else 0
        normals, colors = (np.zeros((3, len(seen)), np.float32) for _ in range(2))
        gloss = np.zeros(len(seen), np.float32)
        normals[2] = 1
        triangle, (u, v) = hits.triangle[seen[:count]], (column[seen[:count]] for column in (hits.u, hits.v))
        corners = np.ascontiguousarray(looks.normals.take(triangle, axis=0).T)
        inside = (1 - u - v) * corners[:3] + u * corners[3:6] + v * corners[6:]
        for begin, end, pose in zip([0, *ends], ends, poses, strict=False):
            if begin < end:
                normals[:, begin:end] = pose[:3, :3].astype(np.float32) @ inside[:, begin:end]
        colors[:, :count], gloss[:count] = looks.colors.take(triangle, axis=0).T, looks.gloss[triangle]
        return normals, colors, gloss

    def _shadow(self, starts: Floats, faces: NDArray[np.bool_], poses: Sequence[Pose]) -> NDArray[np.bool_]:
        """Returns which of the points (3, M), world frame, a body hides from the first light if they face it (M,)."""
        shadow = np.zeros(len(faces), np.bool_)
        if not poses:
            return shadow
        basis = _light_basis()
        place = basis @ starts
        meshes = [body.mesh for body in self._bodies]
        corners = [
            basis @ (mesh.corners @ pose[:3, :3].T + pose[:3, 3]).T.astype(np.float32)
            for mesh, pose in zip(meshes, poses, strict=True)
        ]
        may_hide, rows = np.where(faces, _may_hide(place, corners), 0), np.ascontiguousarray(starts.T)
        for index, (mesh, pose) in enumerate(zip(meshes, poses, strict=True)):
            slots = np.flatnonzero(may_hide & np.int64(1 << index))
            slots = slots[(place[2, slots] < corners[index][2].max()) & ~shadow[slots]]
            if len(slots):
                rotation, position = pose[:3, :3].astype(np.float32), pose[:3, 3].astype(np.float32)
                origins = (rows.take(slots, axis=0) - position) @ rotation
                shadow[slots] = mesh.hides(origins, _TO_LIGHTS[0] @ rotation)
        return shadow


def _may_hide(place: Floats, corners: Sequence[Floats]) -> NDArray[np.int64]:
    """Returns a bit per body, (M,), whether its boxes may cover a point as seen from the light.

    Args:
        place: points (3, M) in the frame of `_light_basis`.
        corners: of each body's boxes (3, 8 N), in the same frame.
    """
    boxes = [each[:2].reshape(2, -1, 8) for each in corners]
    lower, upper = [box.min(2) for box in boxes], [box.max(2) for box in boxes]
    first = np.min([low.min(1) for low in lower], axis=0)[:, None]
    scale = _SHADOW_CELLS / (np.max([high.max(1) for high in upper], axis=0)[:, None] - first)
    grid = np.zeros((_SHADOW_CELLS + 2, _SHADOW_CELLS + 2), np.int64)  # with an empty margin
    for index, (low, high) in enumerate(zip(lower, upper, strict=True)):
        begins = ((low - first) * scale).astype(np.int64).T.tolist()
        ends = ((high - first) * scale).astype(np.int64).T.tolist()
        for (left, bottom), (right, top) in zip(begins, ends, strict=True):
            grid[left + 1 : right + 2, bottom + 1 : top + 2] |= 1 << index
    grid[-1], grid[:, -1] = 0, 0
    cells = np.clip(np.floor((place[:2] - first) * scale) + 1, 0, _SHADOW_CELLS + 1).astype(np.int64)
    bits: NDArray[np.int64] = grid.ravel()[cells[0] * (_SHADOW_CELLS + 2) + cells[1]]
    return bits


@functools.cache
def _light_basis() -> Floats:
    """Returns the axes (3, 3) of a frame whose z points to the first light."""
    z = _TO_LIGHTS[0]
    x = np.cross((0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z]).astype(np.float32)


def _diffuse(normals: Floats, shadow: NDArray[np.bool_]) -> Floats:
    """Returns the light (3, M) that surfaces with normals (3, M) scatter."""
    light = np.repeat(np.asarray(AMBIENT_LIGHT, np.float32)[:, None], normals.shape[1], axis=1)
    for number, (to_light, color) in enumerate(zip(_TO_LIGHTS, _LIGHTS, strict=True)):
        facing = np.maximum(to_light @ normals, 0)
        if number == 0:
            facing[shadow] = 0
        light += color[:, None] * facing
    return light


def _highlight(normals: Floats, to_eye: Floats, gloss: Floats, shadow: NDArray[np.bool_]) -> Floats:
    """Returns the light (M,) that surfaces with normals (3, M) and gloss (M,) reflect to the eye, unit (3, M)."""
    total, seen = np.zeros_like(gloss), _dot(normals, to_eye)
    for number, (to_light, color) in enumerate(zip(_TO_LIGHTS, _LIGHTS, strict=True)):
        facing = to_light @ normals
        middle = np.sqrt(np.maximum(2 + 2 * (to_light @ to_eye), 1e-12))  # length of the sum of both directions
        sharp = np.maximum((seen + facing) / middle, 0)
        for _ in range(HIGHLIGHT_DOUBLINGS):
            sharp *= sharp
        lit = (facing > 0) & ~shadow if number == 0 else facing > 0
        total += np.float32(HIGHLIGHT * np.pi * np.mean(color)) * sharp * lit
    return total * gloss


@functools.lru_cache(maxsize=8)
def _rays(size: int, focal: float) -> Floats:
    """Returns the directions (K, 3) of a camera's pixels, camera frame, with depth 1."""
    return PinholeCamera(np.eye(4), size, focal).rays().astype(np.float32)


def ground_colors(points: Floats, pixel_width: Floats) -> Floats:
    """Returns linear colours (3, M) of ManiSkill's ground at points (3, M); ``pixel_width`` (M,) is in metres there."""
    texels, sizes, starts = _ground_texture()
    level = np.log2(np.maximum(pixel_width * np.float32(1.5 * sizes[0] / GROUND_TILE), 1))
    level = np.minimum(level, np.float32(len(sizes) - 1.001))
    lower, place = level.astype(np.int64), points[:2] / np.float32(GROUND_TILE) + np.float32(0.5)
    place -= np.floor(place)
    share, colors = level - lower, np.zeros_like(points)
    for number, weight in ((lower, 1 - share), (lower + 1, share)):
        size = sizes[number]
        column, row = np.minimum((place * size).astype(np.int64), size - 1)
        colors += weight * texels.take(starts[number] + row * size + column, axis=0).T
    return colors


@functools.cache
def _ground_texture() -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Returns ManiSkill's ground texture and its halvings down to 4 texels.

    They are the linear colours (N, 3) of all texels, row by row, and the side and first texel of each halving.
    """
    from mani_skill.utils.building import ground
    from PIL import Image

    image = Image.open(Path(ground.__file__).parent / "assets" / "grid_texture.png").convert("RGB")
    levels: list[Floats] = [((np.asarray(image) / 255) ** 2.2).astype(np.float32)]
    while len(levels[-1]) > 4:
        large = levels[-1]
        levels.append(
            ((large[::2, ::2] + large[1::2, ::2] + large[::2, 1::2] + large[1::2, 1::2]) / 4).astype(np.float32)
        )
    sizes = np.array([len(level) for level in levels])
    return np.concatenate([level.reshape(-1, 3) for level in levels]), sizes, np.cumsum([0, *sizes[:-1] ** 2])


def _dot(a: Floats, b: Floats) -> Floats:
    """Returns the products (M,) of vectors (3, M)."""
    product: Floats = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def _length(vectors: Floats) -> Floats:
    """Returns the lengths (M,) of vectors (3, M)."""
    length: Floats = np.maximum(np.sqrt(_dot(vectors, vectors)), np.float32(1e-12))
    return length
