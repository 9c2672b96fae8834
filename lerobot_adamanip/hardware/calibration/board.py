"""ChArUco calibration board: a chessboard with a marker in each white square."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.util.errors import ConfigurationError

DICTIONARY = "DICT_5X5_100"
FEWEST_CORNERS = 8
"""Minimum number of inner corners in a picture."""


@dataclass(frozen=True)
class Board:
    """Board sizes as printed. Measure them with a ruler, since printers scale.

    Attributes:
        columns, rows: squares along x and y.
        square: side length of a square [m].
        marker: side length of a marker [m], smaller than a square.
    """

    columns: int = 7
    rows: int = 5
    square: float = 0.040
    marker: float = 0.030

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 14 and 3 <= self.rows <= 14 and 0.2 * self.square < self.marker < self.square < 1):
            raise ConfigurationError(
                "No ChArUco board has these sizes.",
                got=f"{self.columns} x {self.rows} squares of {self.square} m, markers of {self.marker} m",
                allowed="3 ... 14 squares along a side, less than 1 m, markers smaller than squares",
                hint="--columns 7 --rows 5 --square 0.04 --marker 0.03",
            )

    def image(self, pixels_per_metre: float) -> NDArray[np.uint8]:
        """Returns an image of the board with a white margin of half a square."""
        square = round(self.square * pixels_per_metre)
        size, margin = (self.columns * square, self.rows * square), square // 2
        drawn = _aruco(self)[0].generateImage((size[0] + 2 * margin, size[1] + 2 * margin), marginSize=margin)
        return np.asarray(drawn, np.uint8)

    def detect(self, gray: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the inner corners in a picture (H, W) as points (K, 3) [m] and pixels (K, 2); none if fewer than
        `FEWEST_CORNERS` are found. The board frame starts at its first corner, x right, y down.
        """
        import cv2

        drawn, detector = _aruco(self)
        corners, ids, _, _ = detector.detectBoard(gray)
        if ids is None or len(ids) < FEWEST_CORNERS:
            return np.zeros((0, 3)), np.zeros((0, 2))
        # OpenCV up to 4.13 finds corners half a pixel too far right and down (its issue 25539). Refinement gives the
        # same corner in all versions if its window contains no marker edges.
        clear_of_markers = (self.square - self.marker) / (2 * self.square)
        window = int(np.clip(clear_of_markers * _spacing(np.asarray(corners).reshape(-1, 2)), 2, 8))
        ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
        corners = cv2.cornerSubPix(gray, np.array(corners, np.float32), (window, window), (-1, -1), ends)
        points = np.asarray(drawn.getChessboardCorners(), np.float64)[np.ravel(ids)]
        return points, np.asarray(corners, np.float64).reshape(-1, 2)


def _spacing(corners: NDArray[np.float64]) -> float:
    """Returns the median distance from each corner (K, 2) to its nearest neighbour [px]."""
    apart = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(axis=1)))


@functools.lru_cache(maxsize=4)
def _aruco(board: Board) -> tuple[Any, Any]:
    """Returns OpenCV's board and its detector."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
    return made, cv2.aruco.CharucoDetector(made)
