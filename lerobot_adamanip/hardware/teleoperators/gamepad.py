"""Gamepad: left stick in the plane, right stick up and about the vertical, cross for the other two turns."""

from __future__ import annotations

from typing import Any

import numpy as np

from lerobot_adamanip.hardware.teleoperators.config_devices import AdamanipGamepadConfig
from lerobot_adamanip.hardware.teleoperators.jog import Jog, JogTeleop, dead_zone
from lerobot_adamanip.util.errors import RobotError


class AdamanipGamepad(JogTeleop):
    """Drives the tool while the right shoulder button is held; by pygame, which needs no window."""

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
        pygame.init()
        pygame.joystick.init()
        found = pygame.joystick.get_count()
        if found <= self.config.index:
            pygame.quit()
            raise RobotError(
                "There is no such gamepad.", got=f"index {self.config.index}", allowed=f"{found} connected"
            )
        self._pygame, self._pad = pygame, pygame.joystick.Joystick(self.config.index)
        self._pad.init()
        self._pressed: set[int] = set()

    def _read(self) -> Jog:
        pad, config = self._pad, self.config
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

    def _close(self) -> None:
        if self._pygame is not None:
            self._pygame.quit()
            self._pygame = self._pad = None
