"""Intrinsics in JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.hardware.camera_frames import Intrinsics
from lerobot_adamanip.util import json_fields as checked_json

_NUMBER = checked_json.number(-1e6, 1e6)
_TABLE = checked_json.table(
    {
        "matrix": checked_json.listing(checked_json.listing(_NUMBER, 3, 3), 3, 3),
        "distortion": checked_json.listing(_NUMBER, 0, 8),
        "width": checked_json.integer(1, 20_000),
        "height": checked_json.integer(1, 20_000),
    }
)


def check_intrinsics(name: str, value: object) -> dict[str, Any]:
    """Checks for the four fields of `Intrinsics`: a pinhole with focal lengths, and 0, 5 or 8 coefficients."""
    found: dict[str, Any] = _TABLE(name, value)
    (fx, skew, _), (low, fy, _), last = found["matrix"]
    if fx <= 0 or fy <= 0 or skew != 0 or low != 0 or last != (0, 0, 1):
        raise ValueError(f"{name}.matrix is no pinhole's: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0")
    if len(found["distortion"]) not in (0, 5, 8):
        raise ValueError(f"{name}.distortion has {len(found['distortion'])} coefficients, not 0, 5 or 8")
    return found


def intrinsics_from_json(found: Mapping[str, Any]) -> Intrinsics:
    """Returns what `check_intrinsics` has checked."""
    matrix, distortion = np.array(found["matrix"], np.float64), np.array(found["distortion"], np.float64)
    return Intrinsics(matrix, distortion, found["width"], found["height"])


def intrinsics_to_json(intrinsics: Intrinsics) -> dict[str, Any]:
    """Returns lists and numbers."""
    return {
        "matrix": intrinsics.matrix.tolist(),
        "distortion": intrinsics.distortion.tolist(),
        "width": intrinsics.width,
        "height": intrinsics.height,
    }
