"""Hand-eye calibration from pictures of a board at known poses of the tool.

A fixed camera with the board in the hand and a camera on the hand with a fixed board share one equation:
``board_in_camera = inv(camera) @ moved @ board``. Here ``moved`` is the tool's pose in the base, or its inverse.
Park & Martin (1994) solve it from the board's poses. Then both poses are refined on all corners for accuracy.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import Array, matrix_from_rotation_vector, transform
from lerobot_adamanip.hardware.camera_frames import Intrinsics
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_adamanip.util.errors import ConfigurationError

MIN_VIEWS = 12
MIN_SPREAD_RAD = np.deg2rad(30)
"""Minimum rotation range of the tool about two axes [rad]."""
MAX_RMS_PX = 1.0
"""Maximum error of an accepted calibration [px]."""
_DRAWS, _DRAWN = 60, 6
"""Number of solutions from small subsets. One or two wrong poses spoil a solution from all views."""


class Mounting(enum.StrEnum):
    """Mounting of the camera: beside the robot, or on its hand."""

    FIXED = "fixed"
    WRIST = "wrist"


@dataclass(frozen=True)
class View:
    """One picture of the board.

    Attributes:
        name: name of the picture.
        tcp_in_base: (4, 4) tool pose at the exposure [m].
        points: (K, 3) corners in the board's frame [m].
        pixels: (K, 2) pixel coordinates of the corners.
    """

    name: str
    tcp_in_base: Array
    points: Array
    pixels: Array


@dataclass(frozen=True)
class Residual:
    """Residual of one view.

    Attributes:
        name: name of the view.
        pixels: root mean square over its corners [px].
        position: distance between the board pose from this view alone and from the solution [m].
        angle: angle between these two poses [rad].
    """

    name: str
    pixels: float
    position: float
    angle: float


@dataclass(frozen=True)
class HandEye:
    """Result of a hand-eye calibration.

    Attributes:
        mounting: mounting of the camera.
        camera: (4, 4) camera pose, base frame if fixed, tool frame if on the hand [m].
        board: (4, 4) board pose, tool frame if the camera is fixed, else base frame [m].
        rms: root mean square error over all corners [px].
        residuals: residual of each view.
        position_spread, angle_spread: maximum change of the camera pose if one view is left out [m, rad].
    """

    mounting: Mounting
    camera: Array
    board: Array
    rms: float
    residuals: tuple[Residual, ...]
    position_spread: float
    angle_spread: float


def solve(views: Sequence[View], intrinsics: Intrinsics, mounting: Mounting) -> HandEye:
    """Returns the camera pose from views of one board.

    Raises:
        ConfigurationError: the views are too few, too similar or do not fit, or some contradict the others (the error
            names them).
    """
    poses = np.reshape([view.tcp_in_base for view in views], (-1, 4, 4))
    moved = poses if mounting is Mounting.FIXED else np.linalg.inv(poses)
    _require_variety(views, moved)
    problem = _Problem(views, moved, intrinsics)
    seen = np.stack([_board_in_camera(view, intrinsics) for view in views])
    start = _best_start(problem, moved, seen)
    camera, board = problem.refined(*start)
    pixels = problem.rms_of_views(camera, board)
    _require_agreement(views, pixels)
    rms = float(np.sqrt(np.mean(np.square(problem.errors(camera, board)))))
    fewer = [problem.refined(camera, board, problem.view != index)[0] for index in range(len(views))]
    positions, angles = zip(*(pose_error(other, camera) for other in fewer), strict=True)
    expected = np.linalg.inv(camera) @ moved @ board
    residuals = tuple(
        Residual(view.name, float(error), *pose_error(alone, together))
        for view, error, alone, together in zip(views, pixels, seen, expected, strict=True)
    )
    return HandEye(mounting, camera, board, rms, residuals, max(positions), max(angles))


class _Problem:
    """Least-squares problem over all corners of all views."""

    def __init__(self, views: Sequence[View], moved: Array, intrinsics: Intrinsics) -> None:
        self.moved, self.intrinsics = moved, intrinsics
        self.view = np.repeat(np.arange(len(views)), [len(view.points) for view in views])
        points = np.concatenate([view.points for view in views])
        self.points = np.concatenate([points, np.ones((len(points), 1))], axis=1)
        self.pixels = np.concatenate([view.pixels for view in views])

    def errors(self, camera: Array, board: Array, kept: NDArray[np.bool_] | None = None) -> Array:
        """Returns the errors (K, 2) [px] of all corners, or of those ``kept``. Large for points behind the camera."""
        import cv2

        chosen = ... if kept is None else kept
        board_in_camera = np.linalg.inv(camera) @ self.moved @ board
        points = np.einsum("kij,kj->ki", board_in_camera[self.view[chosen]], self.points[chosen])[:, :3]
        lens, none = self.intrinsics, np.zeros(3)
        pixels = cv2.projectPoints(np.ascontiguousarray(points), none, none, lens.matrix, lens.distortion)[0][:, 0]
        return np.asarray(np.where(points[:, 2:] > 1e-3, pixels, 1e6) - self.pixels[chosen])

    def rms_of_views(self, camera: Array, board: Array) -> Array:
        """Returns the error of each view (V,) [px]."""
        squares = np.square(self.errors(camera, board)).mean(axis=1)
        return np.asarray(np.sqrt(np.bincount(self.view, squares) / np.bincount(self.view)))

    def refined(self, camera: Array, board: Array, kept: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
        """Returns the poses with the smallest error. Outliers count less (soft L1)."""
        from scipy.optimize import least_squares

        def poses(step: Array) -> tuple[Array, Array]:
            camera_step, board_step = (transform(s[:3], matrix_from_rotation_vector(s[3:])) for s in step.reshape(2, 6))
            return camera @ camera_step, board @ board_step

        def errors(step: Array) -> Array:
            return self.errors(*poses(step), kept).ravel()

        return poses(least_squares(errors, np.zeros(12), loss="soft_l1", x_scale="jac", max_nfev=100).x)


def _board_in_camera(view: View, intrinsics: Intrinsics) -> Array:
    import cv2

    _, turn, position = cv2.solvePnP(view.points, view.pixels, intrinsics.matrix, intrinsics.distortion)
    return transform(np.ravel(position), matrix_from_rotation_vector(np.asarray(turn, np.float64).ravel()))


def _best_start(problem: _Problem, moved: Array, seen: Array) -> tuple[Array, Array]:
    """Returns the solution with the smallest median error, from all views or a small subset."""
    rng = np.random.default_rng(0)
    subsets = [np.arange(len(moved)), *(rng.choice(len(moved), _DRAWN, replace=False) for _ in range(_DRAWS))]
    starts = [start for subset in subsets if (start := _park(moved[subset], seen[subset])) is not None]
    return min(starts, key=lambda start: float(np.median(problem.rms_of_views(*start))))


def _park(moved: Array, seen: Array) -> tuple[Array, Array] | None:
    """Returns Park & Martin's solution with the median board pose; None if it is not finite."""
    import cv2

    hand = np.linalg.inv(moved)  # OpenCV's "gripper to base" for a camera on the gripper
    rotation, position = cv2.calibrateHandEye(
        list(hand[:, :3, :3]),
        list(hand[:, :3, 3]),
        list(seen[:, :3, :3]),
        list(seen[:, :3, 3]),
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    camera = transform(np.ravel(position), rotation)
    if not np.isfinite(camera).all():
        return None
    boards = np.linalg.inv(moved) @ camera @ seen
    middle = np.median(boards[:, :3, 3], axis=0)
    nearest = boards[np.argmin(np.linalg.norm(boards[:, :3, 3] - middle, axis=1))]
    return camera, transform(middle, nearest[:3, :3])


def _require_variety(views: Sequence[View], moved: Array) -> None:
    from scipy.spatial.transform import Rotation

    if len(views) < MIN_VIEWS:
        raise ConfigurationError(
            "Too few pictures of the board.",
            got=f"the board found in {len(views)}",
            allowed=f"at least {MIN_VIEWS}; 20 are better",
            hint="more poses, board whole in the picture and lit evenly",
        )
    # rotation ranges about the principal axes, largest first
    rotations = Rotation.from_matrix(moved[:, :3, :3])
    turns = (rotations.mean().inv() * rotations).as_rotvec()
    axes = np.linalg.svd(turns - turns.mean(axis=0))[2]
    spread = np.sort(np.ptp(turns @ axes.T, axis=0))[::-1]
    if spread[1] < MIN_SPREAD_RAD:
        degrees = ", ".join(f"{degree:.0f}" for degree in np.rad2deg(spread))
        raise ConfigurationError(
            "The poses are too much alike: the board is hardly turned.",
            got=f"turned by {degrees} degrees about three axes",
            allowed=f"at least {np.rad2deg(MIN_SPREAD_RAD):.0f} about two axes",
            hint="tilt the hand to all sides, 20 degrees and more",
        )


def _require_agreement(views: Sequence[View], rms: Array) -> None:
    """Raises `ConfigurationError` for a bad fit, or with the views that contradict the others."""
    wrong = np.flatnonzero(rms > max(3 * MAX_RMS_PX, 5 * float(np.median(rms))))
    if len(wrong):
        named = ", ".join(f"{views[index].name} ({rms[index]:.1f} px)" for index in wrong)
        raise ConfigurationError(
            "Some pictures contradict the others: pose and picture do not match, or the arm moved.",
            got=named,
            allowed=f"rms below {MAX_RMS_PX:.0f} px, the others' median is {np.median(rms):.2f}",
            hint="leave them out, or take them again",
        )
    overall = float(np.sqrt(np.mean(np.square(rms))))
    if overall > MAX_RMS_PX:
        raise ConfigurationError(
            "The solution does not fit the pictures.",
            got=f"rms {overall:.2f} px",
            allowed=f"at most {MAX_RMS_PX:.0f} px",
            hint="measure the printed squares; hold the board flat; rest at each pose; check the mounting",
        )
