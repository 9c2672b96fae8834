"""SpaceMouse: the tool goes where its cap is pushed and turned; left button for the gripper, right for success."""

from __future__ import annotations

from typing import Any

import numpy as np

from lerobot_adamanip.hardware.teleoperators.config_devices import AdamanipSpacemouseConfig
from lerobot_adamanip.hardware.teleoperators.jog import Jog, JogTeleop, dead_zone
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import StaleInputWatch
from lerobot_adamanip.util.errors import RobotError

MAX_REPORTS = 64
"""Reports taken at once: each has a part of the state, and they queue up between two calls."""


class AdamanipSpacemouse(JogTeleop):
    """Drives the tool by the cap's deflection; there is no clutch, a cap at rest moves nothing."""

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
            # The default convention is deprecated and not right-handed.
            convention = pyspacemouse.AxisConvention.ROS
            self._device = pyspacemouse.open(device_index=self.config.device_index, axis_convention=convention)
        except (RuntimeError, OSError, ValueError) as error:
            raise RobotError(
                "No SpaceMouse could be opened.",
                got=error,
                allowed=f"a device of index {self.config.device_index}",
                hint="is it plugged in, and may this user read it (udev rule)?",
            ) from None
        self._buttons: list[bool] = []
        self._watch = StaleInputWatch("SpaceMouse", self._clock)

    def _read(self) -> Jog:
        state = self._newest()
        axes = (state.x, state.y, state.z, state.roll, state.pitch, state.yaw)
        values = dead_zone(np.array(axes, np.float64), self.config.dead_zone)
        if self._watch.is_stale(state.t, driving=bool(values.any())):  # a deflected cap reports all the time
            values = np.zeros(6)
        down = [bool(button) for button in state.buttons]
        before = self._buttons or [False] * len(down)
        new = [now and not was for now, was in zip(down, before, strict=True)]
        self._buttons = down
        return Jog(
            shift=values[:3],
            turn=values[3:] if self.config.rotation else np.zeros(3),
            toggle=bool(new and new[0]),
            success=len(new) > 1 and new[1],
        )

    def _newest(self) -> Any:
        """Returns the state after all queued reports; without any, the library repeats its last state."""
        try:
            state, told = self._device.read(), None
            for _ in range(MAX_REPORTS):
                if state.t == told:
                    break
                told = state.t
                state = self._device.read()
        except Exception as error:  # of hidapi, by whichever binding
            raise RobotError(
                "The SpaceMouse cannot be read any more.", got=error, allowed="a connected device", hint="plug it in"
            ) from None
        return state

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()
