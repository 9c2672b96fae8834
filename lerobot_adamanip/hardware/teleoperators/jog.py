"""Teleoperation by deflections: speeds along and about the base frame's axes."""

from __future__ import annotations

import abc
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, pose_from_vector, pose_vector
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.robot_registry import OPERATOR_SUCCESS, RESET_WANTED, RobotSession
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.hardware.teleoperators.config_devices import TcpTeleopConfig
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import TcpTeleop

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Jog:
    """One reading of a device.

    Attributes:
        shift: (3,) deflection along the base frame's axes, -1 ... 1 each; times the teleoperator's speed.
        turn: (3,) likewise about them; times its angular speed.
        toggle: whether to open a closed gripper, or close an open one.
        clutch: whether the device drives: while False the goal stays; closing it anchors at the measured pose.
        success: the operator says that the task is done.
        reset: the operator wants a twin's scene reset.
    """

    shift: Array = field(default_factory=lambda: np.zeros(3))
    turn: Array = field(default_factory=lambda: np.zeros(3))
    toggle: bool = False
    clutch: bool = True
    success: bool = False
    reset: bool = False


def dead_zone(values: Array, width: float) -> Array:
    """Returns deflections (N,), zero below ``width``, continuous there and 1 at 1."""
    size = np.minimum(np.abs(values), 1.0)
    return np.asarray(np.sign(values) * np.maximum(size - width, 0.0) / (1.0 - width))


class JogTeleop(TcpTeleop):
    """Integrates the deflections of a device, which `_read` reports. Constructor: see `TcpTeleop`."""

    def __init__(self, config: TcpTeleopConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config, clock)
        self._driving = False

    @abc.abstractmethod
    def _read(self) -> Jog:
        """Returns the present deflections; pressed keys are reported once. Never waits. Raises `RobotError`."""

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        self._driving = False
        if new_episode:
            session.details.pop(OPERATOR_SUCCESS, None)

    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        jog = self._read()
        if jog.success:
            session.details[OPERATOR_SUCCESS] = True
        if jog.reset:
            session.details[RESET_WANTED] = True
        assert self._filter is not None
        if jog.clutch and not self._driving:
            held = self._filter.last
            self._filter.anchor(reading.tcp_in_base, reading.gripper if held is None else float(held[GRIPPER_DIM]))
            dt = 0.0  # deflections from before the clutch closed move nothing
        self._driving = jog.clutch
        last = self._filter.last
        assert last is not None
        pose, gripper = pose_from_vector(last)
        still = not jog.clutch or not (jog.shift.any() or jog.turn.any())
        if jog.toggle:
            gripper = 0.0 if gripper > 0.5 else 1.0
        if jog.clutch:
            pose[:3, 3] += jog.shift * (self.config.speed * dt)
            pose[:3, :3] = matrix_from_rotation_vector(jog.turn * (self.config.angular_speed * dt)) @ pose[:3, :3]
        wanted = last.copy() if still else pose_vector(pose, gripper)
        wanted[GRIPPER_DIM] = gripper
        return self._to(wanted, reading, dt)
