"""Coloured images by ray casting, without a renderer: materials, two lights and the shadows of the first.

Lights, ground and tone follow `sim.scene.add_lights`, ManiSkill's ground and SAPIEN's `minimal` shaders, whose images
differ in that they have no shadows.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_env_adamanip.sim.looks import Floats
from lerobot_env_adamanip.sim.raycast import Body, PinholeCamera, Pose, Slots, pixels_within
from lerobot_env_adamanip.sim.scene import AMBIENT_LIGHT, DIRECTIONAL_LIGHTS

FARTHEST, NEAREST = 10.0, 0.01
"""Range of the camera [m]."""
SHADOW_OFFSET = 2e-3
"""Distance from its surface at which a shadow ray starts [m]; less than the smallest parts, more than facets err."""
HIGHLIGHT_EXPONENT, HIGHLIGHT = 32, 0.05
"""Exponent and strength of the highlight of a surface with gloss 1."""
GROUND_TILE = 4.0
"""Side length of the ground's texture [m]."""
_LEVELS = 4096
_TO_SRGB = (255 * (np.arange(_LEVELS) / (_LEVELS - 1)) ** (1 / 2.2) + 0.5).astype(np.uint8)


class _Surface(NamedTuple):
    """What the rays of all K pixels hit: depth (K,) [m], normal (K, 3), colour (K, 3), gloss (K,), ``body`` (K,).

    ``body`` is False where a ray hits the ground or, at depth `FARTHEST`, nothing.
    """

    depth: Floats
    normal: Floats
    color: Floats
    gloss: Floats
    body: NDArray[np.bool_]


class _Placed(NamedTuple):
    """A body and its present pose (4, 4), world frame."""

    body: Body
    pose: Pose

    @property
    def rotation(self) -> Floats:
        """Rotation of rows of vectors from the world's frame to the body's, (3, 3)."""
        return self.pose[:3, :3].astype(np.float32)


def ray_picture(camera: PinholeCamera, bodies: Sequence[Body], ground_z: float) -> NDArray[np.uint8]:
    """Returns an image (H, W, 3) of bodies at their present poses above the ground at height ``ground_z`` [m]."""
    placed = [_Placed(body, body.pose()) for body in bodies]
    rays = camera.rays().astype(np.float32) @ camera.pose[:3, :3].T.astype(np.float32)
    surface = _cast(camera, rays, placed, ground_z)
    seen = np.flatnonzero(surface.depth < FARTHEST)
    depth, to_eye = surface.depth[seen], rays[seen]
    points = camera.pose[:3, 3].astype(np.float32) + depth[:, None] * to_eye
    to_eye /= -_length(to_eye)
    normals = surface.normal[seen]
    normals /= _length(normals)
    normals *= np.sign(_dot(normals, to_eye))
    colors, ground = surface.color[seen], ~surface.body[seen]
    colors[ground] = ground_colors(points[ground], depth[ground] / np.float32(camera.focal))
    diffuse, highlight = _light(points, normals, to_eye, surface.gloss[seen], placed)
    picture = np.zeros((camera.size**2, 3), np.float32)  # black where nothing is seen, as SAPIEN's images
    picture[seen] = colors * diffuse + highlight
    levels = np.clip(picture * (_LEVELS - 1) + 0.5, 0, _LEVELS - 1).astype(np.int32)
    return _TO_SRGB[levels].reshape(camera.size, camera.size, 3)


def _cast(camera: PinholeCamera, rays: Floats, placed: Sequence[_Placed], ground_z: float) -> _Surface:
    """Returns what rays (K, 3) with depth 1, world frame, hit first."""
    count, eye = len(rays), camera.pose[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.float32(ground_z - eye[2]) / rays[:, 2]
    surface = _Surface(
        depth=np.where((ground > 0) & (ground < FARTHEST), ground, np.float32(FARTHEST)),
        normal=np.tile(np.array((0, 0, 1), np.float32), (count, 1)),
        color=np.zeros((count, 3), np.float32),
        gloss=np.zeros(count, np.float32),
        body=np.zeros(count, np.bool_),
    )
    pixels, into_camera = np.arange(count).reshape(camera.size, camera.size), camera.world_to_camera
    in_camera = [into_camera @ row.pose for row in placed]
    boxes = [row.body.mesh.corners @ pose[:3, :3].T + pose[:3, 3] for row, pose in zip(placed, in_camera, strict=True)]
    # Nearest body first, because it bounds the rays at bodies behind it.
    for row, box in sorted(zip(placed, boxes, strict=True), key=lambda pair: -pair[1][:, 2].max()):
        if -box[:, 2].min() > NEAREST:
            slots = pixels_within(pixels, camera.rectangles(box))
            slots = slots[surface.depth[slots] > -box[:, 2].max()]
            if len(slots):
                _hit(surface, row, slots, eye, rays)
    return surface


def _hit(surface: _Surface, row: _Placed, slots: Slots, eye: NDArray[np.float64], rays: Floats) -> None:
    """Updates ``surface`` with the hits of the rays ``slots`` (M,) with one body."""
    origin, look = (eye - row.pose[:3, 3]) @ row.pose[:3, :3], row.body.look
    hits = row.body.mesh.hits(origin, rays[slots] @ row.rotation, surface.depth[slots])
    met = hits["primID"] >= 0
    slots, triangles = slots[met], hits["primID"][met]
    u, v = hits["u"][met][:, None], hits["v"][met][:, None]
    corners = look.normals[triangles]
    surface.depth[slots] = hits["tfar"][met]
    surface.normal[slots] = ((1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]) @ row.rotation.T
    surface.color[slots], surface.gloss[slots] = look.colors[triangles], look.gloss[triangles]
    surface.body[slots] = True


def _light(
    points: Floats, normals: Floats, to_eye: Floats, gloss: Floats, placed: Sequence[_Placed]
) -> tuple[Floats, Floats]:
    """Returns diffuse light and highlights, (M, 3) and (M, 1), at points with normals (M, 3), world frame [m]."""
    diffuse = np.tile(np.asarray(AMBIENT_LIGHT, np.float32), (len(points), 1))
    highlight = np.zeros((len(points), 1), np.float32)
    for number, (direction, color) in enumerate(DIRECTIONAL_LIGHTS):
        to_light = -np.asarray(direction, np.float32) / np.float32(np.linalg.norm(direction))
        facing = np.clip(normals @ to_light, 0, None)[:, None]
        if number == 0:
            facing[_in_shadow(points + np.float32(SHADOW_OFFSET) * normals, to_light, facing[:, 0] > 0, placed)] = 0
        middle = to_eye + to_light
        middle /= _length(middle)
        diffuse += facing * (np.asarray(color, np.float32) / np.float32(np.pi))
        sharp = np.clip(_dot(normals, middle), 0, None) ** HIGHLIGHT_EXPONENT
        highlight += sharp * (gloss[:, None] * (facing > 0)) * np.float32(HIGHLIGHT * np.mean(color))
    return diffuse, highlight


def _in_shadow(
    starts: Floats, to_light: Floats, facing: NDArray[np.bool_], placed: Sequence[_Placed]
) -> NDArray[np.bool_]:
    """Returns which of the points (M, 3) that face a light a body hides from it."""
    shadow = np.zeros(len(starts), np.bool_)
    if not placed:
        return shadow
    centers = np.stack([row.pose[:3, :3] @ row.body.mesh.center + row.pose[:3, 3] for row in placed]).astype(np.float32)
    radii = np.array([[row.body.mesh.radius] for row in placed], np.float32)
    along = (centers @ to_light)[:, None] - (starts @ to_light)[None]
    squared = _dot(centers, centers) - 2 * (centers @ starts.T) + _dot(starts, starts).T
    near = facing & (along > -radii) & (squared - along**2 < radii**2)
    for row, may_hide in zip(placed, near, strict=True):
        slots = np.flatnonzero(may_hide & ~shadow)
        if len(slots):
            origins = (starts[slots] - row.pose[:3, 3].astype(np.float32)) @ row.rotation
            shadow[slots] = row.body.mesh.hides(origins, to_light @ row.rotation)
    return shadow


def ground_colors(points: Floats, pixel_width: Floats) -> Floats:
    """Returns linear colours (M, 3) of ManiSkill's ground at points (M, 3); ``pixel_width`` (M,) is in metres there."""
    levels = _ground_texture()
    texels = 1.5 * pixel_width * (len(levels[0]) / GROUND_TILE)
    level = np.clip(np.log2(np.maximum(texels, 1)), 0, len(levels) - 1.001)
    place, lower = (points[:, :2] / GROUND_TILE + 0.5) % 1.0, level.astype(np.int64)
    colors = np.empty((len(points), 3), np.float32)
    for number in np.unique(lower):
        rows = np.flatnonzero(lower == number)
        share = (level[rows] - number)[:, None]
        colors[rows] = (1 - share) * _texel(levels[number], place[rows]) + share * _texel(
            levels[number + 1], place[rows]
        )
    return colors


def _texel(texture: Floats, place: Floats) -> Floats:
    cells = np.minimum((place * len(texture)).astype(np.int64), len(texture) - 1)
    texels: Floats = texture[cells[:, 1], cells[:, 0]]
    return texels


@functools.cache
def _ground_texture() -> tuple[Floats, ...]:
    """Returns ManiSkill's ground texture, linear, (S, S, 3), and its halvings down to 4 texels."""
    from mani_skill.utils.building import ground
    from PIL import Image

    image = Image.open(Path(ground.__file__).parent / "assets" / "grid_texture.png").convert("RGB")
    levels: list[Floats] = [((np.asarray(image) / 255) ** 2.2).astype(np.float32)]
    while len(levels[-1]) > 4:
        large = levels[-1]
        levels.append(
            ((large[::2, ::2] + large[1::2, ::2] + large[::2, 1::2] + large[1::2, 1::2]) / 4).astype(np.float32)
        )
    return tuple(levels)


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("ij,ij->i", a, b)[:, None]
    return product


def _length(vectors: Floats) -> Floats:
    length: Floats = np.maximum(np.sqrt(_dot(vectors, vectors)), np.float32(1e-12))
    return length
