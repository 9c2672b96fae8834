"""Gamepad, SpaceMouse and keyboard. LeRobot looks for their classes in this module, next to `config_devices`.

The SDK of a device is imported when the device is opened.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from lerobot_adamanip.contract.rotations import Array
from lerobot_adamanip.hardware.teleoperators.config_devices import (
    AdamanipGamepadConfig,
    AdamanipKeyboardConfig,
    AdamanipSpacemouseConfig,
)
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import Jog, JogTeleop, dead_zone
from lerobot_adamanip.util.errors import RobotError

SHIFTS = {"w": (0, 1.0), "s": (0, -1.0), "a": (1, 1.0), "d": (1, -1.0), "u": (2, 1.0), "j": (2, -1.0)}
"""Key -> axis of the base frame (x forward, y left, z up) and direction. LeRobot's commands use none of these keys."""
TURNS = {"o": (0, 1.0), "l": (0, -1.0), "i": (1, 1.0), "k": (1, -1.0), "f": (2, 1.0), "h": (2, -1.0)}
"""Key -> rotation axis of the base frame and direction."""
GRIPPER, SUCCESS, RESET = "g", "y", "backspace"
"""Keys that are reported once per press."""
MAX_REPORTS = 64
"""Maximum SpaceMouse reports per read. Each has a part of the state, and they queue up between two calls."""
REST_AFTER_S, LOST_AFTER_S = 0.2, 1.0
"""Time without a report after which a deflected SpaceMouse counts as at rest, then as lost [s]."""


class AdamanipGamepad(JogTeleop):
    """Drives the tool while the right shoulder button is held. Uses pygame, which needs no window.

    Left stick: plane. Right stick: up, down and turn about the vertical. Cross: the other two turns.
    """

    config_class = AdamanipGamepadConfig
    name = "adamanip_gamepad"
    config: AdamanipGamepadConfig
    _pygame: Any = None
    _pad: Any = None

    def _open(self) -> None:
        try:
            import pygame
        except ImportError as error:
            raise RobotError(
                "The gamepad needs pygame.", got=error, allowed="pygame", hint="pip install 'lerobot[gamepad]'"
            ) from None
        self._pygame = pygame
        pygame.init()
        pygame.joystick.init()
        count = pygame.joystick.get_count()
        if count <= self.config.index:
            raise RobotError(
                "There is no such gamepad.", got=f"index {self.config.index}", allowed=f"{count} connected"
            )
        self._pad = pygame.joystick.Joystick(self.config.index)
        self._pad.init()
        self._down: set[int] = set()

    def _read(self) -> Jog:
        pad, config = self._pad, self.config
        removed = self._pygame.event.get(self._pygame.JOYDEVICEREMOVED)
        if any(event.instance_id == pad.get_instance_id() for event in removed):
            raise RobotError("The gamepad is gone.", got="unplugged, or no link", allowed="a pad", hint="plug it in")
        axes = (config.axis_left_x, config.axis_left_y, config.axis_right_x, config.axis_right_y)
        deflections = np.array([pad.get_axis(axis) for axis in axes], np.float64)
        left_x, left_y, right_x, right_y = dead_zone(deflections, config.dead_zone)
        across, along = pad.get_hat(0) if pad.get_numhats() else (0, 0)
        down = {button for button in range(pad.get_numbuttons()) if pad.get_button(button)}
        new, self._down = down - self._down, down
        return Jog(
            shift=np.array([-left_y, -left_x, -right_y]),
            turn=np.array([float(across), float(along), -right_x]),
            toggle=config.button_gripper in new,
            clutch=config.button_clutch in down,
            success=config.button_success in new,
            reset=config.button_reset in new,
        )

    def _close(self) -> None:
        if self._pygame is not None:
            self._pygame.quit()
            self._pygame = self._pad = None


class AdamanipSpacemouse(JogTeleop):
    """Drives the tool by the cap's deflection, without a clutch. Left button: gripper; right button: success."""

    config_class = AdamanipSpacemouseConfig
    name = "adamanip_spacemouse"
    config: AdamanipSpacemouseConfig
    _device: Any = None

    def _open(self) -> None:
        try:
            import pyspacemouse
        except (ImportError, OSError) as error:  # OSError: the system's hidapi is missing
            raise RobotError(
                "The SpaceMouse needs pyspacemouse and the system's hidapi.",
                got=error,
                allowed="pyspacemouse >= 2.1",
                hint="pip install pyspacemouse; on Debian apt install libhidapi-hidraw0, and a udev rule",
            ) from None
        try:
            # the default convention is deprecated and not right-handed
            convention = pyspacemouse.AxisConvention.ROS
            self._device = pyspacemouse.open(device_index=self.config.device_index, axis_convention=convention)
        except (RuntimeError, OSError, ValueError) as error:
            raise RobotError(
                "No SpaceMouse could be opened.",
                got=error,
                allowed=f"a device of index {self.config.device_index}",
                hint="is it plugged in, and may this user read it (udev rule)?",
            ) from None
        self._down: set[int] = set()
        self._report, self._reported_at = -1.0, self._clock()

    def _read(self) -> Jog:
        state = self._newest()
        axes = np.array((state.x, state.y, state.z, state.roll, state.pitch, state.yaw), np.float64)
        values = dead_zone(axes, self.config.dead_zone)
        if self._is_stale(state.t, driving=bool(values.any())):
            values = np.zeros(6)
        down = {number for number, held in enumerate(state.buttons) if held}
        new, self._down = down - self._down, down
        turn = values[3:] if self.config.rotation else np.zeros(3)
        return Jog(shift=values[:3], turn=turn, toggle=0 in new, success=1 in new)

    def _newest(self) -> Any:
        """Returns the state after all queued reports. Without any, the library repeats its last state."""
        try:
            state, stamp = self._device.read(), None
            for _ in range(MAX_REPORTS):
                if state.t == stamp:
                    break
                stamp = state.t
                state = self._device.read()
        except Exception as error:  # depends on the hidapi binding
            raise RobotError(
                "The SpaceMouse cannot be read any more.", got=error, allowed="a connected device", hint="plug it in"
            ) from None
        return state

    def _is_stale(self, report: float, *, driving: bool) -> bool:
        """Returns whether a deflected cap has sent no report for `REST_AFTER_S`. A deflected cap reports constantly.

        Raises:
            RobotError: the cap has sent no report for `LOST_AFTER_S`.
        """
        now = self._clock()
        if report != self._report or not driving:
            self._report, self._reported_at = report, now
        age = now - self._reported_at
        if age > LOST_AFTER_S:
            raise RobotError(
                "The SpaceMouse does not report any more, and its last report requests a motion.",
                got=f"no report for {age:.1f} s",
                allowed=f"{LOST_AFTER_S:g} s",
                hint="check its cable, battery or connection, and start the command again",
            )
        return age > REST_AFTER_S

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()


class AdamanipKeyboard(JogTeleop):
    """Drives the tool while the clutch key and other keys are held. pynput listens in its own thread."""

    config_class = AdamanipKeyboardConfig
    name = "adamanip_keyboard"
    config: AdamanipKeyboardConfig
    _listener: Any = None

    def _open(self) -> None:
        self._lock = threading.Lock()
        self._held: set[str] = set()
        self._pressed: set[str] = set()
        self._listener = self._listen()

    def _listen(self) -> Any:
        try:
            from pynput import keyboard
        except Exception as error:  # pynput raises various types without a display
            raise RobotError(
                "The keyboard cannot be read.",
                got=f"{type(error).__name__}: {error}",
                allowed="pynput with an X11 display",
                hint="a gamepad or a SpaceMouse works without a display",
            ) from None
        listener = keyboard.Listener(
            on_press=lambda key: self.press(_name(key)), on_release=lambda key: self.release(_name(key))
        )
        listener.start()
        return listener

    def press(self, key: str) -> None:
        """Handles a key press or repeat."""
        with self._lock:
            if key not in self._held and self.config.clutch_key in self._held:
                self._pressed.add(key)
            self._held.add(key)

    def release(self, key: str) -> None:
        """Handles a key release."""
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
            held, pressed, self._pressed = set(self._held), self._pressed, set()
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
