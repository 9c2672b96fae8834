"""Options of the keyboard."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.hardware.teleoperators.config_tcp_teleop import TcpTeleopConfig
from lerobot_adamanip.util.errors import require_choice, shown_by_parsers

CLUTCH_KEYS = ("shift_r", "shift", "menu", "insert")
"""Names of pynput. Control and Alt would send shortcuts to the window that has the focus."""


@TeleoperatorConfig.register_subclass("adamanip_keyboard")
@dataclass(kw_only=True)
class AdamanipKeyboardConfig(TcpTeleopConfig):
    """Keys that are held, by pynput: X11, macOS and Windows; neither Wayland nor a remote shell tells them.

    Keys are heard in every window: they count only while the clutch key is held.
    """

    clutch_key: str = "shift_r"
    """Key that has to be held for any other to count: shift_r (right shift), shift (left), menu or insert."""

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for a key that is none of these."""
        with shown_by_parsers():
            require_choice("clutch key", self.clutch_key, CLUTCH_KEYS, hint="--teleop.clutch_key=shift_r")
