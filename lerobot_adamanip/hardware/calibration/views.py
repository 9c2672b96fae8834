"""Folder of board pictures with tool poses: ``views.json``, ``view_000.png`` and so on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.calibration.board import DICTIONARY, Board
from lerobot_adamanip.hardware.calibration.file import check_intrinsics, check_name, check_pose, to_json
from lerobot_adamanip.hardware.calibration.hand_eye import HandEye, Mounting, View
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.files import write_atomically

FILE, VERSION = "views.json", 1
_SIDE = json_fields.number(1e-3, 1)
_CHECK = json_fields.table(
    {
        "version": json_fields.integer(VERSION, VERSION),
        "camera": check_name,
        "mounting": json_fields.choice(tuple(Mounting)),
        "board": json_fields.table(
            {
                "columns": json_fields.integer(3, 14),
                "rows": json_fields.integer(3, 14),
                "square": _SIDE,
                "marker": _SIDE,
            }
        ),
        "color": check_intrinsics,
        "depth": json_fields.optional(check_intrinsics),
        "depth_in_color": json_fields.optional(check_pose),
        "tcp_in_base": json_fields.listing(check_pose, 0, 1000),
    }
)


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
            read = json_fields.read(folder / FILE)
            if isinstance(read, dict) and isinstance(read.get("board"), dict):
                read["board"].pop("legacy", None)  # folders of version 0.3
            told = _CHECK(FILE, read)
            if (told["depth"] is None) != (told["depth_in_color"] is None):
                raise ValueError("depth and depth_in_color go together")
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                "No pictures of a board with poses.",
                got=f"{folder}: {error}",
                allowed=f"a folder with {FILE} of version {VERSION} and its pictures",
                hint="adamanip calibrate FOLDER --record robot.json",
            ) from error
        del told["version"]
        return cls(folder, **{**told, "mounting": Mounting(told["mounting"]), "board": Board(**told["board"])})

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

        found: list[View] = []
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
                found.append(View(path.name, pose, points, pixels))
            else:
                tell(f"{path.name}: the board is not seen")
        if not found and self.tcp_in_base:
            raise ConfigurationError(
                "No picture shows the board.",
                got=f"{len(self.tcp_in_base)} pictures without it",
                allowed=f"{self.board.columns} x {self.board.rows} squares, {DICTIONARY}, pattern of OpenCV since 4.6",
                hint="is it the board of --board-image, whole in the picture, and sharp?",
            )
        return found

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
