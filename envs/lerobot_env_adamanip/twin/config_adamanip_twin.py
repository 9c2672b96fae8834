"""Options of the twin's camera."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig


@CameraConfig.register_subclass("adamanip_twin")
@dataclass(kw_only=True)
class AdamanipTwinConfig(CameraConfig):
    """The front camera of the twin's scene, colour and depth of one moment. Its size is the robot's to say.

    ``fps`` is how often it looks where time passes by itself (default 10: a picture takes some 50 ms of a processor);
    in lockstep it looks once per observation. ``width`` and ``height`` are the twin's; others are refused.
    """

    use_rgb: bool = True
    """Whether frames have colour."""

    use_depth: bool = True
    """Whether frames have depth."""
