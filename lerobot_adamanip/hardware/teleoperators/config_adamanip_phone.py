"""Options of the phone."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.hardware.teleoperators.config_tcp_teleop import TcpTeleopConfig


@TeleoperatorConfig.register_subclass("adamanip_phone")
@dataclass(kw_only=True)
class AdamanipPhoneConfig(TcpTeleopConfig):
    """A phone that is moved about, by LeRobot's own phone teleoperator (extra ``lerobot[phone]``)."""

    phone_os: str = "ios"
    """``ios`` (HEBI's app) or ``android`` (a page in its browser)."""

    scale: float = 0.5
    """Of the phone's way that the tool goes."""
