"""A camera is calibrated on the robot's own hand: laws on clouds of a hand made of boxes, before a wall."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract.rotations import Array, matrix_from_rotation_vector, rotation_about, transform
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.calibration import on_hand, views
from lerobot_adamanip.hardware.calibration.hand_shape import franka_hand
from lerobot_adamanip.hardware.calibration.on_hand import CameraOnHand, calibrate_on_hand
from lerobot_adamanip.hardware.calibration.self_calibration import MAX_FRAMES, SelfCalibration, moved
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics, read_calibrations
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

EYE = np.array([0.0, -0.58, 1.16])
CENTER = np.array([0.55, 0.0, 0.765])
PLACES = np.stack(np.meshgrid([0.4, 0.55, 0.7], [-0.2, 0.0, 0.2], [0.6, 0.765, 0.95]), axis=-1).reshape(-1, 3)
"""Points in the workspace at which a residual error counts."""
HAND = replace(franka_hand(), accuracy_m=0.0005)
"""The hand of these clouds is exactly that of the boxes."""
FORWARD = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Rotation of a hand that points to the wall."""


def poses(seed: int, count: int) -> list[Array]:
    """Tool poses before the wall, at least 3 cm apart."""
    rng, made = np.random.default_rng(seed), list[Array]()
    while len(made) < count:
        place = rng.uniform((0.40, -0.15, 0.62), (0.56, 0.15, 0.85))
        turn = matrix_from_rotation_vector(rng.uniform(-0.4, 0.4, 3))
        if all(np.linalg.norm(place - other[:3, 3]) > 0.03 for other in made):
            made.append(transform(place, turn @ FORWARD))
    return made


def scene(tcp_in_base: Array | None, gripper: float = 1.0) -> Array:
    """Points of a wall and of the sides of a hand that the camera sees, (N, 3), base frame."""
    across, up = np.meshgrid(np.arange(-0.3, 0.3, 0.006), np.arange(0.5, 1.0, 0.006))
    wall = np.stack([np.full(across.size, 0.64), across.ravel(), up.ravel()], axis=1)
    if tcp_in_base is None:
        return wall
    points, normals = (part @ tcp_in_base[:3, :3].T for part in franka_hand().at(gripper))
    points = points + tcp_in_base[:3, 3]
    return np.concatenate([wall, points[((EYE - points) * normals).sum(1) > 0]])


def seen(points: Array, error: Array, noise: float, rng: np.random.Generator) -> Any:
    away = points - EYE
    rays = away / np.linalg.norm(away, axis=1, keepdims=True)
    return moved(points + noise * rng.standard_normal((len(points), 1)) * rays, error).astype(np.float32)


def camera_error(seed: int, mm: float, degrees: float) -> Array:
    rng = np.random.default_rng(seed)
    shift, rotation = rng.standard_normal(3), rotation_about(rng.standard_normal(3), np.radians(degrees))
    return transform(CENTER + 1e-3 * mm * shift / np.linalg.norm(shift) - rotation @ CENTER, rotation)


def residual(estimate: SelfCalibration, error: Array) -> float:
    """Mean error of corrected points in the workspace [m]."""
    return float(np.linalg.norm(moved(PLACES, estimate.correction @ error) - PLACES, axis=1).mean())


def calibrated(seed: int, error: Array, frames: int, noise: float = 3e-3, **options: Any) -> SelfCalibration:
    estimate, rng = SelfCalibration(HAND, **{"eye": EYE, **options}), np.random.default_rng(seed)
    for pose in poses(seed, frames):
        assert estimate.update(seen(scene(pose), error, noise, rng), pose, 1.0)
    return estimate


@pytest.mark.parametrize(("mm", "degrees"), [(10.0, 1.0), (20.0, 2.0), (30.0, 3.0)])
def test_a_moved_camera_is_found_after_three_and_five_key_frames(mm: float, degrees: float) -> None:
    for seed in range(5):
        error = camera_error(seed, mm, degrees)
        few, more = calibrated(seed, error, 3), calibrated(seed, error, 5)
        assert residual(few, error) < 3e-3
        assert residual(more, error) < 2e-3
        assert few.moved_by_m == pytest.approx(1e-3 * mm, abs=3e-3)
        one = calibrated(seed, error, 1)
        assert more.uncertainty_m < one.uncertainty_m < 3e-3
        assert residual(more, error) < 3 * more.uncertainty_m


def test_an_exact_camera_hardly_moves() -> None:
    for seed in range(5):
        for noise in (0.0, 3e-3):
            assert residual(calibrated(seed, np.eye(4), 3, noise), np.eye(4)) < 1.5e-3 + noise / 3


@pytest.mark.parametrize("there", [True, False])
def test_a_cloud_without_a_hand_changes_nothing(there: bool) -> None:
    """A wall where the hand should be, or nothing."""
    estimate, (pose, *_) = SelfCalibration(franka_hand(), EYE), poses(0, 1)
    if there:
        pose[0, 3] = 0.62
    cloud = scene(None).astype(np.float32) if there else np.zeros((1024, 3), np.float32)
    assert not estimate.update(cloud, pose, 1.0)
    assert estimate.corrected(cloud) is cloud
    assert np.array_equal(estimate.correction, np.eye(4))
    known = calibrated(0, camera_error(0, 20.0, 2.0), 3)
    before = known.correction
    assert not known.update(cloud, pose, 1.0)
    assert known.correction is before
    assert known.frames == 3


def test_what_is_seen_of_a_resting_hand_is_seen_once() -> None:
    estimate, (pose, *_), rng = SelfCalibration(franka_hand(), EYE), poses(0, 1), np.random.default_rng(0)
    for _ in range(3):
        estimate.update(seen(scene(pose), np.eye(4), 3e-3, rng), pose, 1.0)
    assert estimate.frames == 1
    assert calibrated(0, np.eye(4), MAX_FRAMES + 2).frames == MAX_FRAMES


def test_it_is_kept_until_the_camera_moves_or_somebody_says_so() -> None:
    first, second = camera_error(0, 10.0, 1.0), camera_error(1, 30.0, 2.0)
    estimate, rng = calibrated(0, first, 5), np.random.default_rng(0)
    for number, pose in enumerate(poses(9, 4)):
        assert estimate.update(seen(scene(pose), first, 3e-3, rng), pose, 1.0)
        assert residual(estimate, first) < 2e-3, number
    for pose in poses(10, 3):
        assert estimate.update(seen(scene(pose), second, 3e-3, rng), pose, 1.0)
    assert residual(estimate, second) < 3e-3


def test_the_fingers_open_with_the_gripper() -> None:
    shape = franka_hand()
    (closed, _), (opened, _) = shape.at(0.0), shape.at(1.0)
    assert opened[:, 1] - closed[:, 1] == pytest.approx(0.04 * shape.fingers)
    assert set(shape.fingers) == {-1.0, 0.0, 1.0}


# Depth pictures and the robot -----------------------------------------------------------------------------------------

SIZE, FOCAL = 240, 246.0
INTRINSICS = Intrinsics(np.array([[FOCAL, 0, 119.5], [0, FOCAL, 119.5], [0, 0, 1]]), np.zeros(0), SIZE, SIZE)


def looking() -> Array:
    """Pose of the camera, OpenCV axes."""
    forward = (CENTER - EYE) / np.linalg.norm(CENTER - EYE)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return transform(EYE, np.stack([right, np.cross(forward, right), forward], axis=1))


def picture(pose: Array, camera: Array) -> Any:
    """Depth (H, W) [mm] of the scene as a camera at a pose sees it."""
    points = scene(pose)
    beside = np.stack([*map(np.ravel, np.meshgrid(*[np.linspace(-2e-3, 2e-3, 3)] * 2))], axis=1)
    in_camera = moved(points, np.linalg.inv(camera))[:, None] + np.pad(beside, ((0, 0), (0, 1)))
    in_camera = in_camera.reshape(-1, 3)
    pixels = np.round(in_camera[:, :2] / in_camera[:, 2:] * FOCAL + 119.5).astype(int)
    inside = ((pixels >= 0) & (pixels < SIZE)).all(1)
    depth = np.full((SIZE, SIZE), np.inf)
    np.minimum.at(depth, (pixels[inside, 1], pixels[inside, 0]), 1e3 * in_camera[inside, 2])
    return np.where(np.isfinite(depth), depth, 0).astype(np.uint16)


def reading(pose: Array, speed: float = 0.0) -> ArmReading:
    seven = np.zeros(7)
    return ArmReading(0.0, 0.0, pose, 1.0, seven, seven + speed, seven, ArmMode.IDLE)


def test_a_moved_camera_is_told_once_and_corrected(caplog: pytest.LogCaptureFixture) -> None:
    error = camera_error(3, 15.0, 1.0)
    true = np.linalg.inv(error) @ looking()
    camera = CameraOnHand(CameraCalibration("front", INTRINSICS, looking()))
    with caplog.at_level(logging.WARNING):
        for number, pose in enumerate(poses(0, 5)):
            assert not camera.update(picture(pose, true), reading(pose, speed=0.5)), "the arm moves"
            assert camera.update(picture(pose, true), reading(pose)), number
    assert len(caplog.messages) == 1
    assert "Camera front stands 1" in caplog.messages[0]
    corrected = camera.corrected().depth_in_base
    assert corrected is not None
    assert np.linalg.norm(corrected[:3, 3] - true[:3, 3]) < 6e-3
    assert residual(camera.estimate, error) < 4e-3


def test_a_camera_in_its_place_is_not_told(caplog: pytest.LogCaptureFixture) -> None:
    camera = CameraOnHand(CameraCalibration("front", INTRINSICS, looking()))
    for pose in poses(0, 4):
        camera.update(picture(pose, looking()), reading(pose))
    assert not caplog.messages
    assert camera.estimate.moved_by_m < 4e-3


class Guided:
    """A robot whose hand a person guides from pose to pose, which leaves a fault each time."""

    def __init__(self, hands: list[Array], calibration: CameraCalibration | None, true: Array) -> None:
        self.hands, self.true = iter(hands), true
        calibrations = {} if calibration is None else {"front": calibration}
        self.session: Any = SimpleNamespace(calibrations=calibrations, reading=None)
        self.cameras = {"front": self}
        self.is_faulty = self.is_open = False
        self.use_depth, self.color_intrinsics = True, None

    def ask(self) -> bool:
        pose = next(self.hands, None)
        self.is_faulty = True
        if pose is not None:
            self.session.reading = reading(pose)
        return pose is not None

    def recover(self) -> None:
        self.is_faulty = False

    def get_observation(self) -> None:
        if self.is_faulty:
            raise RobotError("guided")

    def frame_after(self, stamp: float, timeout: float) -> Any:
        return SimpleNamespace(depth=picture(self.session.reading.tcp_in_base, self.true))

    def connect(self, calibrate: bool) -> None:
        self.is_open = True

    def disconnect(self) -> None:
        self.is_open = False


@pytest.fixture
def guided() -> Guided:
    true = np.linalg.inv(camera_error(4, 20.0, 2.0)) @ looking()
    return Guided(poses(4, 5), CameraCalibration("front", INTRINSICS, looking()), true)


def test_a_camera_is_calibrated_on_the_hand_by_a_command(
    guided: Guided, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from lerobot_adamanip.cli import calibrate

    monkeypatch.setattr(views, "robot_from_file", lambda path: guided)
    monkeypatch.setattr(calibrate, "_wants_picture", guided.ask)
    out = tmp_path / "cameras.json"
    words = ["calibrate", "--on-robot", "--record", "robot.json", "--out", str(out), "--json"]
    assert main(words) == 0
    assert not guided.is_open
    told = json.loads(capsys.readouterr().out)
    assert told["poses"] == 5
    assert told["moved_mm"] == pytest.approx(20.0, abs=4.0)
    stored = read_calibrations(out)["front"].depth_in_base
    assert stored is not None
    assert np.linalg.norm(moved(PLACES, stored @ np.linalg.inv(guided.true)) - PLACES, axis=1).mean() < 4e-3


def test_what_cannot_be_calibrated_on_the_hand_is_one_clear_error(
    guided: Guided, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigurationError, match="Too few poses"):
        calibrate_on_hand(guided, "front", lambda: False, print)
    for calibration in (None, CameraCalibration("hand", INTRINSICS, None, np.eye(4))):
        other = Guided([], calibration, looking())
        with pytest.raises(ConfigurationError, match="cannot be calibrated on the hand"):
            calibrate_on_hand(other, "front", other.ask, print)
    guided.use_depth = False
    with pytest.raises(ConfigurationError, match="takes no depth"):
        calibrate_on_hand(guided, "front", guided.ask, print)
    guided.cameras = {}
    with pytest.raises(ConfigurationError, match="no camera front that can be calibrated"):
        calibrate_on_hand(guided, "front", guided.ask, print)
    assert main(["calibrate", "--on-robot"]) == 2
    assert "--record" in capsys.readouterr().err
    assert on_hand.MIN_POSES == 3
