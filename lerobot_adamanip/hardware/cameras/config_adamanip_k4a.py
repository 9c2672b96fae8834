"""Options of an Azure Kinect."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig

DEPTH_MODES = {"nfov_2x2binned": 1, "nfov_unbinned": 2, "wfov_2x2binned": 3, "wfov_unbinned": 4}
COLOR_RESOLUTIONS = {"720p": 1, "1080p": 2, "1440p": 3, "1536p": 4, "2160p": 5, "3072p": 6}
RATES = {5: 0, 15: 1, 30: 2}


@CameraConfig.register_subclass("adamanip_k4a")
@dataclass(kw_only=True)
class AdamanipK4aConfig(CameraConfig):
    """An Azure Kinect: depth as its time-of-flight imager takes it, not warped into the colour picture.

    ``width`` and ``height`` follow from ``depth_mode``, colour has a size of its own; ``fps`` is 5, 15 or 30.
    """

    serial_number: str = ""
    """Of the camera; the first one if not given."""

    depth_mode: str = "nfov_unbinned"
    """``nfov_unbinned`` (640 x 576), ``nfov_2x2binned`` (320 x 288), ``wfov_2x2binned`` (512 x 512), ``wfov_unbinned``
    (1024 x 1024, at most 15 Hz)."""

    color_resolution: str = "720p"
    """``720p``, ``1080p``, ``1440p``, ``1536p``, ``2160p`` or ``3072p``."""

    use_rgb: bool = True
    """Whether frames have colour."""
