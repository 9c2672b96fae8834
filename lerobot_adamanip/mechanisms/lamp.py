"""The lamp (Push / Rotate): one part that is a button, or a knob that turns one way; it looks the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.mechanisms.base import (
    SHUT,
    Limits,
    Mechanism,
    Overrides,
    Positions,
    check_positive,
    overridden,
    turn_limits,
    uniform,
)

if TYPE_CHECKING:
    import torch

PUSH, ROTATE_POSITIVE, ROTATE_NEGATIVE = 0, 1, 2
PUSH_SUCCESS, TURN_SUCCESS = 0.01, 0.85
"""Travel of the button [m] and share of the knob's range beyond which the lamp is on (paper code)."""


@dataclass(frozen=True)
class LampState:
    """``mode``: push, rotate positive or rotate negative."""

    mode: int


class LampMechanism(Mechanism[LampState]):
    """Joints ``button`` (0 out ... ``push_upper`` in [m]) and ``knob`` (0 at rest, ``turn_upper`` to a side [rad])."""

    joints = ("button", "knob")
    hidden_names = ("mode",)

    def __init__(self, push_upper: float, turn_upper: float) -> None:
        self.goals = {"button": PUSH_SUCCESS, "knob": TURN_SUCCESS * turn_upper}
        self._push_upper = check_positive("push_upper", push_upper)
        self._turn_upper = check_positive("turn_upper", turn_upper)

    def _draw(self, generator: torch.Generator, overrides: Overrides) -> LampState:
        mode = min(int(uniform(generator) * 3), 2)
        return LampState(overridden(mode, overrides, "mode", (PUSH, ROTATE_POSITIVE, ROTATE_NEGATIVE)))

    def step(self, state: LampState, positions: Positions) -> tuple[LampState, dict[str, Limits]]:
        """The mode decides which one of three motions is free, all episode long."""
        if state.mode == PUSH:
            return state, {"button": (0.0, self._push_upper), "knob": SHUT}
        direction = 1 if state.mode == ROTATE_POSITIVE else -1
        return state, {"button": SHUT, "knob": turn_limits(direction, self._turn_upper)}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "push, rotate + or rotate -",
            "draws": "one of the three, uniformly",
            "thresholds": "the other two motions are blocked",
        }
