"""Keyboard, with keys that LeRobot's commands leave free."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lerobot_adamanip.hardware.teleoperators.config_devices import AdamanipKeyboardConfig
from lerobot_adamanip.hardware.teleoperators.jog import Array, Jog, JogTeleop
from lerobot_adamanip.util.errors import RobotError

SHIFTS = {"w": (0, 1.0), "s": (0, -1.0), "a": (1, 1.0), "d": (1, -1.0), "u": (2, 1.0), "j": (2, -1.0)}
"""Key -> axis of the base frame (x forward, y left, z up) and direction."""
TURNS = {"o": (0, 1.0), "l": (0, -1.0), "i": (1, 1.0), "k": (1, -1.0), "f": (2, 1.0), "h": (2, -1.0)}
"""Key -> axis of the base frame to turn about, and direction."""
GRIPPER, SUCCESS, RESET = "g", "y", "backspace"
"""Keys that are reported once each time they are pressed."""


class AdamanipKeyboard(JogTeleop):
    """Drives the tool while keys, and the clutch key, are held; pynput listens in a thread of its own."""

    config_class = AdamanipKeyboardConfig
    name = "adamanip_keyboard"
    config: AdamanipKeyboardConfig

    def __init__(self, config: AdamanipKeyboardConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config, clock)
        self._lock = threading.Lock()
        self._held: set[str] = set()
        self._pressed: set[str] = set()
        self._listener: Any = None

    def _open(self) -> None:
        try:
            from pynput import keyboard
        except Exception as error:  # pynput fails in its own ways where there is no display
            raise RobotError(
                "The keyboard cannot be listened to.",
                got=f"{type(error).__name__}: {error}",
                allowed="pynput with an X11 display",
                hint="a gamepad or a SpaceMouse works without a display",
            ) from None
        self._held, self._pressed = set(), set()
        self._listener = keyboard.Listener(
            on_press=lambda key: self.press(_name(key)), on_release=lambda key: self.release(_name(key))
        )
        self._listener.start()

    def press(self, key: str) -> None:
        """Handles a key that goes down, or repeats."""
        with self._lock:
            if key not in self._held and self.config.clutch_key in self._held:
                self._pressed.add(key)
            self._held.add(key)

    def release(self, key: str) -> None:
        """Handles a key that goes up."""
        with self._lock:
            self._held.discard(key)

    def _read(self) -> Jog:
        if self._listener is not None and not self._listener.is_alive():
            raise RobotError(
                "The keyboard is not listened to any more.",
                got="pynput's thread has ended",
                allowed="an X11 display that stays",
                hint="start the command again",
            )
        with self._lock:
            held, pressed = set(self._held), self._pressed
            self._pressed = set()
        return Jog(
            shift=_sum(SHIFTS, held),
            turn=_sum(TURNS, held),
            toggle=GRIPPER in pressed,
            clutch=self.config.clutch_key in held,
            success=SUCCESS in pressed,
            reset=RESET in pressed,
        )

    def _close(self) -> None:
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.stop()


def _sum(keys: dict[str, tuple[int, float]], held: set[str]) -> Array:
    total = np.zeros(3)
    for key in held & keys.keys():
        axis, direction = keys[key]
        total[axis] += direction
    return total


def _name(key: Any) -> str:
    letter = getattr(key, "char", None)
    return str(letter).lower() if letter else str(getattr(key, "name", key))
