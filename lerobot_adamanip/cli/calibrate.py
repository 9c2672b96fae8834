"""`adamanip calibrate`: calibrates a camera's pose."""

from __future__ import annotations

import dataclasses
import math
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

import lerobot_adamanip
from lerobot_adamanip.cli.arguments import print_result, require_effects, require_suffix
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from lerobot_adamanip.hardware.calibration.hand_eye import HandEye
    from lerobot_adamanip.hardware.calibration.views import Board

DOTS_PER_METRE = 300 / 0.0254
ENOUGH_PICTURES = 20


@dataclass
class CalibrateCommand:
    """Calibrate a camera's pose from pictures of a ChArUco board at poses of the arm, or of the hand (--on-robot).

    Print the board first (--board-image). Fix it to the hand for a camera beside the robot, or to the table for a
    camera on the hand. Take 20 pictures (--record), with the hand tilted to all sides by 20 degrees and more. Without
    --record, the command uses the pictures in the folder.

    A camera with depth beside the robot, calibrated before and moved by at most 30 mm and 3 degrees, needs no board:
    adamanip calibrate --on-robot --record robot.json --out FILE.
    """

    folder: tyro.conf.Positional[Path | None] = None
    """Folder of the pictures and poses."""

    out: Path | None = None
    """Calibration file to add the camera to; other cameras in it stay. Default: only print the result."""

    key: str = "front"
    """Name of the camera in the robot's configuration."""

    record: Path | None = None
    """Take pictures first, with the robot of this JSON file. It holds the --robot.* options."""

    on_robot: bool = False
    """Correct the calibration by the robot's own hand in depth pictures, without a board (with --record)."""

    mounting: Literal["fixed", "wrist"] = "fixed"
    """Mounting of the camera (with --record): beside the robot, or on its hand."""

    board_image: Path | None = None
    """Write the board as a .png picture to print at 300 dpi, and stop."""

    columns: int = 7
    """Number of squares along the board's long side (with --record and --board-image)."""

    rows: int = 5
    """Number of squares along the board's short side, likewise."""

    square: float | None = None
    """Side length of a square, measured on the print [m]. Default: that of the pictures, 0.040 for new ones."""

    marker: float | None = None
    """Side length of a marker, measured on the print [m]. Default: that of the pictures, 0.030 for new ones."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Prints, records, solves and writes. Returns 0."""
        if self.board_image is not None:
            return self._print_board(self.board_image)
        if self.on_robot:
            return self._on_robot()
        if self.folder is None:
            raise ConfigurationError(
                "No folder of pictures.",
                got="neither a folder nor --board-image",
                allowed="adamanip calibrate FOLDER, or --on-robot",
                hint="adamanip calibrate --board-image board.png",
            )
        if self.record is None:
            require_effects(self, {"with --record": ("columns", "rows", "mounting")})
        from lerobot_adamanip.hardware.calibration.hand_eye import solve
        from lerobot_adamanip.hardware.calibration.views import Board, ViewFolder
        from lerobot_adamanip.hardware.camera_frames import save_calibration

        if self.record is not None:
            self._record(self.folder, self.record)
        folder = ViewFolder.open(self.folder)
        board = Board(**{**dataclasses.asdict(folder.board), **self._sizes()})
        folder = dataclasses.replace(folder, board=board)
        solved = solve(folder.views(self._say), folder.color, folder.mounting)
        facts = _facts(solved)
        if self.out is not None:
            save_calibration(self.out, self.key, folder.calibration(solved), facts)
        self._print(solved, facts)
        return 0

    def _on_robot(self) -> int:
        from lerobot_adamanip.hardware.calibration.on_hand import calibrate_on_hand
        from lerobot_adamanip.hardware.calibration.views import robot_from_file
        from lerobot_adamanip.hardware.camera_frames import save_calibration
        from lerobot_adamanip.hardware.closing import closing_on_error

        if self.record is None:
            raise ConfigurationError(
                "No robot to calibrate on.",
                got="--on-robot without --record",
                allowed="--record FILE with the --robot.* options as JSON",
                hint="adamanip calibrate --on-robot --record robot.json --out FILE",
            )
        robot = robot_from_file(self.record)
        robot.connect(calibrate=False)
        with closing_on_error(robot.disconnect):
            on_hand = calibrate_on_hand(robot, self.key, _wants_picture, self._say)
        robot.disconnect()
        estimate = on_hand.estimate
        facts: dict[str, float | str] = {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "method": "on the robot's hand",
            "poses": estimate.frames,
            "moved_mm": 1e3 * estimate.moved_by_m,
            "uncertainty_mm": 1e3 * estimate.uncertainty_m,
            "lerobot_adamanip": lerobot_adamanip.__version__,
        }
        if self.out is not None:
            save_calibration(self.out, self.key, on_hand.corrected(), facts)
        written = "" if self.out is None else f"\nwritten: {self.out}, camera {self.key}"
        text = f"{estimate.frames} poses: moved by {facts['moved_mm']:.1f} mm, +- {facts['uncertainty_mm']:.1f} mm"
        print_result(self.json, {**facts, "out": self.out}, text + written)
        return 0

    def _print_board(self, path: Path) -> int:
        from PIL import Image

        require_suffix(path, (".png",), "board.png")
        board = self._board()
        Image.fromarray(board.image(DOTS_PER_METRE)).save(path, dpi=(300, 300))
        size = [1e3 * count * board.square for count in (board.columns, board.rows)]
        text = (
            f"{path}: {size[0]:.0f} x {size[1]:.0f} mm. Print at 100 %, glue it to a flat plate, and measure a square."
        )
        print_result(self.json, {**vars(board), "board_image": path, "size_mm": size}, text)
        return 0

    def _board(self) -> Board:
        from lerobot_adamanip.hardware.calibration.views import Board

        return Board(self.columns, self.rows, **self._sizes())

    def _sizes(self) -> dict[str, float]:
        sizes = {"square": self.square, "marker": self.marker}
        return {name: size for name, size in sizes.items() if size is not None}

    def _record(self, folder: Path, robot_file: Path) -> None:
        from lerobot_adamanip.hardware.calibration.hand_eye import Mounting
        from lerobot_adamanip.hardware.calibration.views import begin, camera_of, robot_from_file, take_views
        from lerobot_adamanip.hardware.closing import closing_on_error

        robot = robot_from_file(robot_file)
        robot.connect(calibrate=False)
        with closing_on_error(robot.disconnect):
            camera = camera_of(robot, self.key)
            views = begin(folder, camera, Mounting(self.mounting), self._board())
            self._say(f"{len(views.tcp_in_base)} pictures so far; {ENOUGH_PICTURES} are enough")
            take_views(robot, camera, views, _wants_picture, self._say)
        robot.disconnect()

    def _say(self, line: str) -> None:
        if not self.json:
            print(line)

    def _print(self, solved: HandEye, facts: dict[str, float | str]) -> None:
        frame = "tool" if solved.mounting == "wrist" else "base"
        x, y, z = solved.camera[:3, 3]
        views, lines = [], []
        for each in solved.residuals:
            mm, deg = 1e3 * each.position, math.degrees(each.angle)
            views.append({"name": each.name, "px": each.pixels, "mm": mm, "deg": deg})
            lines.append(f"{each.name}  {each.pixels:6.2f} px  {mm:7.2f} mm  {deg:6.3f} deg")
        spread = f"{1e3 * solved.position_spread:.2f} mm, {math.degrees(solved.angle_spread):.3f} deg"
        lines += [
            f"rms {solved.rms:.2f} px over {len(views)} pictures",
            f"one picture less moves the camera by at most {spread}",
            f"camera at ({x:.4f}, {y:.4f}, {z:.4f}) m in the frame of the {frame}",
            *([] if self.out is None else [f"written: {self.out}, camera {self.key}"]),
        ]
        values = {"mounting": frame, "camera": solved.camera.tolist(), "board": solved.board.tolist(), **facts}
        print_result(self.json, {**values, "views": views, "out": self.out}, "\n".join(lines))


def _wants_picture() -> bool:
    """Waits for the user, with the prompt on stderr, since stdout may be JSON. Returns False to end."""
    print("Enter takes a picture, q and Enter ends: ", end="", file=sys.stderr, flush=True)
    try:
        return input().strip().lower() != "q"
    except EOFError:
        return False


def _facts(solved: HandEye) -> dict[str, float | str]:
    """Returns the notes on a result that the calibration file stores."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "pictures": len(solved.residuals),
        "rms_px": solved.rms,
        "worst_mm": 1e3 * max(each.position for each in solved.residuals),
        "worst_deg": math.degrees(max(each.angle for each in solved.residuals)),
        "one_less_mm": 1e3 * solved.position_spread,
        "one_less_deg": math.degrees(solved.angle_spread),
        "lerobot_adamanip": lerobot_adamanip.__version__,
        "numpy": version("numpy"),
    }
