"""The calibration file: where the cameras of a set-up are and how they see. JSON, checked strictly, versioned.

Beside each camera stands how it was found and how well, for people to read; nothing depends on it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.calibration.intrinsics_json import (
    check_intrinsics,
    intrinsics_from_json,
    intrinsics_to_json,
)
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.util import json_fields as checked_json
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.files import write_atomically

VERSION = 1
SUFFIX = ".cameras.json"
"""Of the file beside a robot's id. LeRobot reads ``<id>.json`` of that folder as motors, and fails on any other."""
RIGID_WITHIN = 1e-6
"""How far from a rotation a matrix may be that was written by a program."""
_NUMBER = checked_json.number(-1e6, 1e6)
_ROW = checked_json.listing(_NUMBER, 4, 4)
_KEY = checked_json.text(r"[A-Za-z0-9_-]{1,64}", "a camera's key")
_FACT = checked_json.either(_NUMBER, checked_json.text(r"[^\x00-\x1f]{0,200}", "a line of text"))


def check_pose(name: str, value: object) -> NDArray[np.float64]:
    """Checks for a rigid transform (4, 4)."""
    pose = np.array(checked_json.listing(_ROW, 4, 4)(name, value), np.float64)
    rotation = pose[:3, :3]
    rigid = np.abs(rotation @ rotation.T - np.eye(3)).max() < RIGID_WITHIN and np.linalg.det(rotation) > 0
    if not rigid or not np.array_equal(pose[3], (0, 0, 0, 1)):
        raise ValueError(f"{name} is no pose: a rotation and a position, last row 0 0 0 1")
    return pose


_CAMERA = checked_json.table(
    {
        "camera": checked_json.text(r"[^\x00-\x1f]{1,200}", "a serial number or name"),
        "depth": check_intrinsics,
        "depth_in_base": checked_json.optional(check_pose),
        "depth_in_tcp": checked_json.optional(check_pose),
        "color": checked_json.optional(check_intrinsics),
        "depth_in_color": checked_json.optional(check_pose),
        "found": checked_json.mapping(_KEY, _FACT, 64),
    }
)
_CHECK = checked_json.table(
    {"version": checked_json.integer(VERSION, VERSION), "cameras": checked_json.mapping(_KEY, _CAMERA, 16)}
)


def read_calibrations(path: Path) -> dict[str, CameraCalibration]:
    """Returns camera key -> calibration of a file; raises `ConfigurationError` where it is missing or none."""
    return {key: _calibration(told) for key, told in _read(path).items()}


def save_calibration(
    path: Path, key: str, calibration: CameraCalibration, found: Mapping[str, float | str] | None = None
) -> None:
    """Writes one camera into a file, atomically; its other cameras stay.

    Args:
        path: of the file; made if it is not there.
        key: of the camera in the robot's configuration, ``front`` for instance.
        calibration: of it.
        found: how it was found and how well: names and numbers or words.

    Raises:
        ConfigurationError: what is there is no calibration file (it is not touched), or the calibration is none.
    """
    cameras = (
        {name: _to_json(_calibration(told), told["found"]) for name, told in _read(path).items()}
        if path.exists()
        else {}
    )
    content = {"version": VERSION, "cameras": {**cameras, key: _to_json(calibration, found or {})}}
    text = json.dumps(content, indent=2)
    _checked(path, lambda: checked_json.parse(text))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())


def _read(path: Path) -> dict[str, Any]:
    return _checked(path, lambda: checked_json.read(path))


def _checked(path: Path, parse: Any) -> dict[str, Any]:
    try:
        cameras: dict[str, Any] = _CHECK("the file", parse())["cameras"]
        for key, told in cameras.items():
            if (told["depth_in_base"] is None) == (told["depth_in_tcp"] is None):
                raise ValueError(f"{key} stands in the base's frame and on the tool, or in neither")
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            "No calibration of cameras.",
            got=f"{path}: {error}",
            allowed=f"a file of version {VERSION} that `adamanip calibrate` wrote",
            hint="adamanip calibrate",
        ) from error
    return cameras


def _calibration(told: Mapping[str, Any]) -> CameraCalibration:
    return CameraCalibration(
        camera=told["camera"],
        depth=intrinsics_from_json(told["depth"]),
        depth_in_base=told["depth_in_base"],
        depth_in_tcp=told["depth_in_tcp"],
        color=None if told["color"] is None else intrinsics_from_json(told["color"]),
        depth_in_color=told["depth_in_color"],
    )


def _to_json(calibration: CameraCalibration, found: Mapping[str, float | str]) -> dict[str, Any]:
    def pose(value: NDArray[np.float64] | None) -> Any:
        return None if value is None else value.tolist()

    return {
        "camera": calibration.camera,
        "depth": intrinsics_to_json(calibration.depth),
        "depth_in_base": pose(calibration.depth_in_base),
        "depth_in_tcp": pose(calibration.depth_in_tcp),
        "color": None if calibration.color is None else intrinsics_to_json(calibration.color),
        "depth_in_color": pose(calibration.depth_in_color),
        "found": dict(found),
    }
