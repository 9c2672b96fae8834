"""Push or rotate: a part that may be a button, or a knob that turns one way; it looks the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.mechanisms.arrays import filled, where
from lerobot_adamanip.mechanisms.base import JointLimits, Overrides, check_positive, overridden, uniform

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch
    from torch import Tensor

PUSH, ROTATE_POSITIVE, ROTATE_NEGATIVE = 0, 1, 2


@dataclass(frozen=True)
class PushRotateState:
    """``mode`` (B,) int64: push, rotate positive or rotate negative."""

    mode: Tensor


@dataclass(frozen=True)
class PushOrRotate:
    """One of three motions is free, drawn uniformly; the limits hold all episode long.

    Attributes:
        push_upper: travel of the button [m].
        turn_upper: range of the knob [rad].
    """

    push_upper: float
    turn_upper: float

    def __post_init__(self) -> None:
        """Rejects ranges that are empty."""
        check_positive("push_upper", self.push_upper)
        check_positive("turn_upper", self.turn_upper)

    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> PushRotateState:
        """Draws the mode; override ``mode`` (0 push, 1 rotate positive, 2 rotate negative)."""
        mode = (uniform(batch_size, generator) * 3).long().clamp(max=2)
        return PushRotateState(overridden(mode, overrides, "mode", (PUSH, ROTATE_POSITIVE, ROTATE_NEGATIVE)))

    def limits(self, state: PushRotateState) -> tuple[JointLimits, JointLimits]:
        """Returns the limits of push [m] and turn [rad]."""
        zero = filled(state.mode, 0.0)
        push = where(state.mode == PUSH, self.push_upper, zero)
        upper = where(state.mode == ROTATE_POSITIVE, self.turn_upper, zero)
        lower = where(state.mode == ROTATE_NEGATIVE, -self.turn_upper, zero)
        return JointLimits(zero, push), JointLimits(lower, upper)
