"""What a hand-held device asks for between two calls, and what reads one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Jog:
    """One reading of a device.

    Attributes:
        shift: (3,) deflection along the base frame's axes, -1 ... 1 each; times the teleoperator's speed.
        turn: (3,) likewise about them; times its angular speed.
        gripper: opening wanted, 0 closed ... 1 open; None leaves it.
        toggle: whether the gripper is wanted the other way round.
        clutch: whether the device drives: while it is open the goal stays, and closing it begins at the measured pose.
        success: the operator says that the task is done.
        reset: the operator wants the scene of a twin anew.
    """

    shift: Array = field(default_factory=lambda: np.zeros(3))
    turn: Array = field(default_factory=lambda: np.zeros(3))
    gripper: float | None = None
    toggle: bool = False
    clutch: bool = True
    success: bool = False
    reset: bool = False


class JogDevice(Protocol):
    """A device that is open from `open` to `close`. Its SDK is imported in `open`."""

    def open(self) -> None:
        """Raises `RobotError` where the SDK or the device is missing."""

    def read(self) -> Jog:
        """Returns what is asked for now; pressed keys are told once. Never waits. Raises `RobotError`."""

    def close(self) -> None:
        """Idempotent; never raises."""


def dead_zone(values: Array, width: float) -> Array:
    """Returns deflections (N,) with what is smaller than ``width`` taken for rest, continuous there and 1 at 1."""
    size = np.minimum(np.abs(values), 1.0)
    return np.asarray(np.sign(values) * np.maximum(size - width, 0.0) / (1.0 - width))
