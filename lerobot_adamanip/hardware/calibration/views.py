"""Pictures of the board with the tool's poses, in a folder: ``views.json``, ``view_000.png`` and so on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.calibration.board import DICTIONARY, Board, pattern_hint
from lerobot_adamanip.hardware.calibration.file import check_pose
from lerobot_adamanip.hardware.calibration.hand_eye import HandEye, Mounting, View
from lerobot_adamanip.hardware.calibration.intrinsics_json import (
    check_intrinsics,
    intrinsics_from_json,
    intrinsics_to_json,
)
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics
from lerobot_adamanip.util import json_fields as checked_json
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.files import write_atomically

FILE, VERSION = "views.json", 1
_SIDE = checked_json.number(1e-3, 1)
_CHECK = checked_json.table(
    {
        "version": checked_json.integer(VERSION, VERSION),
        "camera": checked_json.text(r"[^\x00-\x1f]{1,200}", "a serial number or name"),
        "mounting": checked_json.choice(tuple(Mounting)),
        "board": checked_json.table(
            {
                "columns": checked_json.integer(3, 14),
                "rows": checked_json.integer(3, 14),
                "square": _SIDE,
                "marker": _SIDE,
                "legacy": checked_json.flag,
            }
        ),
        "color": check_intrinsics,
        "depth": checked_json.optional(check_intrinsics),
        "depth_in_color": checked_json.optional(check_pose),
        "tcp_in_base": checked_json.listing(check_pose, 0, 1000),
    }
)


@dataclass(frozen=True)
class ViewFolder:
    """What a folder holds.

    Attributes:
        folder: of it.
        camera: serial number or name.
        mounting: where the camera is.
        board: that is seen.
        color: of the imager that took the pictures.
        depth: of the imager that depth is told in; None if that is the same.
        depth_in_color: (4, 4) pose of that imager in the other's frame [m]; None if they are one.
        tcp_in_base: of each picture, (4, 4) [m].
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
        """Reads ``views.json``; raises `ConfigurationError` where it is missing or none."""
        try:
            read = checked_json.read(folder / FILE)
            if isinstance(read, dict) and isinstance(read.get("board"), dict):
                read["board"].setdefault("legacy", False)  # folders of before 0.3
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
        return cls(
            folder,
            told["camera"],
            Mounting(told["mounting"]),
            Board(**told["board"]),
            intrinsics_from_json(told["color"]),
            None if told["depth"] is None else intrinsics_from_json(told["depth"]),
            told["depth_in_color"],
            told["tcp_in_base"],
        )

    def added(self, color: NDArray[np.uint8], tcp_in_base: NDArray[np.float64]) -> ViewFolder:
        """Writes one more picture (H, W, 3) RGB with its pose; returns the folder with it. Older ones stay whole."""
        import cv2

        self.folder.mkdir(parents=True, exist_ok=True)
        written, data = cv2.imencode(".png", cv2.cvtColor(color, cv2.COLOR_RGB2BGR))
        assert written
        write_atomically(self._picture(len(self.tcp_in_base)), data.tobytes())
        more = replace(self, tcp_in_base=(*self.tcp_in_base, tcp_in_base))
        write_atomically(self.folder / FILE, json.dumps(more._to_json(), indent=1).encode())
        return more

    def views(self, tell: Callable[[str], None] = lambda line: None) -> list[View]:
        """Finds the board in each picture; those without it are left out, which ``tell`` is told.

        Raises:
            ConfigurationError: a picture is missing or of another size, or none shows the board.
        """
        import cv2

        found, reasons = [], []
        for index, pose in enumerate(self.tcp_in_base):
            path = self._picture(index)
            gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if gray is None or gray.shape != (self.color.height, self.color.width):
                raise ConfigurationError(
                    f"The picture {path} is of no use.",
                    got="none" if gray is None else f"{gray.shape[1]} x {gray.shape[0]}",
                    allowed=f"a picture of {self.color.width} x {self.color.height}",
                    hint="take them again",
                )
            picture = np.asarray(gray, np.uint8)
            points, pixels = self.board.detect(picture)
            if len(points):
                found.append(View(path.name, pose, points, pixels))
            else:
                reasons.append(self.board.why_unseen(picture))
                tell(f"{path.name}: {reasons[-1]}")
        if not found and reasons:
            self._refuse_unseen(reasons)
        return found

    def _refuse_unseen(self, reasons: list[str]) -> None:
        other = pattern_hint(not self.board.legacy)
        raise ConfigurationError(
            "No picture shows the board.",
            got=max(reasons, key=lambda reason: other in reason),
            allowed=f"{self.board.columns} x {self.board.rows} squares, markers of {DICTIONARY}",
            hint=f"{other}: OpenCV's older boards of an even number of rows are others"
            if self.board.rows % 2 == 0
            else "is it the board of --board-image, whole in the picture, and sharp?",
        )

    def calibration(self, solved: HandEye) -> CameraCalibration:
        """Returns the calibration of the imager that depth is told in, given where that of the pictures is."""
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

    def _to_json(self) -> dict[str, Any]:
        board = self.board
        return {
            "version": VERSION,
            "camera": self.camera,
            "mounting": str(self.mounting),
            "board": {
                "columns": board.columns,
                "rows": board.rows,
                "square": board.square,
                "marker": board.marker,
                "legacy": board.legacy,
            },
            "color": intrinsics_to_json(self.color),
            "depth": None if self.depth is None else intrinsics_to_json(self.depth),
            "depth_in_color": None if self.depth_in_color is None else self.depth_in_color.tolist(),
            "tcp_in_base": [pose.tolist() for pose in self.tcp_in_base],
        }
