"""Calibration on rendered boards, of which the truth is known, and its file."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lerobot_adamanip.cli import calibrate
from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract.rotations import angle_between, matrix_from_rotation_vector, pose_vector, transform
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.calibration.hand_eye import MIN_VIEWS, Mounting, View, solve
from lerobot_adamanip.hardware.calibration.views import Board, ViewFolder, begin, camera_of, take_views
from lerobot_adamanip.hardware.camera_frames import (
    CameraCalibration,
    Frame,
    Intrinsics,
    read_calibrations,
    save_calibration,
)
from lerobot_adamanip.hardware.cameras.base import FrameReader
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

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


@pytest.fixture(scope="module")
def fixed() -> tuple[Truth, list[View]]:
    known = truth(0)
    return known, views_of(known, 0)


def test_corners_are_found_where_they_are() -> None:
    """Without the half pixel that OpenCV adds."""
    import cv2

    for board in truth(3, 4).board_in_camera:
        points, pixels = BOARD.detect(rendered(board))
        assert len(points) == (BOARD.columns - 1) * (BOARD.rows - 1)
        in_camera, none = points @ board[:3, :3].T + board[:3, 3], np.zeros(3)
        expected = cv2.projectPoints(in_camera, none, none, INTRINSICS.matrix, INTRINSICS.distortion)[0][:, 0]
        assert np.abs((pixels - expected).mean(axis=0)).max() < 0.03
        assert np.sqrt(np.mean(np.square(pixels - expected))) < 0.1
    assert len(BOARD.detect(np.full((480, 640), 127, np.uint8))[0]) == 0


@pytest.mark.parametrize("mounting", list(Mounting))
def test_twenty_poses_find_the_camera_to_a_millimetre_and_a_tenth_of_a_degree(mounting: Mounting) -> None:
    """0.2 px on each corner, 0.1 mm on each pose of the tool."""
    known = truth(0, 20, mounting)
    solved = solve(views_of(known, 0), INTRINSICS, mounting)
    assert np.linalg.norm(solved.camera[:3, 3] - known.camera[:3, 3]) <= 1e-3
    assert np.rad2deg(angle_between(solved.camera[:3, :3], known.camera[:3, :3])) <= 0.1
    assert 0.1 < solved.rms < 0.4
    assert len(solved.residuals) == 20
    assert all(each.pixels < 0.6 and each.position < 5e-3 and np.rad2deg(each.angle) < 1 for each in solved.residuals)
    assert 0 < solved.position_spread < 1e-3
    assert 0 < np.rad2deg(solved.angle_spread) < 0.1


def test_one_swapped_pose_is_named(fixed: tuple[Truth, list[View]]) -> None:
    views = list(fixed[1])
    views[4] = replace(views[4], tcp_in_base=views[9].tcp_in_base)
    with pytest.raises(ConfigurationError, match=r"got: +view_004\.png \(\d+\.\d px\)\n"):
        solve(views, INTRINSICS, Mounting.FIXED)
    views[9] = replace(views[9], tcp_in_base=fixed[1][4].tcp_in_base)  # swapped with each other
    with pytest.raises(ConfigurationError, match=r"got: +view_004\.png \(.*\), view_009\.png \(.*\)\n"):
        solve(views, INTRINSICS, Mounting.FIXED)
    nudged = [*fixed[1][:7], replace(fixed[1][7], tcp_in_base=transform((0.01, 0, 0)) @ fixed[1][7].tcp_in_base)]
    with pytest.raises(ConfigurationError, match=r"got: +view_007\.png \(.*\)\n"):
        solve([*nudged, *fixed[1][8:]], INTRINSICS, Mounting.FIXED)  # an arm that was not where it says, by 1 cm


def test_too_few_and_too_similar_poses_are_refused(fixed: tuple[Truth, list[View]]) -> None:
    with pytest.raises(ConfigurationError, match="Too few") as caught:
        solve(fixed[1][: MIN_VIEWS - 1], INTRINSICS, Mounting.FIXED)
    assert str(MIN_VIEWS) in str(caught.value)
    solve(fixed[1][:MIN_VIEWS], INTRINSICS, Mounting.FIXED)
    with pytest.raises(ConfigurationError, match="too much alike"):
        solve(views_of(truth(5, 14, tilt=0.1), 5), INTRINSICS, Mounting.FIXED)
    with pytest.raises(ConfigurationError, match="Too few"):
        solve([], INTRINSICS, Mounting.WRIST)


def test_the_wrong_mounting_and_a_wrong_square_do_not_fit(fixed: tuple[Truth, list[View]]) -> None:
    with pytest.raises(ConfigurationError, match="px"):
        solve(fixed[1], INTRINSICS, Mounting.WRIST)
    larger = [replace(view, points=1.1 * view.points) for view in fixed[1]]
    with pytest.raises(ConfigurationError, match=r"measure the printed squares|contradict"):
        solve(larger, INTRINSICS, Mounting.FIXED)


@pytest.mark.parametrize("changes", [{"columns": 2}, {"marker": 0.04}, {"marker": 0.001}, {"square": 2.0}])
def test_what_is_no_board_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="No ChArUco board"):
        Board(**changes)


# The command ----------------------------------------------------------------------------------------------------------

DEPTH = Intrinsics(np.array([[380.0, 0, 212], [0, 380.0, 120], [0, 0, 1]]), np.zeros(5), 424, 240)
DEPTH_IN_COLOR = transform((0.015, 0.0, 0.001), matrix_from_rotation_vector(np.array([0.01, 0.0, -0.01])))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("views")
    write_views(folder, truth(1, 13), depth=DEPTH, depth_in_color=DEPTH_IN_COLOR)
    return folder


def test_the_command_calibrates_from_a_folder(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "lab.cameras.json"
    assert main(["calibrate", str(pictures), "--out", str(output)]) == 0
    told = capsys.readouterr().out
    assert told.count(" px ") >= 13
    assert "one picture less moves the camera by at most" in told
    found = read_calibrations(output)["front"]
    assert found.depth_in_base is not None
    assert np.linalg.norm(found.depth_in_base[:3, 3] - (CAMERA @ DEPTH_IN_COLOR)[:3, 3]) < 1e-3
    assert found.depth.width == 424
    assert found.color is not None
    assert found.camera == "0123"
    assert main(["calibrate", str(pictures), "--json", "--out", str(output), "--key", "side"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert main(["calibrate", str(pictures), "--json", "--square", "0.0408", "--marker", "0.0306"]) == 0
    scaled = json.loads(capsys.readouterr().out)
    board, larger = (np.array(each["board"])[:3, 3] for each in (numbers, scaled))
    assert np.linalg.norm(np.array(scaled["camera"]) - np.array(numbers["camera"])) > 1e-3, "measured on the print"
    assert not np.allclose(board, larger, atol=1e-6)
    assert len(numbers["views"]) == numbers["pictures"] == 13
    assert numbers["rms_px"] < 0.2
    assert set(read_calibrations(output)) == {"front", "side"}


def test_the_command_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate"]) == 2
    assert "--board-image" in capsys.readouterr().err
    assert main(["calibrate", str(tmp_path)]) == 2
    assert "views.json" in capsys.readouterr().err
    (tmp_path / "robot.json").write_text('{"type": "no_such_robot"}')
    assert main(["calibrate", str(tmp_path), "--record", str(tmp_path / "robot.json")]) == 2
    assert "describes no robot" in capsys.readouterr().err
    assert main(["calibrate", str(tmp_path), "--mounting", "wrist"]) == 2
    assert "--mounting with --record" in capsys.readouterr().err


def test_a_robots_file_names_the_robots_and_cameras_of_lerobot_record(tmp_path: Path) -> None:
    """In a process of its own, which has loaded no plugin yet."""
    camera = {"type": "opencv", "index_or_path": 0, "width": 640, "height": 480, "fps": 30}
    options = {"type": "adamanip_franka", "id": "x", "address": "127.0.0.1", "model": "fr3", "cameras": {"top": camera}}
    (tmp_path / "robot.json").write_text(json.dumps(options))
    code = (
        "import sys; from pathlib import Path\n"
        "from lerobot_adamanip.hardware.calibration.views import robot_from_file\n"
        "robot = robot_from_file(Path(sys.argv[1])); print(robot.name, *robot.config.cameras)"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "robot.json")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["adamanip_franka", "top"], done.stderr[-1500:]


def test_the_printed_board_is_the_one_that_is_looked_for(tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "board.png"
    assert main(["calibrate", "--board-image", str(path), "--square", "0.03", "--marker", "0.022"]) == 0
    picture = Image.open(path)
    assert picture.info["dpi"][0] == pytest.approx(300, abs=0.1)
    assert picture.width == pytest.approx((7 + 1) * 0.03 / 0.0254 * 300, abs=9)
    small = np.asarray(picture.resize((picture.width // 4, picture.height // 4)), np.uint8)
    assert len(Board(square=0.03, marker=0.022).detect(small)[0]) == 24


def test_the_printed_board_is_one_json_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "board.png"
    assert main(["calibrate", "--board-image", str(path), "--square", "0.03", "--marker", "0.022", "--json"]) == 0
    board = json.loads(capsys.readouterr().out)
    assert (board["board_image"], board["columns"], board["rows"], board["square"]) == (str(path), 7, 5, 0.03)
    assert board["size_mm"] == pytest.approx([210, 150])


def test_the_prompt_is_not_on_stdout(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n q\n"))
    assert [calibrate._wants_picture() for _ in range(2)] == [True, False]
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("Enter takes a picture")) == ("", 2)


def test_pictures_without_the_board_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blank = np.zeros((480, 640, 3), np.uint8)
    ViewFolder(tmp_path, "0123", Mounting.FIXED, BOARD, INTRINSICS).added(blank, np.eye(4))
    assert main(["calibrate", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "view_000.png: the board is not seen" in said.out
    assert "No picture shows the board" in said.err


def test_a_missing_picture_is_named(tmp_path: Path) -> None:
    folder = write_views(tmp_path, truth(0, 2))
    assert ViewFolder.open(tmp_path).board == BOARD
    (tmp_path / "view_001.png").unlink()
    with pytest.raises(ConfigurationError, match=r"view_001\.png"):
        folder.views()


# With a robot ---------------------------------------------------------------------------------------------------------


class FakeCamera(FrameReader):
    """Sees the board where the robot's hand holds it."""

    name, use_rgb, use_depth = "0123", True, True

    def __init__(self, robot: FakeRobot) -> None:
        self.robot = robot

    def color_intrinsics(self) -> Intrinsics:
        return INTRINSICS

    def depth_intrinsics(self) -> Intrinsics:
        return DEPTH

    def depth_in_color(self) -> NDArray[np.float64]:
        return DEPTH_IN_COLOR

    def frame_after(self, stamp: float, timeout: float = 1.0) -> Frame:
        if self.robot.frozen:
            raise RobotError("Camera 0123: It is frozen.")
        return Frame(stamp + 0.01, stamp + 0.02, np.repeat(self.robot.picture()[..., None], 3, 2), None, 0)


class FakeRobot:
    """A hand that is led from pose to pose."""

    def __init__(self, known: Truth) -> None:
        self.known, self.at, self.creeps, self.frozen, self.blank = known, 0, 0.0, False, False
        self.guided, self.in_hand = False, False
        self.cameras: dict[str, Any] = {"front": FakeCamera(self), "phone": object()}

    def picture(self) -> NDArray[np.uint8]:
        return np.zeros((480, 640), np.uint8) if self.blank else rendered(self.known.board_in_camera[self.at])

    def recover(self) -> None:
        if self.in_hand:
            raise RobotError("The arm is being guided by hand.")
        self.guided = False

    def get_observation(self) -> dict[str, Any]:
        if self.guided:
            raise RobotError("The arm is being guided by hand: a fault until it is cleared.")
        pose = self.known.tcp_in_base[self.at]
        self.known.tcp_in_base[self.at] = transform((self.creeps, 0, 0)) @ pose
        return dict(zip(POSE_NAMES, pose_vector(pose, 1.0).tolist(), strict=True))


def test_pictures_are_taken_with_a_robot_and_only_good_ones_kept(tmp_path: Path) -> None:
    known = truth(2, 3)
    robot, told = FakeRobot(known), []

    def person() -> Iterator[bool]:
        robot.guided = robot.in_hand = True
        yield True  # too early
        robot.in_hand = False
        yield True  # at pose 0
        robot.creeps = 0.002
        yield True  # the arm creeps
        robot.creeps, robot.at, robot.blank = 0.0, 1, True
        yield True  # something is in the way
        robot.blank, robot.frozen = False, True
        yield True
        robot.frozen = False
        yield True
        yield False

    asked = person()
    camera = camera_of(robot, "front")
    folder = begin(tmp_path, camera, Mounting.FIXED, BOARD)
    folder = take_views(robot, camera, folder, lambda: next(asked), told.append)
    kept = ViewFolder.open(tmp_path)
    assert len(folder.tcp_in_base) == len(kept.tcp_in_base) == 2
    expected = [
        "The arm is being guided by hand.",
        "1 pictures; 24 corners in this one",
        "the arm moved",
        "the board is not seen",
        "Camera 0123",
        "2 pictures; 24 corners in this one",
    ]
    assert [line.partition(":")[0] for line in told] == expected
    assert kept.tcp_in_base[1] == pytest.approx(known.tcp_in_base[1], abs=1e-6)
    assert len(kept.views()) == 2
    assert len(begin(tmp_path, camera, Mounting.FIXED, BOARD).tcp_in_base) == 2  # one may go on another day
    with pytest.raises(ConfigurationError, match="something else"):
        begin(tmp_path, camera, Mounting.WRIST, BOARD)
    camera.color_intrinsics = lambda: replace(INTRINSICS, width=1280)
    with pytest.raises(ConfigurationError, match=r"(?s)640 x 480 px.*1280 x 480 px"):
        begin(tmp_path, camera, Mounting.FIXED, BOARD)
    with pytest.raises(ConfigurationError, match="no camera phone"):
        camera_of(robot, "phone")


POSE = transform((0.1, -0.58, 1.16), matrix_from_rotation_vector(np.array([0.3, -2.0, 0.4])))
IMAGER = Intrinsics(
    np.array([[380.1, 0, 320.2], [0, 381.3, 239.9], [0, 0, 1]]), np.array([0.1, 0, 0, 0, 0.2]), 640, 480
)
FRONT = CameraCalibration("0123456789", IMAGER, POSE, None, IMAGER, np.eye(4))
WRIST = CameraCalibration("wrist one", IMAGER, None, POSE)


def test_what_is_written_is_read_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "new" / "lab.cameras.json"
    save_calibration(path, "front", FRONT, {"rms_px": 0.21, "date": "2026-01-02"})
    save_calibration(path, "wrist", WRIST)
    found = read_calibrations(path)
    assert list(found) == ["front", "wrist"]
    for one, other in ((found["front"], FRONT), (found["wrist"], WRIST)):
        assert one.camera == other.camera
        for name in ("depth_in_base", "depth_in_tcp", "depth_in_color"):
            assert np.array_equal(getattr(one, name), getattr(other, name)) or getattr(other, name) is None
            assert (getattr(one, name) is None) == (getattr(other, name) is None)
        assert np.array_equal(one.depth.matrix, IMAGER.matrix)
        assert np.array_equal(one.depth.distortion, IMAGER.distortion)
        assert (one.depth.width, one.depth.height) == (640, 480)
    assert found["wrist"].color is None
    assert json.loads(path.read_text())["cameras"]["front"]["found"]["rms_px"] == 0.21
    save_calibration(path, "front", WRIST)
    assert read_calibrations(path)["front"].camera == "wrist one"
    assert json.loads(path.read_text())["cameras"]["wrist"]["found"] == {}


TEXT = json.dumps(
    {
        "version": 1,
        "cameras": {
            "front": {
                "camera": "1",
                "depth": {"matrix": IMAGER.matrix.tolist(), "distortion": [], "width": 640, "height": 480},
                "depth_in_base": POSE.tolist(),
                "depth_in_tcp": None,
                "color": None,
                "depth_in_color": None,
                "found": {},
            }
        },
    }
)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"depth_in_base": (2 * np.eye(4)).tolist()}, "no pose"),
        ({"depth_in_base": np.diag([1.0, 1, -1, 1]).tolist()}, "no pose"),
        ({"depth_in_base": np.eye(3).tolist()}, "a list of 4"),
        ({"depth_in_base": None}, "neither"),
        ({"depth_in_tcp": np.eye(4).tolist()}, "in the base's frame and on the tool"),
        ({"surprise": 1}, "unknown field"),
        ({"camera": "a\nb"}, "serial number"),
        ({"found": {"a": [1]}}, "text"),
        ({"depth": {"matrix": np.eye(3).tolist(), "distortion": [0.1], "width": 640, "height": 480}}, "coefficients"),
    ],
)
def test_a_file_that_is_none_is_named_and_left_alone(tmp_path: Path, change: dict[str, Any], named: str) -> None:
    path = tmp_path / "lab.cameras.json"
    told = json.loads(TEXT)
    path.write_text(json.dumps(told))
    assert read_calibrations(path)["front"].camera == "1"
    told["cameras"]["front"].update(change)
    path.write_text(json.dumps(told))
    before = path.read_bytes()
    with pytest.raises(ConfigurationError, match=named) as caught:
        read_calibrations(path)
    assert "lab.cameras.json" in str(caught.value)
    with pytest.raises(ConfigurationError):
        save_calibration(path, "wrist", WRIST)
    assert path.read_bytes() == before


def test_other_versions_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="adamanip calibrate"):
        read_calibrations(tmp_path / "none.json")
    (tmp_path / "two.json").write_text(TEXT.replace('"version": 1', '"version": 2'))
    with pytest.raises(ConfigurationError, match="version is 2"):
        read_calibrations(tmp_path / "two.json")


def test_what_could_not_be_read_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "lab.cameras.json"
    with pytest.raises(ConfigurationError, match="no pose"):
        save_calibration(path, "front", CameraCalibration("1", IMAGER, 2 * np.eye(4)))
    with pytest.raises(ConfigurationError, match="a camera's key"):
        save_calibration(path, "no key", FRONT)
    assert not path.exists()
