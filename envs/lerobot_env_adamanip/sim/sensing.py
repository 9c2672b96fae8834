"""Errors of an episode's sensors, see `lerobot_adamanip.contract.sensing`. Needs no simulator."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from scipy.special import ndtr

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT
from lerobot_adamanip.contract.pointcloud import Cloud, Workspace
from lerobot_adamanip.contract.rotations import Array, rotation_about, transform
from lerobot_adamanip.contract.seeds import Stream, episode_generator
from lerobot_adamanip.contract.sensing import BASELINE_M, FOCAL_PX, Sensing
from lerobot_adamanip.hardware.depth_cloud import on_a_surface
from lerobot_env_adamanip.sim.looks import Look

if TYPE_CHECKING:
    from lerobot_env_adamanip.sim.raycast import Depth, RaycastSensor

Image = NDArray[np.float32]
T = TypeVar("T")
JUMP_M = 0.03
"""Minimum step of depth within 3 x 3 pixels at a depth edge, beyond an even slope [m]."""
BACKGROUND_M = 1.0
"""Distance behind the scene at which rays without a hit end [m]."""
NOISE_PX, PATCH_PX = 1.0, 5.0
"""Size of the spots of noise, and of lost patches [px]: about that of a matching window, and of a patch of projected
dots."""
BLACK, SHINY = (0.04, 0.01), (0.6, 0.85)
"""Luminance and gloss at which a surface begins to return less depth, and at which it returns least."""


class SensorErrors:
    """Errors of one episode's sensors.

    They have a random stream of their own. Those of a picture depend on the seed and the control tick alone: a second
    picture at the same moment is equal, however often it is observed.

    Args:
        sensing: size of the errors.
        seed, category: of the episode.
        workspace: the camera's error turns the cloud about its middle.
        moment: returns the number of control ticks so far.
        delay: age of clouds and images [control ticks].

    Attributes:
        camera: (4, 4) rigid error of the front camera's clouds, robot base frame: truth -> as reported.
        arm: (4, 4) rigid error of the arm, tool frame.
    """

    def __init__(
        self,
        sensing: Sensing,
        seed: int,
        category: str,
        workspace: Workspace,
        *,
        moment: Callable[[], int],
        delay: int = 0,
    ) -> None:
        self.sensing = sensing
        self._seed, self._category, self._moment, self._delay = seed, category, moment, delay
        self._past: dict[str, dict[int, Any]] = {}
        rng = episode_generator(seed, Stream.SENSING, category)
        middle = (np.asarray(workspace.lower) + workspace.upper) / 2
        self.camera = random_motion(rng, sensing.camera_error_mm, sensing.camera_error_deg, middle)
        self.arm = random_motion(rng, sensing.arm_error_mm, sensing.arm_error_deg)
        self._mounts = {name: random_motion(rng, sensing.camera_error_mm, sensing.camera_error_deg) for name in CAMERAS}
        radius = np.linalg.norm(middle - workspace.lower)
        shift = 1e-3 * (sensing.camera_error_mm + sensing.arm_error_mm)
        self._margin = shift + math.radians(sensing.camera_error_deg + sensing.arm_error_deg) * float(radius)

    def true_pose(self, camera: str, reported: Array) -> Array:
        """Returns the true pose (4, 4) of a camera whose pose is reported as ``reported``, in its link's frame."""
        if camera == FRONT:
            return np.linalg.inv(self.camera) @ reported
        return reported @ self._mounts[camera]

    def around(self, workspace: Workspace) -> Workspace:
        """Returns the box that holds all points that are reported inside a workspace."""
        lower, upper = (
            (np.asarray(corner) + sign * self._margin).tolist()
            for corner, sign in ((workspace.lower, -1), (workspace.upper, 1))
        )
        return Workspace(tuple(lower), tuple(upper))

    def reported(self, points: Cloud, tcp_in_base: Array) -> Cloud:
        """Returns the points (M, 3) of the front camera as a robot with these errors reports them, base frame [m]."""
        error = tcp_in_base @ self.arm @ np.linalg.inv(tcp_in_base) @ self.camera
        return (points @ error[:3, :3].T + error[:3, 3]).astype(np.float32)

    def depths(self, depth: Depth, sensor: RaycastSensor) -> Depth:
        """Returns the depths (K,) [m] of a sensor's rays as measured; infinity where none is returned."""
        if not self.sensing.changes_depth:
            return depth
        return self._measured(depth, sensor).reshape(-1).take(sensor.scene.pixels)

    def cloud_depths(self, depth: Depth, sensor: RaycastSensor) -> Depth:
        """Like `depths`, without the pixels that an arm's `depth_cloud` drops: those that fly between two surfaces."""
        if not self.sensing.changes_depth:
            return depth
        measured = self._measured(depth, sensor)
        kept = on_a_surface(np.where(np.isfinite(measured), 1e3 * measured, 0.0).astype(np.float32))
        return np.where(kept, measured, np.float32(np.inf)).reshape(-1).take(sensor.scene.pixels)

    def _measured(self, depth: Depth, sensor: RaycastSensor) -> Image:
        """Returns the depth image (H, W) [m] as measured."""
        scene = sensor.scene
        absorbed = np.zeros(len(depth), np.float32)
        if self.sensing.dull > 0:
            for body, rays, triangles in sensor.resting_surfaces(depth):
                absorbed[rays] = absorption(body.look)[triangles]
        size, focal = scene.camera.size, scene.camera.focal
        images = np.full((2, size * size), np.inf, np.float32)
        images[:, scene.pixels] = np.where(depth < scene.empty(), depth, np.inf), absorbed
        rng = self._generator(size)
        return measured_depth(*images.reshape(2, size, size), focal=focal, sensing=self.sensing, rng=rng)

    def effort(self, effort: Array) -> Array:
        """Returns the joint torques (7,) [N m] as measured."""
        return effort + self.sensing.effort_noise_nm * self._generator(1).standard_normal(len(effort))

    def delayed(self, sensor: str, value: T) -> T:
        """Stores what a sensor sees now, and returns what it saw `delay` ticks ago, or first."""
        past, now = self._past.setdefault(sensor, {}), self._moment()
        past[now] = value
        old = [moment for moment in past if moment <= now - self._delay]
        for moment in old[:-1]:
            del past[moment]
        return copy.deepcopy(cast(T, next(iter(past.values()))))  # which the caller may change

    def restart(self) -> None:
        """Forgets what the sensors saw: the present state becomes the first."""
        self._past.clear()

    def _generator(self, use: int) -> np.random.Generator:
        return episode_generator(self._seed, Stream.SENSING, self._category, use, 1 + self._moment())


def random_motion(rng: np.random.Generator, mm: float, degrees: float, about: Array | None = None) -> Array:
    """Returns a motion (4, 4) by ``mm`` and ``degrees`` in random directions, about a point (default: the origin)."""
    shift, axis = rng.standard_normal((2, 3))
    center = np.zeros(3) if about is None else about
    rotation = rotation_about(axis, math.radians(degrees))
    return transform(center + 1e-3 * mm * shift / np.linalg.norm(shift) - rotation @ center, rotation)


def absorption(look: Look) -> Image:
    """Returns how little light each triangle (N,) sends back to the camera: 0 matt, 1 black, glass or polished."""
    luminance = look.colors @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    black, shiny = (
        (value - start) / (end - start) for value, (start, end) in ((luminance, BLACK), (look.gloss, SHINY))
    )
    return np.asarray(np.clip(np.maximum(black, shiny), 0.0, 1.0), np.float32)


def measured_depth(depth: Image, absorbed: Image, *, focal: float, sensing: Sensing, rng: np.random.Generator) -> Image:
    """Returns the depth image (H, W) [m] that a stereo camera measures; infinity where it returns none.

    Args:
        depth: true depth (H, W) [m], infinity where nothing is hit.
        absorbed: see `absorption`, (H, W).
        focal: focal length [px].
        sensing: size of the errors.
        rng: generator of the noise.
    """
    seen = np.isfinite(depth)
    if not seen.any():
        return depth
    filled = np.where(seen, depth, depth[seen].max() + np.float32(BACKGROUND_M))
    inverse: Image = np.asarray(1 / filled, np.float32)
    down, right = (_smaller_slope(inverse, axis) for axis in (0, 1))
    near, far = 1 / maximum_filter(inverse, 3), 1 / minimum_filter(inverse, 3)
    # The inverse depth of a plane grows evenly, so that a slope of any size is no edge.
    even = 2 * (np.abs(down) + np.abs(right))
    edge = 1 / near - 1 / far - even > JUMP_M * inverse**2
    chances = rng.random((3, *depth.shape), np.float32)
    noise, patch = (_spots(rng, depth.shape, size) for size in (NOISE_PX, PATCH_PX))
    lost = edge & (chances[0] < sensing.edge_holes)
    if sensing.edge_holes > 0:
        lost |= _occluded(filled, focal)
    lost |= ndtr(patch) < np.maximum(sensing.lost, sensing.dull * absorbed)
    if sensing.grazing_deg > 0:
        lost |= ~edge & (_sine_of_view(inverse, down, right, focal) < math.sin(math.radians(sensing.grazing_deg)))
    flying = edge & (chances[1] < sensing.flying)
    measured = np.where(flying, near + chances[2] * (far - near), filled)
    disparity = FOCAL_PX * BASELINE_M / measured + sensing.disparity_noise_px * noise
    if sensing.disparity_step_px > 0:
        disparity = sensing.disparity_step_px * np.round(disparity / sensing.disparity_step_px)
    measured = FOCAL_PX * BASELINE_M / np.maximum(disparity, 1.0)
    return np.where(seen & ~lost, measured, np.inf).astype(np.float32)


def _spots(rng: np.random.Generator, shape: tuple[int, ...], size: float) -> Image:
    """Returns smooth Gaussian noise (H, W) of variance 1 with spots of a size [px]."""
    white = rng.standard_normal(shape, np.float32)
    smooth = gaussian_filter(white, size, mode="wrap", truncate=3.0)
    return np.asarray(smooth * np.float32(2 * math.sqrt(math.pi) * size), np.float32)


def _occluded(depth: Image, focal: float) -> NDArray[np.bool_]:
    """Returns where the right imager does not see a pixel of the left one: a nearer surface to its right hides it."""
    in_right = np.arange(depth.shape[1]) - focal * BASELINE_M / depth
    hidden = np.zeros(depth.shape, np.bool_)
    hidden[:, :-1] = in_right[:, :-1] >= np.minimum.accumulate(in_right[:, ::-1], axis=1)[:, ::-1][:, 1:]
    return hidden


def _sine_of_view(inverse: Image, down: Image, right: Image, focal: float) -> Image:
    """Returns the sine of the angle between each pixel's ray and its surface; exact on planes.

    Args:
        inverse: inverse depth (H, W) [1/m].
        down: its slope along columns, per pixel.
        right: its slope along rows.
        focal: focal length [px].
    """
    y, x = (np.arange(side, dtype=np.float32) + 0.5 - side / 2 for side in inverse.shape)
    along = inverse - x * right - y[:, None] * down
    normal = np.sqrt(focal**2 * (right**2 + down**2) + along**2)
    ray = np.sqrt(1 + (x**2 + y[:, None] ** 2) / focal**2)
    sine: Image = inverse / (normal * ray)
    return sine


def _smaller_slope(image: Image, axis: int) -> Image:
    """Returns the smaller of the differences to both neighbours along an axis, (H, W)."""
    step = np.diff(image, axis=axis)
    ahead = np.concatenate([step, np.take(step, [-1], axis)], axis)
    behind = np.concatenate([np.take(step, [0], axis), step], axis)
    return np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
