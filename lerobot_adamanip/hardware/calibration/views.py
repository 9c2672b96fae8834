"""Pictures of a ChArUco board with tool poses: the board, their folder, and taking them with the robot.

A folder has ``views.json``, ``view_000.png`` and so on.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.calibration.hand_eye import HandEye, Mounting, View
from lerobot_adamanip.hardware.camera_frames import (
    CameraCalibration,
    Intrinsics,
    check_intrinsics,
    check_name,
    check_pose,
    to_json,
)
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError, RobotError
from lerobot_adamanip.util.files import write_atomically

DICTIONARY = "DICT_5X5_100"
FEWEST_CORNERS = 8
"""Minimum number of inner corners in a picture."""
MAX_MOTION_M, MAX_TURN_RAD = 0.0005, 0.002
"""Maximum motion of the arm during a picture."""
PICTURE_S = 2.0
"""Maximum wait for a picture."""
FILE, VERSION = "views.json", 1
_COUNT, _SIDE = json_fields.integer(3, 14), json_fields.number(1e-3, 1)
_CHECK = json_fields.table(
    {
        "version": json_fields.integer(VERSION, VERSION),
        "camera": check_name,
        "mounting": json_fields.choice(tuple(Mounting)),
        "board": json_fields.table({"columns": _COUNT, "rows": _COUNT, "square": _SIDE, "marker": _SIDE}),
        "color": check_intrinsics,
        "depth": json_fields.optional(check_intrinsics),
        "depth_in_color": json_fields.optional(check_pose),
        "tcp_in_base": json_fields.listing(check_pose, 0, 1000),
    }
)


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
        places = np.asarray(corners).reshape(-1, 2)
        distances = np.linalg.norm(places[:, None] - places[None], axis=2)
        np.fill_diagonal(distances, np.inf)
        spacing = float(np.median(distances.min(axis=1)))
        window = int(np.clip(spacing * (self.square - self.marker) / (2 * self.square), 2, 8))
        ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
        corners = cv2.cornerSubPix(gray, np.array(corners, np.float32), (window, window), (-1, -1), ends)
        points = np.asarray(drawn.getChessboardCorners(), np.float64)[np.ravel(ids)]
        return points, np.asarray(corners, np.float64).reshape(-1, 2)


@functools.lru_cache(maxsize=4)
def _aruco(board: Board) -> tuple[Any, Any]:
    """Returns OpenCV's board and its detector."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    charuco = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
    return charuco, cv2.aruco.CharucoDetector(charuco)


@dataclass(frozen=True)
class ViewFolder:
    """Pictures of one board from one camera.

    Attributes:
        folder: path of the folder.
        camera: serial number or name.
        mounting, board: see `Mounting`, `Board`.
        color: intrinsics of the colour imager, which takes the pictures.
        depth: intrinsics of the depth imager; None if it is the colour imager.
        depth_in_color: (4, 4) pose of the depth imager in the colour frame [m]; None if they are the same.
        tcp_in_base: (4, 4) tool pose of each picture [m].
    """

    folder: Path
    camera: str
    mounting: Mounting
    board: Board
    color: Intrinsics
    depth: Intrinsics | None = None
    depth_in_color: NDArray[np.float64] | None = None
    tcp_in_base: tuple[NDArray[np.float64], ...] = ()

    @classmethod
    def open(cls, folder: Path) -> ViewFolder:
        """Reads ``views.json``. Raises `ConfigurationError` if it is missing or invalid."""
        try:
            content = _CHECK(FILE, json_fields.read(folder / FILE))
            if (content["depth"] is None) != (content["depth_in_color"] is None):
                raise ValueError("depth and depth_in_color go together")
            content |= {"mounting": Mounting(content["mounting"]), "board": Board(**content["board"])}
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                "No pictures of a board with poses.",
                got=f"{folder}: {error}",
                allowed=f"a folder with {FILE} of version {VERSION} and its pictures",
                hint="adamanip calibrate FOLDER --record robot.json",
            ) from error
        del content["version"]
        return cls(folder, **content)

    def added(self, color: NDArray[np.uint8], tcp_in_base: NDArray[np.float64]) -> ViewFolder:
        """Adds a picture (H, W, 3) RGB with its pose and returns the new folder."""
        import cv2

        self.folder.mkdir(parents=True, exist_ok=True)
        written, data = cv2.imencode(".png", cv2.cvtColor(color, cv2.COLOR_RGB2BGR))
        assert written
        write_atomically(self._picture(len(self.tcp_in_base)), data.tobytes())
        more = replace(self, tcp_in_base=(*self.tcp_in_base, tcp_in_base))
        content = {name: value for name, value in vars(more).items() if name != "folder"}
        write_atomically(self.folder / FILE, to_json({"version": VERSION, **content}, indent=1))
        return more

    def views(self, tell: Callable[[str], None] = lambda line: None) -> list[View]:
        """Finds the board in each picture. ``tell`` gets one line per picture without it.

        Raises:
            ConfigurationError: a picture is missing or has another size, or no picture shows the board.
        """
        import cv2

        views: list[View] = []
        for index, pose in enumerate(self.tcp_in_base):
            path = self._picture(index)
            gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if gray is None or gray.shape != (self.color.height, self.color.width):
                raise ConfigurationError(
                    f"The picture {path} cannot be used.",
                    got="none" if gray is None else f"{gray.shape[1]} x {gray.shape[0]}",
                    allowed=f"a picture of {self.color.width} x {self.color.height}",
                    hint="take them again",
                )
            points, pixels = self.board.detect(np.asarray(gray, np.uint8))
            if len(points):
                views.append(View(path.name, pose, points, pixels))
            else:
                tell(f"{path.name}: the board is not seen")
        if not views and self.tcp_in_base:
            raise ConfigurationError(
                "No picture shows the board.",
                got=f"{len(self.tcp_in_base)} pictures without it",
                allowed=f"{self.board.columns} x {self.board.rows} squares, {DICTIONARY}, pattern of OpenCV since 4.6",
                hint="is it the board of --board-image, whole in the picture, and sharp?",
            )
        return views

    def calibration(self, solved: HandEye) -> CameraCalibration:
        """Returns the calibration of the depth imager, given the pose of the colour imager."""
        depth_pose = solved.camera if self.depth_in_color is None else solved.camera @ self.depth_in_color
        fixed = solved.mounting is Mounting.FIXED
        return CameraCalibration(
            camera=self.camera,
            depth=self.color if self.depth is None else self.depth,
            depth_in_base=depth_pose if fixed else None,
            depth_in_tcp=None if fixed else depth_pose,
            color=self.color,
            depth_in_color=np.eye(4) if self.depth_in_color is None else self.depth_in_color,
        )

    def _picture(self, index: int) -> Path:
        return self.folder / f"view_{index:03d}.png"


# With the robot -------------------------------------------------------------------------------------------------------


def robot_from_file(path: Path) -> Any:
    """Returns the robot from a JSON file of ``--robot.*`` options. Raises `ConfigurationError`."""
    import draccus
    import lerobot.cameras.opencv.configuration_opencv
    import lerobot.cameras.realsense.configuration_realsense  # noqa: F401  (as `lerobot-record` registers them)
    from lerobot.robots import make_robot_from_config
    from lerobot.robots.config import RobotConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    try:
        return make_robot_from_config(draccus.decode(RobotConfig, json_fields.read(path)))
    except Exception as error:  # draccus and LeRobot raise many kinds
        raise ConfigurationError(
            "The file describes no robot.",
            got=f"{path}: {error}",
            allowed='JSON of the options after --robot: {"type": "adamanip_franka", ..., "cameras": {...}}',
            hint="use the --robot options of your lerobot-record command",
        ) from error


def camera_of(robot: Any, key: str) -> Any:
    """Returns a robot's camera. Raises `ConfigurationError` if it is missing or has no intrinsics."""
    cameras: Mapping[str, Any] = getattr(robot, "cameras", {})
    camera = cameras.get(key)
    if not hasattr(camera, "color_intrinsics"):
        raise ConfigurationError(
            f"The robot has no camera {key} that can be calibrated.",
            got=", ".join(f"{name}: {type(camera).__name__}" for name, camera in cameras.items()) or "no cameras",
            allowed="one of this project's cameras: adamanip_realsense",
            hint="--key, or another camera in the robot's file",
        )
    return camera


def begin(folder: Path, camera: Any, mounting: Mounting, board: Board) -> ViewFolder:
    """Opens an existing folder of pictures, or creates one with the camera's intrinsics.

    Raises:
        ConfigurationError: the existing pictures are of another camera, mounting, board or size.
        RobotError: the camera does not report its intrinsics.
    """
    depth = camera.depth_in_color()
    new = ViewFolder(
        folder,
        camera.name,
        mounting,
        board,
        camera.color_intrinsics(),
        None if depth is None else camera.depth_intrinsics(),
        depth,
    )
    if not (folder / FILE).exists():
        return new
    existing = ViewFolder.open(folder)
    shown, asked = (
        (each.camera, each.mounting, each.board, f"{each.color.width} x {each.color.height} px")
        for each in (existing, new)
    )
    if shown != asked:
        raise ConfigurationError(
            "The folder holds pictures of something else.",
            got=", ".join(map(str, shown)),
            allowed=", ".join(map(str, asked)),
            hint="another folder",
        )
    return existing


def take_views(
    robot: Any, camera: Any, folder: ViewFolder, ask: Callable[[], bool], tell: Callable[[str], None]
) -> ViewFolder:
    """Takes pictures while ``ask`` returns True, and returns the folder with them.

    Keeps a picture if it shows the board and the arm was at rest. ``tell`` gets one line per picture.
    """
    import cv2

    while ask():
        try:
            before = _tool_pose(observe_after_guiding(robot))
            frame = camera.frame_after(time.perf_counter(), PICTURE_S)
            after = _tool_pose(robot.get_observation())
        except RobotError as error:
            tell(str(error))
            continue
        distance, angle = pose_error(after, before)
        if distance > MAX_MOTION_M or angle > MAX_TURN_RAD:
            tell("the arm moved: picture not kept")
            continue
        assert frame.color is not None
        gray = np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), np.uint8)
        corners = len(folder.board.detect(gray)[0])
        if not corners:
            tell("the board is not seen: picture not kept")
            continue
        folder = folder.added(frame.color, after)
        tell(f"{len(folder.tcp_in_base)} pictures; {corners} corners in this one")
    return folder


def observe_after_guiding(robot: Any) -> Any:
    """Returns the robot's observation. Clears the fault that guiding leaves; raises `RobotError` for others."""
    try:
        return robot.get_observation()
    except RobotError:
        robot.recover()
        return robot.get_observation()


def _tool_pose(observation: Mapping[str, Any]) -> NDArray[np.float64]:
    return pose_from_vector([observation[name] for name in POSE_NAMES])[0]
