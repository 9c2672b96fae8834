"""Turn to open: bottle, pen, pressure cooker, coffee maker, window and door.

A part turns one way only, through a range nobody sees; once it has turned far enough the final joint is free: a lid
lifts (Rotate & Slide), a leaf swings (Lock with Random Rotation Direction).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from lerobot_adamanip.mechanisms.base import (
    SHUT,
    Limits,
    Mechanism,
    Overrides,
    Positions,
    check_positive,
    direction_words,
    draw_direction,
    draw_range,
    range_words,
    turn_limits,
)

if TYPE_CHECKING:
    import torch

RANGE = (0.5, 1.0)
"""An episode's range is uniform between these fractions of the object's (paper code)."""
RELEASE = 0.85
"""Share of that range at which the final joint is free (paper code)."""


@dataclass(frozen=True)
class TurnToOpenState:
    """The hidden draw, and ``free``: whether the final joint has been released; one-way."""

    direction: int
    turn_range: float
    free: bool


class TurnToOpenMechanism(Mechanism[TurnToOpenState]):
    """A key joint that turns one way, and a final joint that it holds.

    Args:
        key: joint that turns (``cap``).
        final: joint that opens (``lift``), 0 shut.
        key_range: the object's nominal range [rad].
        final_upper: limit of the final joint [rad or m].
        success: position of the final joint beyond which the object is open [rad or m].
        p_positive: probability that the part turns in its joint's positive direction.
    """

    hidden_names = ("direction", "turn_range")

    def __init__(
        self, key: str, final: str, *, key_range: float, final_upper: float, success: float, p_positive: float = 0.5
    ) -> None:
        self.key, self.final = key, final
        self.joints, self.goals = (final, key), {final: success}
        self._key_range = check_positive("key_range", key_range)
        self._final_upper = check_positive("final_upper", final_upper)
        self._p_positive = p_positive

    def _draw(self, generator: torch.Generator, overrides: Overrides) -> TurnToOpenState:
        direction = draw_direction(generator, self._p_positive, overrides)
        turn_range = draw_range(generator, self._key_range, RANGE, overrides, "turn_range")
        return TurnToOpenState(direction, turn_range, free=False)

    def step(self, state: TurnToOpenState, positions: Positions) -> tuple[TurnToOpenState, dict[str, Limits]]:
        """Turning alone frees the final joint; pulling never does."""
        free = state.free or abs(positions[self.key]) >= RELEASE * state.turn_range
        final = (0.0, self._final_upper) if free else SHUT
        return replace(state, free=free), {self.key: turn_limits(state.direction, state.turn_range), self.final: final}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "range" if self._p_positive in (0.0, 1.0) else "direction, range",
            "draws": f"{direction_words(self._p_positive)}; range {range_words(RANGE)}",
            "thresholds": f"{self.key} at {RELEASE:g} of its range frees {self.final}",
        }
