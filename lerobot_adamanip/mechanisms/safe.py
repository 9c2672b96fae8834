"""The safe (Lock, Random Rotation Direction, Switch Contact): a knob that turns one way releases the door."""

from __future__ import annotations

import math
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
    draw_locked,
    draw_range,
    range_words,
    turn_limits,
)

if TYPE_CHECKING:
    import torch

RANGE = (0.9, 1.0)
"""An episode's knob range is uniform between these fractions of the object's (paper code)."""
RELEASE, SPOIL = 0.85, 0.15
"""Shares of that range at which the lock gives, and at which `lock_on_turn` locks (paper code)."""
AJAR = 0.02
"""A door that has moved this far [rad] is open, and cannot be locked by its knob."""


@dataclass(frozen=True)
class SafeState:
    """The hidden draw, and ``released``: open from the start, or opened since; one-way but for `lock_on_turn`."""

    locked: bool
    direction: int
    knob_range: float
    released: bool


class SafeMechanism(Mechanism[SafeState]):
    """Joints ``door`` (0 shut ... ``door_upper``) and ``knob`` (0 at rest; one way only).

    Args:
        door_upper: opening limit [rad].
        knob_range: the object's nominal knob range [rad].
        success: door angle beyond which the safe is open [rad] (paper code: pi/7).
        p_positive: probability that the knob turns clockwise, seen from the front.
        lock_on_turn: upstream's variant, not the paper's: in a safe that was not locked, moving the knob by more than
            `SPOIL` of its range locks a shut door for the rest of the episode.
    """

    joints = ("door", "knob")
    hidden_names = ("locked", "direction", "knob_range")

    def __init__(
        self,
        door_upper: float,
        knob_range: float,
        success: float = math.pi / 7,
        *,
        p_positive: float = 0.5,
        lock_on_turn: bool = False,
    ) -> None:
        self.goals = {"door": success}
        self._door_upper = check_positive("door_upper", door_upper)
        self._knob_range = check_positive("knob_range", knob_range)
        self._p_positive, self._lock_on_turn = p_positive, lock_on_turn

    def _draw(self, generator: torch.Generator, overrides: Overrides) -> SafeState:
        locked = draw_locked(generator, overrides)
        direction = draw_direction(generator, self._p_positive, overrides)
        return SafeState(
            locked, direction, draw_range(generator, self._knob_range, RANGE, overrides, "knob_range"), not locked
        )

    def step(self, state: SafeState, positions: Positions) -> tuple[SafeState, dict[str, Limits]]:
        """The knob alone releases the door; pulling never does."""
        turned = abs(positions["knob"])
        released = state.released or turned >= RELEASE * state.knob_range
        if self._lock_on_turn and not state.locked:
            spoils = turned > SPOIL * state.knob_range and positions["door"] < AJAR
            released = state.released and not spoils
        door = (0.0, self._door_upper) if released else SHUT
        limits = {"door": door, "knob": turn_limits(state.direction, state.knob_range)}
        return replace(state, released=released), limits

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        spoils = f"; turning an unlocked one by {SPOIL:g} locks it" if self._lock_on_turn else ""
        return {
            "hidden": "locked or not, direction, range",
            "draws": f"locked with p = 0.5; {direction_words(self._p_positive)}; range {range_words(RANGE)}",
            "thresholds": f"knob at {RELEASE:g} of its range frees door{spoils}",
        }
