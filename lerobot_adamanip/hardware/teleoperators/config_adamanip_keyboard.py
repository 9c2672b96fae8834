"""Options of the keyboard."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.hardware.teleoperators.config_tcp_teleop import TcpTeleopConfig


@TeleoperatorConfig.register_subclass("adamanip_keyboard")
@dataclass(kw_only=True)
class AdamanipKeyboardConfig(TcpTeleopConfig):
    """Keys that are held, by pynput: X11, macOS and Windows; neither Wayland nor a remote shell tells them."""
