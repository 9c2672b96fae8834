"""A SpaceMouse: the tool goes where its cap is pushed and turned; left button for the gripper, right for success."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lerobot_adamanip.hardware.teleoperators.config_adamanip_spacemouse import AdamanipSpacemouseConfig
from lerobot_adamanip.hardware.teleoperators.jog import Jog, dead_zone
from lerobot_adamanip.hardware.teleoperators.stale_input import SilenceWatch
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import JogTeleop
from lerobot_adamanip.util.errors import RobotError

MOST_REPORTS = 64
"""Taken at once at most: a report tells a part of the state, and they queue up between two calls."""


class SpacemouseDevice:
    """Reads a SpaceMouse without waiting. Implements `JogDevice`."""

    def __init__(self, config: AdamanipSpacemouseConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        self._config, self._clock = config, clock
        self._watch = SilenceWatch("SpaceMouse", clock)
        self._device: Any = None
        self._buttons: list[bool] = []

    def open(self) -> None:
        """Raises `RobotError` without pyspacemouse, hidapi or a device."""
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
            # The default convention is deprecated and not right-handed.
            convention = pyspacemouse.AxisConvention.ROS
            self._device = pyspacemouse.open(device_index=self._config.device_index, axis_convention=convention)
        except (RuntimeError, OSError, ValueError) as error:
            raise RobotError(
                "No SpaceMouse could be opened.",
                got=error,
                allowed=f"a device of index {self._config.device_index}",
                hint="is it plugged in, and may this user read it (udev rule)?",
            ) from None
        self._buttons, self._watch = [], SilenceWatch("SpaceMouse", self._clock)

    def read(self) -> Jog:
        """Returns what cap and buttons say now. A deflected cap reports all the time: one that is silent rests.

        Raises:
            RobotError: the device is gone, or has been silent for long.
        """
        state = self._newest()
        axes = (state.x, state.y, state.z, state.roll, state.pitch, state.yaw)
        values = dead_zone(np.array(axes, np.float64), self._config.dead_zone)
        if self._watch.is_silent(state.t, driving=bool(values.any())):
            values = np.zeros(6)
        down = [bool(button) for button in state.buttons]
        before = self._buttons or [False] * len(down)
        new = [now and not was for now, was in zip(down, before, strict=True)]
        self._buttons = down
        return Jog(
            shift=values[:3],
            turn=values[3:] if self._config.rotation else np.zeros(3),
            toggle=bool(new and new[0]),
            success=len(new) > 1 and new[1],
        )

    def _newest(self) -> Any:
        """The state after all reports that wait; the library tells its last state again if none does."""
        try:
            state, told = self._device.read(), None
            for _ in range(MOST_REPORTS):
                if state.t == told:
                    break
                told = state.t
                state = self._device.read()
        except Exception as error:  # of hidapi, by whichever binding
            raise RobotError(
                "The SpaceMouse cannot be read any more.", got=error, allowed="a connected device", hint="plug it in"
            ) from None
        return state

    def close(self) -> None:
        """Gives the device back; idempotent."""
        device, self._device = self._device, None
        if device is not None:
            device.close()


class AdamanipSpacemouse(JogTeleop):
    """Drives the tool by the cap's deflection; there is no clutch, a cap that rests moves nothing."""

    config_class = AdamanipSpacemouseConfig
    name = "adamanip_spacemouse"

    def __init__(self, config: AdamanipSpacemouseConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config, SpacemouseDevice(config, clock), clock)
