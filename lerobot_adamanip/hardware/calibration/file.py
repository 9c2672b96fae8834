"""Calibration file: poses and intrinsics of a set-up's cameras, as strictly checked, versioned JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.files import write_atomically

VERSION = 1
RIGID_WITHIN = 1e-6
"""Tolerance for rotation matrices in the file."""
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
    found = _INTRINSICS(name, value)
    (fx, skew, _), (low, fy, _), last = found["matrix"]
    if fx <= 0 or fy <= 0 or skew != 0 or low != 0 or last != (0, 0, 1):
        raise ValueError(f"{name}.matrix is no pinhole matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0")
    if len(found["distortion"]) not in (0, 5, 8):
        raise ValueError(f"{name}.distortion has {len(found['distortion'])} coefficients, not 0, 5 or 8")
    matrix, distortion = np.array(found["matrix"], np.float64), np.array(found["distortion"], np.float64)
    return Intrinsics(matrix, distortion, found["width"], found["height"])


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
    for told in cameras.values():
        del told["found"]
    return {key: CameraCalibration(**told) for key, told in cameras.items()}


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
        for key, told in cameras.items():
            if (told["depth_in_base"] is None) == (told["depth_in_tcp"] is None):
                raise ValueError(f"{key} has a pose in the base's frame and on the tool, or neither")
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            "No valid camera calibration.",
            got=f"{path}: {error}",
            allowed=f"a file of version {VERSION} that `adamanip calibrate` wrote",
            hint="adamanip calibrate views --record robot.json --out FILE",
        ) from error
    return cameras
