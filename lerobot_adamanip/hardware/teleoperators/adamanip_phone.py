"""A phone: the tool follows how it is moved while its button is held. LeRobot's phone tells where it is."""

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
from lerobot_adamanip.hardware.teleoperators.config_adamanip_phone import AdamanipPhoneConfig
from lerobot_adamanip.hardware.teleoperators.stale_input import SilenceWatch
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import TcpTeleop
from lerobot_adamanip.util.errors import RobotError, require_choice


def lerobot_phone(config: AdamanipPhoneConfig) -> Any:
    """Returns LeRobot's phone. Raises `RobotError` without its packages."""
    try:
        from lerobot.teleoperators.phone.config_phone import PhoneConfig, PhoneOS
        from lerobot.teleoperators.phone.teleop_phone import Phone

        require_choice("phone", config.phone_os, [each.value for each in PhoneOS], hint="--teleop.phone_os=android")
        return Phone(PhoneConfig(phone_os=PhoneOS(config.phone_os)))
    except ImportError as error:
        raise RobotError(
            "The phone needs LeRobot's packages for it.",
            got=error,
            allowed="hebi-py and teleop",
            hint="pip install 'lerobot[phone]'",
        ) from None


class AdamanipPhone(TcpTeleop):
    """Moves the goal by what the phone was moved since the last call, scaled, while it is enabled.

    Args:
        config: see `AdamanipPhoneConfig`.
        clock: returns seconds.
        make: returns the phone, with LeRobot's interface.
    """

    config_class = AdamanipPhoneConfig
    name = "adamanip_phone"
    config: AdamanipPhoneConfig

    def __init__(
        self,
        config: AdamanipPhoneConfig,
        clock: Callable[[], float] = time.perf_counter,
        make: Callable[[AdamanipPhoneConfig], Any] = lerobot_phone,
    ) -> None:
        super().__init__(config, clock)
        self._make = make
        self._phone: Any = None
        self._watch = SilenceWatch("phone", clock)
        self._last: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def _open(self) -> None:
        self._phone = self._make(self.config)
        self._phone.connect()

    def _close(self) -> None:
        phone, self._phone = self._phone, None
        if phone is not None:
            phone.disconnect()

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        self._last, self._watch = None, SilenceWatch("phone", self._clock)

    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        assert self._filter is not None
        told = self._phone.get_action()
        sent = self._filter.last
        assert sent is not None
        if not told or not told.get("phone.enabled"):
            self._last, self._watch = None, SilenceWatch("phone", self._clock)
            return self._to(sent, reading, dt)
        place = np.asarray(told["phone.pos"], np.float64), np.asarray(told["phone.rot"].as_matrix(), np.float64)
        # LeRobot's phone keeps its last pose. One in a hand never tells the same twice.
        if self._watch.is_silent((place[0].tobytes(), place[1].tobytes()), driving=True):
            self._last = None
            return self._to(sent, reading, dt)
        if self._last is None:  # the clutch has closed
            sent, self._last = self._filter.anchor(reading.tcp_in_base, float(sent[9])), place
        pose, gripper = pose_from_vector(sent)
        turn = rotation_vector_from_matrix(place[1] @ self._last[1].T)
        pose[:3, 3] += self.config.scale * (place[0] - self._last[0])
        pose[:3, :3] = matrix_from_rotation_vector(self.config.scale * turn) @ pose[:3, :3]
        self._last = place
        return self._to(pose_vector(pose, self._gripper(told, gripper, dt)), reading, dt)

    def _gripper(self, told: dict[str, Any], gripper: float, dt: float) -> float:
        """Analog 3 of HEBI's app opens and closes; A and B of the page do."""
        raw = told.get("phone.raw_inputs") or {}
        way = (
            float(raw.get("a3", 0.0))
            + float(bool(raw.get("reservedButtonA")))
            - float(bool(raw.get("reservedButtonB")))
        )
        return float(np.clip(gripper + way * dt / 0.5, 0.0, 1.0))
