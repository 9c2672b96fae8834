"""Frames of depth cameras, their calibration, and the calibration file: strictly checked, versioned JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import PIXEL_CONVENTION
from lerobot_adamanip.hardware.arm_process.mailbox import message
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.files import write_atomically

VERSION = 1
RIGID_WITHIN = 1e-6
"""Tolerance for rotation matrices in the file."""


@message
@dataclass(frozen=True)
class Frame:
    """One camera exposure.

    Attributes:
        stamp: exposure time, `time.perf_counter()` [s]; never later than ``arrival``.
        arrival: arrival time in this process [s, same clock].
        color: (H, W, 3) uint8 RGB; None if disabled.
        depth: (H, W) uint16 [mm], 0 for invalid pixels; None if disabled.
        number: exposure counter of the camera; a gap means dropped frames.
    """

    stamp: float
    arrival: float
    color: NDArray[np.uint8] | None
    depth: NDArray[np.uint16] | None
    number: int


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of an imager in OpenCV's model.

    Attributes:
        matrix: (3, 3) camera matrix [px].
        distortion: 0, 5 or 8 coefficients in OpenCV's order.
        width, height: image size of these intrinsics [px].
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    width: int
    height: int


@dataclass(frozen=True)
class CameraCalibration:
    """Calibration of a camera: pose and intrinsics that turn its depth into a point cloud.

    Attributes:
        camera: serial number or name.
        depth: intrinsics of the depth imager; colour is registered to it or not used.
        depth_in_base: (4, 4) pose of the depth imager, base frame, OpenCV axes [m]; None for a camera on the hand.
        depth_in_tcp: (4, 4) pose in the tool frame for a camera on the hand [m]; None otherwise.
        color: intrinsics of the colour imager, if it was calibrated.
        depth_in_color: (4, 4) pose of the depth imager in the colour frame [m]; identity if they are the same.
    """

    camera: str
    depth: Intrinsics
    depth_in_base: NDArray[np.float64] | None
    depth_in_tcp: NDArray[np.float64] | None = None
    color: Intrinsics | None = None
    depth_in_color: NDArray[np.float64] | None = None

    @property
    def depth_pose(self) -> NDArray[np.float64]:
        """(4, 4) pose of the depth imager in the base frame, or in the tool frame for a camera on the hand [m]."""
        pose = self.depth_in_tcp if self.depth_in_base is None else self.depth_in_base
        assert pose is not None
        return pose

    def at(self, pose: NDArray[np.float64]) -> CameraCalibration:
        """Returns the calibration of the same camera with another `depth_pose`."""
        return replace(self, depth_in_tcp=pose) if self.depth_in_base is None else replace(self, depth_in_base=pose)


def simulated_calibration(camera: Mapping[str, Any], name: str = "simulated") -> CameraCalibration:
    """Returns the calibration of a simulated camera, which has one imager for colour and depth.

    Args:
        camera: ``intrinsics`` (3, 3) [px], ``extrinsics`` (4, 4) pose in the base frame, OpenCV axes [m], ``width`` and
            ``height`` [px], ``convention`` of the pixel coordinates.
        name: camera name.

    Raises:
        ConfigurationError: other pixel coordinates, or unnamed ones. Half a pixel moves the cloud by 1.5 mm.
    """
    if (convention := camera.get("convention")) != PIXEL_CONVENTION:
        raise ConfigurationError(
            "The intrinsics of a camera have unknown pixel coordinates.",
            got=f"convention={convention!r}",
            allowed=f"{PIXEL_CONVENTION!r}: the centre of the first pixel is (0, 0)",
            hint="data of this version",
        )
    matrix = np.array(camera["intrinsics"], np.float64)
    imager = Intrinsics(matrix, np.zeros(0), int(camera["width"]), int(camera["height"]))
    pose = np.array(camera["extrinsics"], np.float64)
    return CameraCalibration(name, imager, pose, color=imager, depth_in_color=np.eye(4))


# Calibration file -----------------------------------------------------------------------------------------------------

_NUMBER = json_fields.number(-1e6, 1e6)
_POSE = json_fields.listing(json_fields.listing(_NUMBER, 4, 4), 4, 4)
_INTRINSICS = json_fields.table(
    {
        "matrix": json_fields.listing(json_fields.listing(_NUMBER, 3, 3), 3, 3),
        "distortion": json_fields.listing(_NUMBER, 0, 8),
        "width": json_fields.integer(1, 20_000),
        "height": json_fields.integer(1, 20_000),
    }
)
_KEY = json_fields.text(r"[A-Za-z0-9_-]{1,64}", "a camera's key")
_FACT = json_fields.either(_NUMBER, json_fields.text(r"[^\x00-\x1f]{0,200}", "a line of text"))
check_name = json_fields.text(r"[^\x00-\x1f]{1,200}", "a serial number or name")


def check_pose(name: str, value: object) -> NDArray[np.float64]:
    """Returns a rigid transform (4, 4). Raises ValueError for any other value."""
    pose = np.array(_POSE(name, value), np.float64)
    rotation = pose[:3, :3]
    rigid = np.abs(rotation @ rotation.T - np.eye(3)).max() < RIGID_WITHIN and np.linalg.det(rotation) > 0
    if not rigid or not np.array_equal(pose[3], (0, 0, 0, 1)):
        raise ValueError(f"{name} is no pose: a rotation and a position, last row 0 0 0 1")
    return pose


def check_intrinsics(name: str, value: object) -> Intrinsics:
    """Returns pinhole intrinsics with 0, 5 or 8 coefficients. Raises ValueError for any other value."""
    fields = _INTRINSICS(name, value)
    (fx, skew, _), (low, fy, _), last = fields["matrix"]
    if fx <= 0 or fy <= 0 or skew != 0 or low != 0 or last != (0, 0, 1):
        raise ValueError(f"{name}.matrix is no pinhole matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0")
    if len(fields["distortion"]) not in (0, 5, 8):
        raise ValueError(f"{name}.distortion has {len(fields['distortion'])} coefficients, not 0, 5 or 8")
    matrix, distortion = np.array(fields["matrix"], np.float64), np.array(fields["distortion"], np.float64)
    return Intrinsics(matrix, distortion, fields["width"], fields["height"])


_CAMERA = json_fields.table(
    {
        "camera": check_name,
        "depth": check_intrinsics,
        "depth_in_base": json_fields.optional(check_pose),
        "depth_in_tcp": json_fields.optional(check_pose),
        "color": json_fields.optional(check_intrinsics),
        "depth_in_color": json_fields.optional(check_pose),
        "found": json_fields.mapping(_KEY, _FACT, 64),
    }
)
_CHECK = json_fields.table(
    {"version": json_fields.integer(VERSION, VERSION), "cameras": json_fields.mapping(_KEY, _CAMERA, 16)}
)


def to_json(content: object, indent: int | None = None) -> bytes:
    """Returns JSON. Arrays become lists, dataclasses become objects."""
    text = json.dumps(content, indent=indent, default=lambda v: v.tolist() if isinstance(v, np.ndarray) else vars(v))
    return text.encode()


def read_calibrations(path: Path) -> dict[str, CameraCalibration]:
    """Returns camera key -> calibration. Raises `ConfigurationError` for a missing or invalid file."""
    cameras = _checked(path, lambda: json_fields.read(path))
    for camera in cameras.values():
        del camera["found"]
    return {key: CameraCalibration(**camera) for key, camera in cameras.items()}


def save_calibration(
    path: Path, key: str, calibration: CameraCalibration, found: Mapping[str, float | str] | None = None
) -> None:
    """Writes the calibration of one camera to a file atomically. Other cameras in the file stay.

    Args:
        path: path of the file, created if missing.
        key: camera key in the robot's configuration, e.g. ``front``.
        calibration: calibration of the camera.
        found: notes on method and accuracy for human readers: name -> number or text.

    Raises:
        ConfigurationError: the existing file is not a calibration file (it is kept), or the calibration is invalid.
    """
    cameras = _checked(path, lambda: json_fields.read(path)) if path.exists() else {}
    cameras[key] = {**vars(calibration), "found": dict(found or {})}
    content = to_json({"version": VERSION, "cameras": cameras}, indent=2)
    _checked(path, lambda: json_fields.parse(content))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)


def _checked(path: Path, parse: Callable[[], Any]) -> dict[str, Any]:
    try:
        cameras: dict[str, Any] = _CHECK("the file", parse())["cameras"]
        for key, camera in cameras.items():
            if (camera["depth_in_base"] is None) == (camera["depth_in_tcp"] is None):
                raise ValueError(f"{key} has a pose in the base's frame and on the tool, or neither")
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            "No valid camera calibration.",
            got=f"{path}: {error}",
            allowed=f"a file of version {VERSION} that `adamanip calibrate` wrote",
            hint="adamanip calibrate views --record robot.json --out FILE",
        ) from error
    return cameras
