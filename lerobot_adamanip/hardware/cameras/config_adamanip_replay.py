"""Options of the camera that plays a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lerobot.cameras.configs import CameraConfig


@CameraConfig.register_subclass("adamanip_replay")
@dataclass(kw_only=True)
class AdamanipReplayConfig(CameraConfig):
    """Plays a folder that `lerobot_adamanip.hardware.cameras.recording` wrote, at the rate it was taken at.

    ``fps``, ``width`` and ``height`` are the recording's; others are refused.
    """

    path: Path
    """Folder of the recording."""

    use_rgb: bool = True
    """Whether frames have colour; the recording has to have it."""

    use_depth: bool = True
    """Whether frames have depth; the recording has to have it."""

    loop: bool = True
    """Begin again after the last frame; otherwise the camera freezes then, as one whose cable was pulled."""
