"""Errors of a robot's sensors, as one value: a level such as ``d435``, with single parts changed.

Sources of the numbers:

[1] Intel, "Tuning depth cameras for best performance": the noise of depth is distance^2 x subpixel / (focal length x
    baseline), with a subpixel of 0.08 px for a well-textured scene, and the D435's best resolution is 848 x 480.
[2] Intel RealSense D400 series datasheet: baseline 50 mm, imagers with 90 degrees across (424 px at 848 px).
[3] Intel, "Subpixel linearity improvement for D400": disparities have 5 bits below the pixel.
[4] Huber et al., "Hydra: marker-free RGB-D hand-eye calibration" (arXiv 2504.20584): classical calibrations are off by
    7 mm in the arm's workspace.
[5] Nguyen et al., "Modeling Kinect sensor noise" (3DIM 2012): no depth beyond about 80 degrees of incidence.
[6] Franzese et al., "MUKCa" (arXiv 2503.12584): the Franka's own model is off by up to 10 mm, and by 0.2 mm after
    calibration.

Shares of lost and flying pixels have no published value for this scene. They are chosen such that the front camera
loses 5 to 20 % (``d435``) and 15 to 40 % (``rough``) of its pixels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from lerobot_adamanip.util.errors import ConfigurationError, nearest

EXACT = "exact"
"""Level without errors, the default."""
MAX_SENSING_TEXT = 400
SENSING_TEXT = rf"[a-z0-9_=.,-]{{1,{MAX_SENSING_TEXT}}}"
"""Form of a level with its parts, in files."""
BASELINE_M, FOCAL_PX = 0.050, 424.0
"""Distance of the D435's imagers [m], and their focal length at 848 px [2]."""


@dataclass(frozen=True)
class Sensing:
    """Errors of the sensors; all are 0 in the level `EXACT`.

    Attributes:
        camera_error_mm, camera_error_deg: rigid error of each camera's pose, constant for an episode, in a random
            direction. In the middle of the workspace, a cloud is off by ``camera_error_mm``.
        disparity_noise_px: standard deviation of the disparity, in pixels of a D435. 0.08 is 2.7 mm at 0.85 m.
        disparity_step_px: smallest step of the disparity, in pixels of a D435.
        grazing_deg: surfaces seen at less than this angle return no depth.
        edge_holes: share of the pixels at depth edges that return no depth. If it is above 0, there is none either
            where only one of the two imagers sees the surface.
        flying: share of the other pixels at depth edges that lie between foreground and background.
        lost: share of all pixels that return no depth, in patches.
        dull: share of the pixels on black, glass and polished parts of the object that return no depth.
        arm_error_mm, arm_error_deg: error of the arm's kinematic model, constant in the tool's frame for an episode.
            State and actions share it, so it appears as a shift of the cloud that turns with the tool.
        effort_noise_nm: standard deviation of each joint's torque [N m].
        latency_ms: age of clouds and images in dense control, rounded to whole steps. The arm rests at a key frame.
    """

    camera_error_mm: float = 0.0
    camera_error_deg: float = 0.0
    disparity_noise_px: float = 0.0
    disparity_step_px: float = 0.0
    grazing_deg: float = 0.0
    edge_holes: float = 0.0
    flying: float = 0.0
    lost: float = 0.0
    dull: float = 0.0
    arm_error_mm: float = 0.0
    arm_error_deg: float = 0.0
    effort_noise_nm: float = 0.0
    latency_ms: float = 0.0

    @property
    def changes_depth(self) -> bool:
        """Whether single pixels of a depth image change."""
        return any(getattr(self, name) > 0 for name in _OF_DEPTH)

    def steps_late(self, fps: int) -> int:
        """Returns the age of clouds and images in steps of dense control at ``fps`` Hz."""
        return math.floor(1e-3 * self.latency_ms * fps + 0.5)


_OF_DEPTH = ("disparity_noise_px", "disparity_step_px", "grazing_deg", "edge_holes", "flying", "lost", "dull")
_LARGEST: Mapping[str, float] = {
    "camera_error_mm": 100.0, "camera_error_deg": 10.0, "disparity_noise_px": 2.0, "disparity_step_px": 2.0,
    "grazing_deg": 60.0, "edge_holes": 1.0, "flying": 1.0, "lost": 0.9, "dull": 1.0, "arm_error_mm": 30.0,
    "arm_error_deg": 5.0, "effort_noise_nm": 10.0, "latency_ms": 1000.0,
}  # fmt: skip
"""Largest value of each part; the smallest is 0."""
LEVELS: Mapping[str, Sensing] = {
    EXACT: Sensing(),
    # A D435 beside the robot, calibrated by a board, and a calibrated arm.
    "d435": Sensing(
        camera_error_mm=7.0,  # [4]
        camera_error_deg=0.5,
        disparity_noise_px=0.08,  # [1]
        disparity_step_px=1 / 32,  # [3]
        grazing_deg=10.0,  # [5]
        edge_holes=0.5,
        flying=0.1,
        lost=0.03,
        dull=0.5,
        arm_error_mm=1.0,  # chosen, between 0.2 (calibrated) and 10 (as delivered) of [6]
        arm_error_deg=0.1,
        effort_noise_nm=0.1,
        latency_ms=60.0,  # two frames at 30 Hz
    ),
    # The same with twice the noise, a bumped camera, and an arm that is less well calibrated.
    "rough": Sensing(
        camera_error_mm=15.0,
        camera_error_deg=1.5,
        disparity_noise_px=0.16,
        disparity_step_px=1 / 16,
        grazing_deg=15.0,
        edge_holes=0.8,
        flying=0.3,
        lost=0.15,
        dull=0.8,
        arm_error_mm=3.0,
        arm_error_deg=0.3,
        effort_noise_nm=0.3,
        latency_ms=150.0,
    ),
}
"""Level -> its parts."""


def parse_sensing(text: str) -> Sensing:
    """Returns the sensing of ``LEVEL`` or ``LEVEL,PART=VALUE,...``: ``d435,camera_error_mm=20``.

    Raises:
        ConfigurationError: the level or a part does not exist, or a value is no number in its range.
    """
    if len(text) > MAX_SENSING_TEXT:
        raise _error(text[:80], f"at most {MAX_SENSING_TEXT} characters", None)
    level, *parts = (word.strip() for word in text.split(","))
    if level not in LEVELS:
        raise _error(text, f"a level first: {', '.join(LEVELS)}", nearest(level, LEVELS))
    names, values = [item.name for item in fields(Sensing)], {}
    for part in parts:
        name, _, number = (word.strip() for word in part.partition("="))
        if name not in names:
            near = nearest(name, names)
            allowed = "PART=VALUE after the level, with PART one of the fields of Sensing"
            raise _error(text, allowed, near and f"{level},{near}={number or 0}")
        try:
            values[name] = float(number) if number.isascii() else math.nan
        except ValueError:
            values[name] = math.nan
        if not 0.0 <= values[name] <= _LARGEST[name]:
            raise _error(
                text, f"{name} from 0 to {_LARGEST[name]:g}", f"{level},{name}={getattr(LEVELS['d435'], name):g}"
            )
    return replace(LEVELS[level], **values)


def _error(text: str, allowed: str, advice: str | None) -> ConfigurationError:
    example = f"--env.sensing={advice or 'd435,camera_error_mm=20'}, see docs/sensing.md"
    return ConfigurationError("Unknown sensing.", got=repr(text), allowed=allowed, hint=example)
