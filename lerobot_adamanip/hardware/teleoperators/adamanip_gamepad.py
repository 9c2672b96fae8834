"""A gamepad: left stick in the plane, right stick up and about the vertical, cross for the other two turns."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lerobot_adamanip.hardware.teleoperators.config_adamanip_gamepad import AdamanipGamepadConfig
from lerobot_adamanip.hardware.teleoperators.jog import Jog, dead_zone
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import JogTeleop
from lerobot_adamanip.util.errors import RobotError


class GamepadDevice:
    """Reads a pad with pygame, which needs no window. Implements `JogDevice`."""

    def __init__(self, config: AdamanipGamepadConfig) -> None:
        self._config = config
        self._pygame: Any = None
        self._pad: Any = None
        self._pressed: set[int] = set()

    def open(self) -> None:
        """Raises `RobotError` without pygame or a pad."""
        try:
            import pygame
        except ImportError as error:
            raise RobotError(
                "The gamepad needs pygame.", got=error, allowed="pygame", hint="pip install 'lerobot[gamepad]'"
            ) from None
        pygame.init()
        pygame.joystick.init()
        found = pygame.joystick.get_count()
        if found <= self._config.index:
            pygame.quit()
            raise RobotError(
                "There is no such gamepad.", got=f"index {self._config.index}", allowed=f"{found} connected"
            )
        self._pygame, self._pad = pygame, pygame.joystick.Joystick(self._config.index)
        self._pad.init()
        self._pressed = set()

    def read(self) -> Jog:
        """Returns what sticks and buttons say now. Raises `RobotError` for a pad that was unplugged."""
        pad, config = self._pad, self._config
        removed = self._pygame.event.get(self._pygame.JOYDEVICEREMOVED)
        if any(event.instance_id == pad.get_instance_id() for event in removed):
            raise RobotError(
                "The gamepad is gone.",
                got="unplugged, or its link is lost",
                allowed="a connected pad",
                hint="plug it in",
            )
        axes = (config.axis_left_x, config.axis_left_y, config.axis_right_x, config.axis_right_y)
        left_x, left_y, right_x, right_y = dead_zone(
            np.array([pad.get_axis(axis) for axis in axes], np.float64), config.dead_zone
        )
        across, along = pad.get_hat(0) if pad.get_numhats() else (0, 0)
        down = {button for button in range(pad.get_numbuttons()) if pad.get_button(button)}
        new, self._pressed = down - self._pressed, down
        return Jog(
            shift=np.array([-left_y, -left_x, -right_y]),
            turn=np.array([float(across), float(along), -right_x]),
            toggle=config.button_gripper in new,
            clutch=config.button_clutch in down,
            success=config.button_success in new,
            reset=config.button_reset in new,
        )

    def close(self) -> None:
        """Gives the pad back; idempotent."""
        if self._pygame is not None:
            self._pygame.quit()
            self._pygame = self._pad = None


class AdamanipGamepad(JogTeleop):
    """Drives the tool while the right shoulder button is held."""

    config_class = AdamanipGamepadConfig
    name = "adamanip_gamepad"

    def __init__(self, config: AdamanipGamepadConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config, GamepadDevice(config), clock)
