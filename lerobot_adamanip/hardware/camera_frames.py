"""Pictures with depth, and when they were taken: what every camera here delivers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Frame:
    """One exposure.

    Attributes:
        stamp: when it was exposed, as well as that is known, `time.perf_counter()` [s]. Never later than ``arrival``.
        arrival: when it reached this process [s, same clock].
        color: (H, W, 3) uint8 RGB; None where not asked for.
        depth: (H, W) uint16 millimetres, 0 where nothing was seen; None where not asked for.
        number: counts up by one for each exposure of a camera; a gap is a dropped one.
    """

    stamp: float
    arrival: float
    color: NDArray[np.uint8] | None
    depth: NDArray[np.uint16] | None
    number: int


@dataclass(frozen=True)
class Intrinsics:
    """How an imager projects, OpenCV's model.

    Attributes:
        matrix: (3, 3) [px].
        distortion: 0, 5 or 8 coefficients, OpenCV's order.
        width, height: of the picture they belong to [px].
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    width: int
    height: int


@dataclass(frozen=True)
class CameraCalibration:
    """Where a camera is, and how it sees: what turns its depth into a cloud.

    Attributes:
        camera: serial number or name.
        depth: of the imager that depth is told in; colour is registered to it or not used.
        depth_in_base: (4, 4) pose of that imager, robot base frame, OpenCV axes [m]; None for a camera on the hand.
        depth_in_tcp: likewise in the tool's frame, for a camera on the hand; None otherwise.
        color: of the colour imager, if it was calibrated.
        depth_in_color: (4, 4) pose of the depth imager in the colour imager's frame [m]; identity if they are one.
    """

    camera: str
    depth: Intrinsics
    depth_in_base: NDArray[np.float64] | None
    depth_in_tcp: NDArray[np.float64] | None = None
    color: Intrinsics | None = None
    depth_in_color: NDArray[np.float64] | None = None
