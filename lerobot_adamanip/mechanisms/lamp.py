"""The lamp: one part that is a button, or a knob that turns one way; it looks the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lerobot_adamanip.mechanisms.base import Command, Mechanism, Overrides, Reading, check_names
from lerobot_adamanip.mechanisms.push_rotate import PushOrRotate, PushRotateState

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch


class LampMechanism(Mechanism[PushRotateState]):
    """Joints ``button`` (0 out ... ``push_upper`` in) and ``knob`` (0 at rest).

    Args:
        push_upper: travel of the button [m].
        turn_upper: range of the knob to either side [rad].
        push_success: travel beyond which the lamp is on [m] (paper code: 0.01).
        turn_fraction: of the knob's range, beyond which it is on (paper code: 0.85).
    """

    joints = ("button", "knob")

    def __init__(
        self, push_upper: float, turn_upper: float, *, push_success: float = 0.01, turn_fraction: float = 0.85
    ) -> None:
        self.goals = {"button": push_success, "knob": turn_fraction * turn_upper}
        self._turn_fraction = turn_fraction
        self._family = PushOrRotate(push_upper, turn_upper)

    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> PushRotateState:
        """Draws ``mode``, which can be overridden (0 push, 1 rotate positive, 2 rotate negative)."""
        check_names(overrides, ("mode",))
        return self._family.draw(batch_size, generator, overrides)

    def step(self, state: PushRotateState, reading: Reading) -> tuple[PushRotateState, Command]:
        """The mode decides which of the two joints is free, all episode long."""
        button, knob = self._family.limits(state)
        return state, {"button": button, "knob": knob}

    def hidden(self, state: PushRotateState, index: int) -> dict[str, Any]:
        """Returns ``mode`` of one environment."""
        return {"mode": int(state.mode[index])}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "push, rotate + or rotate -",
            "draws": "one of the three, uniformly",
            "thresholds": "the other two motions are blocked",
        }
