"""Point clouds: workspace crop and farthest-point order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import fpsample
import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.util.errors import ConfigurationError

Cloud = NDArray[np.float32]

KDTREE_HEIGHT = 6
"""Bucket height of the k-d line sampler: a tenth faster than the paper's ("QuickFPS") 5 for some 2 * 10^4 points. Where
no two points are equally far it does not change what is sampled."""

DEPTH_SIZE, FEW_POINTS, DEPTH_SIZE_OF_FEW = 320, 2048, 240
"""Side of the depth picture whose pixels are the points [px], and what is enough for clouds of so few."""


@dataclass(frozen=True)
class Workspace:
    """An axis-aligned box in the robot's base frame [m]; what lies outside is not part of the cloud."""

    lower: tuple[float, float, float] = (0.30, -0.36, 0.48)
    upper: tuple[float, float, float] = (0.80, 0.36, 1.05)

    def contains(self, points: Cloud) -> NDArray[np.bool_]:
        """(N, 3) -> (N,): which points are inside."""
        lower, upper = np.asarray(self.lower, points.dtype), np.asarray(self.upper, points.dtype)
        inside = np.ones(len(points), np.bool_)
        for axis in range(3):  # column by column: a reduction over three is slow
            inside &= (points[:, axis] >= lower[axis]) & (points[:, axis] <= upper[axis])
        return inside


DEFAULT_WORKSPACE = Workspace()


def check_num_points(num_points: int) -> int:
    """Returns ``num_points`` if a cloud can have that many; raises `ConfigurationError` otherwise."""
    if 1 <= num_points <= 16_384:
        return num_points
    raise ConfigurationError(
        "Wrong number of points in the cloud.", got=num_points, allowed="1 ... 16384", hint="--num-points 1024"
    )


def as_points(cloud: Any) -> Any:
    """Returns the points (..., N, 3) of clouds (..., 3 N), as a view; clouds (..., N, 3) as they are.

    Args:
        cloud: a numpy array or a torch tensor.

    Raises:
        ConfigurationError: the last dimension is no number of points.
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
    """Returns the side of the depth picture [px] that a cloud of so many points is sampled from.

    The smallest object, a pen, shows 3,670 points at 240 px and 6,500 at 320; two thirds of a cloud's time go with the
    number of pixels.
    """
    return DEPTH_SIZE_OF_FEW if num_points <= FEW_POINTS else DEPTH_SIZE


def farthest_point_order(points: Cloud, num_points: int) -> Cloud:
    """Returns ``num_points`` of the cloud, each the farthest from those before it. (M, 3) -> (num_points, 3).

    The order makes any prefix a farthest-point sample itself, so one dataset serves every smaller N. Equal clouds give
    equal samples: the first point is the first of the sampler's own tree, which the points alone determine. A cloud
    with fewer points is repeated from its start; an empty one is all zeros (a camera that sees nothing must not end an
    episode).
    """
    check_num_points(num_points)
    if len(points) == 0:
        return np.zeros((num_points, 3), np.float32)
    wanted = min(num_points, len(points))
    if len(points) < 2:
        return np.repeat(points[:1], num_points, axis=0).astype(np.float32)
    height = min(KDTREE_HEIGHT, len(points).bit_length() - 1)  # a tree of 2^h buckets needs as many points
    indices = fpsample.bucket_fps_kdline_sampling(points, wanted, h=height, start_idx=0)
    chosen = points[np.asarray(indices, dtype=np.int64)]
    return (
        np.resize(chosen, (num_points, 3)).astype(np.float32)
        if wanted < num_points
        else np.ascontiguousarray(chosen, np.float32)
    )
