"""Phone: the tool follows its motion while its button is held. LeRobot's phone teleoperator reports where it is."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import (
    matrix_from_rotation_vector,
    pose_from_vector,
    pose_vector,
    rotation_vector_from_matrix,
)
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.robot_registry import RobotSession
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.hardware.teleoperators.config_devices import AdamanipPhoneConfig
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import StaleInputWatch, TcpTeleop
from lerobot_adamanip.util.errors import RobotError, require_choice


class AdamanipPhone(TcpTeleop):
    """Moves the goal by the phone's motion since the last call, scaled, while it is enabled."""

    config_class = AdamanipPhoneConfig
    name = "adamanip_phone"
    config: AdamanipPhoneConfig

    def __init__(self, config: AdamanipPhoneConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config, clock)
        self._phone: Any = None
        self._restart()

    def _restart(self) -> None:
        """Forgets where the phone was: the next pose moves nothing."""
        self._last: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._watch = StaleInputWatch("phone", self._clock)

    def _make_phone(self) -> Any:
        try:
            from lerobot.teleoperators.phone.config_phone import PhoneConfig, PhoneOS
            from lerobot.teleoperators.phone.teleop_phone import Phone

            systems = [each.value for each in PhoneOS]
            require_choice("phone", self.config.phone_os, systems, hint="--teleop.phone_os=android")
            return Phone(PhoneConfig(phone_os=PhoneOS(self.config.phone_os)))
        except ImportError as error:
            raise RobotError(
                "The phone needs LeRobot's packages for it.",
                got=error,
                allowed="hebi-py and teleop",
                hint="pip install 'lerobot[phone]'",
            ) from None

    def _open(self) -> None:
        self._phone = self._make_phone()
        self._phone.connect()

    def _close(self) -> None:
        phone, self._phone = self._phone, None
        if phone is not None:
            phone.disconnect()

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        self._restart()

    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        assert self._filter is not None
        told = self._phone.get_action()
        sent = self._filter.last
        assert sent is not None
        if not told or not told.get("phone.enabled"):
            self._restart()
            return self._to(sent, reading, dt)
        place = np.asarray(told["phone.pos"], np.float64), np.asarray(told["phone.rot"].as_matrix(), np.float64)
        # LeRobot's phone keeps its last pose. One in a hand never reports the same pose twice.
        if self._watch.is_stale((place[0].tobytes(), place[1].tobytes()), driving=True):
            self._last = None
            return self._to(sent, reading, dt)
        if self._last is None:  # the clutch has closed
            sent, self._last = self._filter.anchor(reading.tcp_in_base, float(sent[9])), place
        pose, gripper = pose_from_vector(sent)
        turn = rotation_vector_from_matrix(place[1] @ self._last[1].T)
        pose[:3, 3] += self.config.scale * (place[0] - self._last[0])
        pose[:3, :3] = matrix_from_rotation_vector(self.config.scale * turn) @ pose[:3, :3]
        self._last = place
        return self._to(pose_vector(pose, _gripper(told, gripper, dt)), reading, dt)


def _gripper(told: dict[str, Any], gripper: float, dt: float) -> float:
    """Returns the opening: analog 3 of HEBI's app moves it, or buttons A and B of the page."""
    raw = told.get("phone.raw_inputs") or {}
    pressed = float(bool(raw.get("reservedButtonA"))) - float(bool(raw.get("reservedButtonB")))
    return float(np.clip(gripper + (float(raw.get("a3", 0.0)) + pressed) * dt / 0.5, 0.0, 1.0))
