"""A camera, a robot and a board that exist as numbers only, and pictures rendered of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, transform
from lerobot_adamanip.hardware.calibration.hand_eye import Mounting, View
from lerobot_adamanip.hardware.calibration.views import Board, ViewFolder
from lerobot_adamanip.hardware.camera_frames import Intrinsics

Array = NDArray[np.float64]
BOARD = Board()
INTRINSICS = Intrinsics(np.array([[610.0, 0, 322.0], [0, 608.0, 238.0], [0, 0, 1]]), np.zeros(5), 640, 480)
CAMERA = transform((0.55, -0.58, 1.16), matrix_from_rotation_vector(np.array([-2.0, 0.1, 0.3])))
ON_HAND = transform((0.05, 0.01, -0.07), matrix_from_rotation_vector(np.array([0.05, -0.1, 1.5])))
BOARD_POSE = transform((0.02, -0.1, 0.05), matrix_from_rotation_vector(np.array([0.3, 0.2, -0.4])))
DOTS = 4000.0


@dataclass(frozen=True)
class Truth:
    """What a calibration has to find: the camera's pose, and where tool and board were in each picture."""

    mounting: Mounting
    camera: Array
    tcp_in_base: list[Array]
    board_in_camera: list[Array]


def truth(seed: int, count: int = 20, mounting: Mounting = Mounting.FIXED, tilt: float = 0.6) -> Truth:
    """Poses of the board before the camera, 0.45 ... 0.75 m away, tilted to all sides by up to ``tilt`` [rad]."""
    rng = np.random.default_rng(seed)
    camera = CAMERA if mounting is Mounting.FIXED else ON_HAND
    tools, boards = [], []
    for _ in range(count):
        turned = matrix_from_rotation_vector(rng.uniform(-1, 1, 3) * (tilt, tilt, 1.5 * tilt))
        middle = np.array([BOARD.columns, BOARD.rows, 0]) * BOARD.square / 2
        place = np.array([*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.45, 0.75)])
        board = transform(place - turned @ middle, turned)
        seen = camera @ board @ np.linalg.inv(BOARD_POSE)
        boards.append(board)
        tools.append(seen if mounting is Mounting.FIXED else BOARD_POSE @ np.linalg.inv(board) @ np.linalg.inv(camera))
    return Truth(mounting, camera, tools, boards)


def rendered(board_in_camera: Array) -> NDArray[np.uint8]:
    """The picture (H, W) of a board, rendered at twice its size, so that edges are smooth."""
    import cv2

    drawn = BOARD.image(DOTS)
    margin = BOARD.square / 2
    to_metres = np.array([[1 / DOTS, 0, 0.5 / DOTS - margin], [0, 1 / DOTS, 0.5 / DOTS - margin], [0, 0, 1]])
    to_pixels = INTRINSICS.matrix @ board_in_camera[:3, [0, 1, 3]]
    twice = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1.0]])
    size = (2 * INTRINSICS.width, 2 * INTRINSICS.height)
    picture = cv2.warpPerspective(drawn, twice @ to_pixels @ to_metres, size, flags=cv2.INTER_LINEAR, borderValue=90)
    return np.asarray(
        cv2.resize(picture, (INTRINSICS.width, INTRINSICS.height), interpolation=cv2.INTER_AREA), np.uint8
    )


def views_of(known: Truth, seed: int, *, pixels: float = 0.2, metres: float = 1e-4) -> list[View]:
    """The corners found in rendered pictures, with noise on them and on the tool's poses."""
    rng = np.random.default_rng(seed)
    found = []
    for index, (tool, board) in enumerate(zip(known.tcp_in_base, known.board_in_camera, strict=True)):
        points, seen = BOARD.detect(rendered(board))
        moved = transform(rng.normal(0, metres, 3)) @ tool
        found.append(View(f"view_{index:03d}.png", moved, points, seen + rng.normal(0, pixels, seen.shape)))
    return [view for view in found if len(view.points)]


def write_views(folder: Path, known: Truth, **changes: Any) -> ViewFolder:
    """A folder of rendered pictures and poses."""
    made = ViewFolder(folder, "0123", known.mounting, BOARD, INTRINSICS, **changes)
    for tool, board in zip(known.tcp_in_base, known.board_in_camera, strict=True):
        made = made.added(np.repeat(rendered(board)[..., None], 3, axis=2), tool)
    return made
