"""The microwave (Lock, Switch Contact): a button releases the door."""

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
    draw_locked,
)

if TYPE_CHECKING:
    import torch

RELEASE = 0.7
"""Share of the button's travel at which the lock gives (paper code)."""


@dataclass(frozen=True)
class MicrowaveState:
    """``locked``: the draw. ``released``: open from the start, or opened since; one-way."""

    locked: bool
    released: bool


class MicrowaveMechanism(Mechanism[MicrowaveState]):
    """Joints ``door`` (0 shut ... ``door_upper`` [rad]) and ``button`` (0 out ... ``button_travel`` in [m]).

    The microwave is open beyond the door angle ``success`` [rad].
    """

    joints = ("door", "button")
    hidden_names = ("locked",)

    def __init__(self, door_upper: float, button_travel: float, success: float) -> None:
        self.goals = {"door": success}
        self._door_upper = check_positive("door_upper", door_upper)
        self._travel = check_positive("button_travel", button_travel)

    def _draw(self, generator: torch.Generator, overrides: Overrides) -> MicrowaveState:
        locked = draw_locked(generator, overrides)
        return MicrowaveState(locked, not locked)

    def step(self, state: MicrowaveState, positions: Positions) -> tuple[MicrowaveState, dict[str, Limits]]:
        """The button alone releases the door; it moves whether the door is locked or not."""
        released = state.released or abs(positions["button"]) >= RELEASE * self._travel
        door = (0.0, self._door_upper) if released else SHUT
        return MicrowaveState(state.locked, released), {"door": door, "button": (0.0, self._travel)}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "locked or not",
            "draws": "locked with p = 0.5",
            "thresholds": f"button at {RELEASE:g} of its travel frees door",
        }
