"""Point clouds: workspace crop and farthest-point order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import fpsample
import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.util.errors import ConfigurationError

Cloud = NDArray[np.float32]

MIN_POINTS, MAX_POINTS = 2, 16_384
"""Allowed numbers of points of a cloud. One point, stored as 3 numbers, would look like a row of points (N, 3)."""
KDTREE_HEIGHT = 6
"""Bucket height of the k-d line sampler. At about 2 * 10^4 points it is 10 % faster than 5, the QuickFPS paper's value.
The samples are equal unless two points are equally far."""

DEPTH_SIZE, FEW_POINTS, DEPTH_SIZE_OF_FEW = 320, 2048, 240
"""Side of the depth image that clouds are sampled from [px]; clouds of at most `FEW_POINTS` use the smaller one."""


@dataclass(frozen=True)
class Workspace:
    """An axis-aligned box in the robot's base frame [m]. Points outside are not part of the cloud."""

    lower: tuple[float, float, float] = (0.30, -0.36, 0.48)
    upper: tuple[float, float, float] = (0.80, 0.36, 1.05)

    def contains(self, points: Cloud) -> NDArray[np.bool_]:
        """Returns the mask of the points inside, (N, 3) -> (N,)."""
        lower, upper = np.asarray(self.lower, points.dtype), np.asarray(self.upper, points.dtype)
        inside = np.ones(len(points), np.bool_)
        for axis in range(3):  # column by column: a reduction over three is slow
            inside &= (points[:, axis] >= lower[axis]) & (points[:, axis] <= upper[axis])
        return inside


DEFAULT_WORKSPACE = Workspace()
FURTHEST_CORNER_M = 10.0
"""Largest coordinate of a workspace's corners, in either direction [m]."""


def check_num_points(num_points: int, smallest: int = MIN_POINTS) -> int:
    """Returns ``num_points`` if it is allowed; raises `ConfigurationError` otherwise."""
    if smallest <= num_points <= MAX_POINTS:
        return num_points
    raise ConfigurationError(
        "Wrong number of points in the cloud.",
        got=num_points,
        allowed=f"{smallest} ... {MAX_POINTS}",
        hint="--num-points 1024",
    )


def as_points(cloud: Any) -> Any:
    """Returns the points (..., N, 3) of clouds (..., 3 N), as a view; clouds (..., N, 3) stay unchanged.

    Args:
        cloud: a numpy array or a torch tensor.

    Raises:
        ConfigurationError: the last dimension is not a multiple of 3.
    """
    width = cloud.shape[-1]
    if width == 3:
        return cloud
    if width % 3:
        raise ConfigurationError(
            "This is no point cloud.",
            got=f"{tuple(cloud.shape)}",
            allowed="(..., 3 N) numbers, x, y, z of each point in turn, or (..., N, 3)",
            hint="adamanip check DATASET",
        )
    return cloud.reshape(*cloud.shape[:-1], width // 3, 3)


def depth_size(num_points: int) -> int:
    """Returns the side of the depth image [px] that ``num_points`` are sampled from.

    The smallest object, a pen, shows 3,670 points at 240 px and 6,500 at 320 px. Two thirds of the time for a cloud
    grow with the number of pixels.
    """
    return DEPTH_SIZE_OF_FEW if num_points <= FEW_POINTS else DEPTH_SIZE


def farthest_point_order(points: Cloud, num_points: int) -> Cloud:
    """Returns ``num_points`` of the cloud, each the farthest from those before it. (M, 3) -> (num_points, 3).

    Any prefix of the result is itself a farthest-point sample, so one dataset serves every smaller N. Equal clouds give
    equal samples: the first point depends on the points alone. A cloud with fewer points is repeated from its start. An
    empty cloud becomes zeros: a camera that sees nothing must not end an episode.
    """
    check_num_points(num_points, smallest=1)
    if len(points) == 0:
        return np.zeros((num_points, 3), np.float32)
    count = min(num_points, len(points))
    if len(points) < 2:
        return np.repeat(points[:1], num_points, axis=0).astype(np.float32)
    height = min(KDTREE_HEIGHT, len(points).bit_length() - 1)  # a tree of 2^h buckets needs at least 2^h points
    indices = fpsample.bucket_fps_kdline_sampling(points, count, h=height, start_idx=0)
    chosen = points[np.asarray(indices, dtype=np.int64)]
    return (
        np.resize(chosen, (num_points, 3)).astype(np.float32)
        if count < num_points
        else np.ascontiguousarray(chosen, np.float32)
    )
