"""Options of a RealSense camera. Not LeRobot's class, whose import loads OpenCV and the SDK."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig


@CameraConfig.register_subclass("adamanip_realsense")
@dataclass(kw_only=True)
class AdamanipRealsenseConfig(CameraConfig):
    """A RealSense camera with depth in millimetres for every model, timestamps and intrinsics.

    As for LeRobot's ``intelrealsense``, set all of ``fps``, ``width`` and ``height`` or none. Pictures are not
    rotated, since the intrinsics belong to the unrotated picture.
    """

    serial_number_or_name: str
    """Serial number or name of the camera. `lerobot-find-cameras realsense` lists them."""

    use_rgb: bool = True
    """Whether frames have colour."""

    use_depth: bool = True
    """Whether frames have depth."""

    warmup_s: int = 1
    """Time to drop frames after connecting [s], so that the exposure settles."""

    exposure: int | None = None
    """Fixed exposure of the colour imager; automatic by default."""

    gain: int | None = None
    """Fixed gain of the colour imager; automatic by default."""

    white_balance: int | None = None
    """Fixed white balance of the colour imager; automatic by default."""
