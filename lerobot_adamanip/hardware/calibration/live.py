"""Takes pictures of the board with the robot's camera while a person moves the arm."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import angle_between, pose_from_vector
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.calibration.board import Board
from lerobot_adamanip.hardware.calibration.hand_eye import Mounting
from lerobot_adamanip.hardware.calibration.views import FILE, ViewFolder
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

MOVED, TURNED = 0.0005, 0.002
"""Maximum motion of the arm during a picture [m, rad]."""
FRAME_TIMEOUT = 2.0
"""Maximum wait for a picture [s]."""


def robot_from_file(path: Path) -> Any:
    """Returns the robot from a JSON file of ``--robot.*`` options. Raises `ConfigurationError`."""
    import draccus
    from lerobot.robots import make_robot_from_config
    from lerobot.robots.config import RobotConfig

    from lerobot_adamanip.util import json_fields

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
            got=", ".join(f"{name}: {type(each).__name__}" for name, each in cameras.items()) or "no cameras",
            allowed="one of this project's cameras: adamanip_realsense",
            hint="--key, or another camera in the robot's file",
        )
    return camera


def begin(folder: Path, camera: Any, mounting: Mounting, board: Board) -> ViewFolder:
    """Opens an existing folder of pictures, or creates one with the camera's intrinsics.

    Raises:
        ConfigurationError: the existing pictures show another camera, mounting or board.
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
    there = ViewFolder.open(folder)
    if (there.camera, there.mounting, there.board) != (new.camera, new.mounting, new.board):
        raise ConfigurationError(
            "The folder holds pictures of something else.",
            got=f"{there.camera}, {there.mounting}, {there.board}",
            allowed=f"{new.camera}, {new.mounting}, {new.board}",
            hint="another folder",
        )
    return there


def take_views(
    robot: Any, camera: Any, folder: ViewFolder, ask: Callable[[], bool], tell: Callable[[str], None]
) -> ViewFolder:
    """Takes pictures while ``ask`` returns True, and returns the folder with them.

    Keeps a picture if it shows the board and the arm was at rest. ``tell`` gets one line per picture.
    """
    import cv2

    while ask():
        try:
            before = _pose_after_guiding(robot)
            frame = camera.frame_after(time.perf_counter(), FRAME_TIMEOUT)
            after = tcp_in_base(robot.get_observation())
        except RobotError as error:
            tell(str(error))
            continue
        if (
            np.linalg.norm(after[:3, 3] - before[:3, 3]) > MOVED
            or angle_between(after[:3, :3], before[:3, :3]) > TURNED
        ):
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


def _pose_after_guiding(robot: Any) -> NDArray[np.float64]:
    """Returns the tool pose (4, 4) [m]. Clears the fault that guiding leaves; raises `RobotError` for others."""
    try:
        return tcp_in_base(robot.get_observation())
    except RobotError:
        robot.recover()
        return tcp_in_base(robot.get_observation())


def tcp_in_base(observation: Mapping[str, Any]) -> NDArray[np.float64]:
    """Returns the tool pose (4, 4) [m] of an observation."""
    return pose_from_vector([observation[name] for name in POSE_NAMES])[0]
