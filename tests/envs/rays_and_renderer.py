"""Comparison of ray-cast clouds with rendered clouds, pixel by pixel, before, during and after an expert's episode.

A ray is exact; a renderer rounds triangle corners to 1/256 pixel. At an edge, a pixel may then show the other side. On
a surface at a grazing angle, its depth may differ by millimetres. So pixels that differ by more than 2 mm, but agree
with a ray up to 1/8 pixel away, are counted separately as explained.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import Feedback, KeyFrames
from lerobot_adamanip.experts import make_expert

MOST_OFF = 0.001
"""Maximum share of pixels that differ by more than 1 mm."""
MOST_UNEXPLAINED = 1e-5
"""Maximum share of pixels that no ray beside explains: a renderer sees through a crack between two triangles."""
BESIDE = (1 / 256, 1 / 64, 1 / 16, 1 / 8)
"""Distances of further rays from a pixel's centre [px]."""
MOST_KEY_FRAMES = 30


@dataclass(frozen=True)
class Counts:
    """Pixel counts of a comparison.

    Attributes:
        views: number of compared views.
        pixels: number of pixels that rays or renderer see in the workspace.
        off_1mm: number of pixels that differ by more than 1 mm.
        off_2mm: number of pixels that differ by more than 2 mm.
        explained: number of those that agree with a neighbouring ray.
    """

    views: int = 0
    pixels: int = 0
    off_1mm: int = 0
    off_2mm: int = 0
    explained: int = 0

    def __add__(self, other: Counts) -> Counts:
        return Counts(*(a + b for a, b in zip(asdict(self).values(), asdict(other).values(), strict=True)))

    @property
    def passed(self) -> bool:
        """Returns whether both clouds are equal."""
        unexplained = self.off_2mm - self.explained
        return self.off_1mm <= MOST_OFF * self.pixels and unexplained <= MOST_UNEXPLAINED * self.pixels


def compare(task: Any) -> Counts:
    """Compares both views of a task, created with ``cloud_source="render"``, at its current state."""
    from lerobot_env_adamanip.sim.raycast import pinhole, points_in_world

    camera = pinhole(task.cameras.cloud_config)
    rendered, cast = _rendered(task), _cast(task, 0.0, 0.0)

    def inside(millimetres: NDArray[np.float32]) -> NDArray[np.bool_]:
        points = points_in_world(millimetres * np.float32(1e-3), camera.pose)
        seen: NDArray[np.bool_] = task.options.workspace.contains(points) & (millimetres[:, 2] < -1)
        return seen

    seen = inside(rendered) | inside(cast)
    off = np.abs(rendered - cast).max(axis=1)
    far = np.flatnonzero(seen & (off > 2))
    explained = np.zeros(len(far), np.bool_)
    for right, down in _beside() if len(far) else ():
        other = _cast(task, right, down)
        # The floor is not cast. A ray without a hit is correct if the renderer sees a point outside the workspace.
        nothing = ~inside(rendered)[far] & ~inside(other)[far]
        explained |= nothing | (np.abs(rendered[far] - other[far]).max(axis=1) <= 2)
    return Counts(1, int(seen.sum()), int((seen & (off > 1)).sum()), len(far), int(explained.sum()))


def _beside() -> Iterator[tuple[float, float]]:
    """Yields offsets right and down from a pixel's centre [px], the shortest first."""
    for far in BESIDE:
        yield from ((far * x, far * y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y)


def _rendered(task: Any) -> NDArray[np.float32]:
    """Returns the renderer's points (H * W, 3), camera frame [mm]; 0 for pixels without a point."""
    task.cameras.points()
    return np.asarray(task.cameras.depth_scene.texture("position").reshape(-1, 3), np.float32)


def _cast(task: Any, right: float, down: float) -> NDArray[np.float32]:
    """Returns the rays' points, with each ray shifted by an offset [px]; otherwise like `_rendered`."""
    from lerobot_env_adamanip.sim.raycast import RaycastSensor

    camera, bodies = task.cameras.cloud_config, task.cameras.bodies
    pixels, points = RaycastSensor(camera, bodies, task.options.workspace, (right, down)).pixels()
    image = np.zeros((camera.width**2, 3), np.float32)
    image[pixels] = points
    return image


def views(task: Any, seed: int, every: int) -> Iterator[Counts]:
    """Compares at reset and after each ``every`` key frames of the adaptive expert."""
    task.reset(seed=seed, options={"reconfigure": True})
    yield compare(task)
    rng = np.random.default_rng(seed)
    expert: KeyFrames = make_expert(task.category, "adaptive", task.placement.annotations, generator=rng)
    goal = next(expert)
    for number in range(1, MOST_KEY_FRAMES + 1):
        felt: Feedback = task.execute(goal.action())
        if number % every == 0:
            yield compare(task)
        try:
            goal = expert.send(felt)
        except StopIteration:
            return
