"""Options of a RealSense camera. Not LeRobot's class: to import that one loads OpenCV, and the SDK if there is one."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig


@CameraConfig.register_subclass("adamanip_realsense")
@dataclass(kw_only=True)
class AdamanipRealsenseConfig(CameraConfig):
    """A RealSense camera whose depth is in millimetres whatever the model, with stamps and intrinsics.

    As LeRobot's ``intelrealsense``: of ``fps``, ``width`` and ``height`` all are given or none. Pictures are not
    rotated, since intrinsics belong to them as they are taken.
    """

    serial_number_or_name: str
    """Of the camera; `lerobot-find-cameras realsense` lists them."""

    use_rgb: bool = True
    """Whether frames have colour."""

    use_depth: bool = True
    """Whether frames have depth."""

    warmup_s: int = 1
    """Frames are taken and dropped for so long after connecting [s], so that the exposure settles."""

    exposure: int | None = None
    """Fixed exposure of the colour imager; automatic if not given."""

    gain: int | None = None
    """Likewise."""

    white_balance: int | None = None
    """Likewise."""
