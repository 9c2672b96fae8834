"""Options of the teleoperators."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.util.errors import require_choice, shown_by_parsers

CLUTCH_KEYS = ("shift_r", "shift", "menu", "insert")
"""pynput's names. Control and Alt would send shortcuts to the window that has the focus."""


@dataclass(kw_only=True)
class TcpTeleopConfig(TeleoperatorConfig):
    """Options that all teleoperators of a tool pose share."""

    robot_id: str | None = None
    """Id of the robot it drives (``--robot.id``); left out, the only robot of the command."""

    speed: float = 0.10
    """At full deflection [m/s]; the robot's own limit comes on top."""

    angular_speed: float = 0.4
    """Likewise [rad/s]."""


@TeleoperatorConfig.register_subclass("adamanip_keyboard")
@dataclass(kw_only=True)
class AdamanipKeyboardConfig(TcpTeleopConfig):
    """Keys that are held, by pynput: X11, macOS and Windows, not Wayland or a remote shell.

    Keys are heard in every window: they count only while the clutch key is held.
    """

    clutch_key: str = "shift_r"
    """Key that has to be held for any other to count: shift_r (right shift), shift (left), menu or insert."""

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for another clutch key."""
        with shown_by_parsers():
            require_choice("clutch key", self.clutch_key, CLUTCH_KEYS, hint="--teleop.clutch_key=shift_r")


@TeleoperatorConfig.register_subclass("adamanip_gamepad")
@dataclass(kw_only=True)
class AdamanipGamepadConfig(TcpTeleopConfig):
    """A gamepad by pygame; numbers of axes and buttons are those of an Xbox pad under Linux."""

    index: int = 0
    """Which pad, where there are several."""

    dead_zone: float = 0.12
    """A stick that is deflected by less is at rest."""

    axis_left_x: int = 0
    """Left stick to the right: to the robot's right (-y)."""
    axis_left_y: int = 1
    """Left stick back: towards the robot (-x)."""
    axis_right_x: int = 3
    """Right stick to the right: turn about the vertical axis."""
    axis_right_y: int = 4
    """Right stick back: down (-z)."""

    button_gripper: int = 0
    """A: toggle the gripper."""
    button_success: int = 3
    """Y: the task is done."""
    button_reset: int = 6
    """Back: reset a twin's scene."""
    button_clutch: int = 5
    """Right shoulder: the pad drives while it is held."""


@TeleoperatorConfig.register_subclass("adamanip_spacemouse")
@dataclass(kw_only=True)
class AdamanipSpacemouseConfig(TcpTeleopConfig):
    """A 3D mouse by pyspacemouse, axes as ROS has them: x forward, y left, z up."""

    device_index: int = 0
    """Which one, where there are several."""

    dead_zone: float = 0.08
    """A cap that is deflected by less is at rest."""

    rotation: bool = True
    """Whether the cap turns the tool as well."""
