"""Options of the SpaceMouse."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.hardware.teleoperators.config_tcp_teleop import TcpTeleopConfig


@TeleoperatorConfig.register_subclass("adamanip_spacemouse")
@dataclass(kw_only=True)
class AdamanipSpacemouseConfig(TcpTeleopConfig):
    """A 3D mouse by pyspacemouse, axes as ROS has them: x forward, y left, z up."""

    device_index: int = 0
    """Which one, where there are several."""

    dead_zone: float = 0.08
    """A cap that is deflected by less rests."""

    rotation: bool = True
    """Whether the cap turns the tool as well."""
