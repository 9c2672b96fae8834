"""Calibration of a resting depth camera on the robot's own hand: for each observation, and without a board."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.pointcloud import depth_size
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.calibration.hand_shape import franka_hand
from lerobot_adamanip.hardware.calibration.self_calibration import WARN_M, SelfCalibration
from lerobot_adamanip.hardware.calibration.views import PICTURE_S, camera_of, observe_after_guiding
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.hardware.depth_cloud import points_in_base
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

MAX_SPEED = 0.05
"""Maximum joint speed of an arm at rest, whose pose is that of the exposure [rad/s]."""
MIN_POSES = 3
"""Fewest poses of the hand in a calibration."""
_log = logging.getLogger(__name__)


class CameraOnHand:
    """Corrects the calibration of one camera beside the robot. The camera may be moved: the hand shows it.

    Args:
        calibration: calibration within 30 mm and 3 degrees, with the camera's pose in the robot's base.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        assert calibration.depth_in_base is not None
        self._calibration, self._pose = calibration, calibration.depth_in_base
        self.estimate = SelfCalibration(franka_hand(), self._pose[:3, 3])
        self._warned_at_m = 0.0

    def update(self, depth: NDArray[np.uint16], reading: ArmReading) -> bool:
        """Improves the estimate; returns whether a resting hand is seen. Warns if the camera has moved by 5 mm.

        Args:
            depth: (H, W) [mm].
            reading: state of the arm at the exposure.
        """
        if float(np.abs(reading.qvel).max()) > MAX_SPEED:
            return False
        stride = max(1, round(depth.shape[0] / depth_size(DEFAULT_NUM_POINTS)))
        points = points_in_base(depth, self._calibration, stride)
        is_seen = self.estimate.update(points, reading.tcp_in_base, reading.gripper)
        away = self.estimate.moved_by_m
        if is_seen and self.estimate.frames >= MIN_POSES and away > WARN_M and abs(away - self._warned_at_m) > WARN_M:
            self._warned_at_m = away
            _log.warning(
                "Camera %s stands %.0f mm beside its calibration (+- %.0f mm); its clouds are corrected. "
                "To store it: adamanip calibrate --on-robot --record robot.json --out FILE",
                *(self._calibration.camera, 1e3 * away, 1e3 * self.estimate.uncertainty_m),
            )
        return is_seen

    def corrected(self) -> CameraCalibration:
        """Returns the calibration with the corrected pose."""
        return replace(self._calibration, depth_in_base=self.estimate.correction @ self._pose)


def calibrate_on_hand(robot: Any, key: str, ask: Callable[[], bool], tell: Callable[[str], None]) -> CameraOnHand:
    """Returns a camera's calibration from poses of the hand that the user guides, while ``ask`` returns True.

    Args:
        robot: connected robot with a calibration of the camera.
        key: key of the camera.
        ask: waits for the next pose; False ends.
        tell: gets one line per picture.

    Raises:
        ConfigurationError: the camera is not calibrated roughly, is on the hand, or fewer than `MIN_POSES` poses of
            the hand were seen.
    """
    known = robot.session.calibrations.get(key)
    if known is None or known.depth_in_base is None:
        raise ConfigurationError(
            f"Camera {key} cannot be calibrated on the hand.",
            got="no calibration" if known is None else "a camera on the hand",
            allowed="a camera beside the robot, with a calibration within 30 mm and 3 degrees",
            hint="adamanip calibrate views --record robot.json --out FILE, with a board",
        )
    on_hand, camera = CameraOnHand(known), camera_of(robot, key)
    if not camera.use_depth:
        what, hint = f"The camera {key} takes no depth.", '"use_depth": true in the robot\'s file'
        raise ConfigurationError(what, got="use_depth=false", allowed="use_depth=true", hint=hint)
    while ask():
        try:
            observe_after_guiding(robot)
            depth = camera.frame_after(time.perf_counter(), PICTURE_S).depth
        except RobotError as error:
            tell(str(error))
            continue
        if depth is None or not on_hand.update(depth, robot.session.reading):
            tell("no hand at rest is seen: picture not used")
            continue
        estimate = on_hand.estimate
        away, spread = 1e3 * estimate.moved_by_m, 1e3 * estimate.uncertainty_m
        tell(f"{estimate.frames} poses; the camera is off by {away:.1f} mm (+- {spread:.1f} mm)")
    if on_hand.estimate.frames < MIN_POSES:
        raise ConfigurationError(
            "Too few poses of the hand.",
            got=on_hand.estimate.frames,
            allowed=f"at least {MIN_POSES}, 2 cm or 6 degrees apart; 8 are better",
            hint="move the hand through the workspace, its side to the camera",
        )
    return on_hand
