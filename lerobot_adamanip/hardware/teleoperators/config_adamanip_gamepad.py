"""Options of the gamepad."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.hardware.teleoperators.config_tcp_teleop import TcpTeleopConfig


@TeleoperatorConfig.register_subclass("adamanip_gamepad")
@dataclass(kw_only=True)
class AdamanipGamepadConfig(TcpTeleopConfig):
    """A gamepad by pygame; numbers of axes and buttons are those of an Xbox pad under Linux."""

    index: int = 0
    """Which pad, where there are several."""

    dead_zone: float = 0.12
    """A stick that is deflected by less rests."""

    axis_left_x: int = 0
    """Left stick to the right: to the robot's right (-y)."""
    axis_left_y: int = 1
    """Left stick back: towards the robot (-x)."""
    axis_right_x: int = 3
    """Right stick to the right: turn about the vertical axis."""
    axis_right_y: int = 4
    """Right stick back: down (-z)."""

    button_gripper: int = 0
    """A: gripper the other way round."""
    button_success: int = 3
    """Y: the task is done."""
    button_reset: int = 6
    """Back: a twin's scene anew."""
    button_clutch: int = 5
    """Right shoulder: drives while it is held."""
