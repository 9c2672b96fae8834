"""Options of the teleoperators."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.util.errors import require_choice, shown_by_parsers

CLUTCH_KEYS = ("shift_r", "shift", "menu", "insert")
"""Clutch keys by pynput name. Control and Alt are excluded: they would send shortcuts to the focused window."""


@dataclass(kw_only=True)
class TcpTeleopConfig(TeleoperatorConfig):
    """Options that all teleoperators of a tool pose share."""

    robot_id: str | None = None
    """Id of the robot to drive (``--robot.id``). Default: the only robot of the command."""

    speed: float = 0.10
    """Speed at full deflection [m/s]. The robot's own limit also applies."""

    angular_speed: float = 0.4
    """Angular speed at full deflection [rad/s]. The robot's own limit also applies."""


@TeleoperatorConfig.register_subclass("adamanip_keyboard")
@dataclass(kw_only=True)
class AdamanipKeyboardConfig(TcpTeleopConfig):
    """Keyboard control with pynput: works on X11, macOS and Windows, not on Wayland or in a remote shell.

    pynput sees keys in every window. They count only while the clutch key is held.
    """

    clutch_key: str = "shift_r"
    """Key to hold while driving: shift_r (right shift), shift (left), menu or insert."""

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for another clutch key."""
        with shown_by_parsers():
            require_choice("clutch key", self.clutch_key, CLUTCH_KEYS, hint="--teleop.clutch_key=shift_r")


@TeleoperatorConfig.register_subclass("adamanip_gamepad")
@dataclass(kw_only=True)
class AdamanipGamepadConfig(TcpTeleopConfig):
    """A gamepad, read with pygame. Default axis and button numbers fit an Xbox pad under Linux."""

    index: int = 0
    """Index of the pad, if several are connected."""

    dead_zone: float = 0.12
    """Stick deflection that counts as rest, 0 ... 1."""

    axis_left_x: int = 0
    """Axis of the left stick, right: moves to the robot's right (-y)."""
    axis_left_y: int = 1
    """Axis of the left stick, back: moves towards the robot (-x)."""
    axis_right_x: int = 3
    """Axis of the right stick, right: turns about the vertical axis."""
    axis_right_y: int = 4
    """Axis of the right stick, back: moves down (-z)."""

    button_gripper: int = 0
    """Button A: toggles the gripper."""
    button_success: int = 3
    """Button Y: marks the task as done."""
    button_reset: int = 6
    """Button Back: resets a twin's scene."""
    button_clutch: int = 5
    """Right shoulder button: hold it to drive."""


@TeleoperatorConfig.register_subclass("adamanip_spacemouse")
@dataclass(kw_only=True)
class AdamanipSpacemouseConfig(TcpTeleopConfig):
    """A 3D mouse, read with pyspacemouse. Axes as in ROS: x forward, y left, z up."""

    device_index: int = 0
    """Index of the device, if several are connected."""

    dead_zone: float = 0.08
    """Cap deflection that counts as rest, 0 ... 1."""

    rotation: bool = True
    """Whether the cap also turns the tool."""
