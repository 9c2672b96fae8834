"""Random rotation direction: a knob, cap or lever turns one way only, and does not show which."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.mechanisms.arrays import filled, where
from lerobot_adamanip.mechanisms.base import JointLimits, Overrides, check_positive, overridden, uniform
from lerobot_adamanip.mechanisms.lock import check_fraction
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch
    from torch import Tensor


@dataclass(frozen=True)
class RotationState:
    """``direction`` (B,) int64, +1 or -1; ``turn_range`` (B,) [rad], positive."""

    direction: Tensor
    turn_range: Tensor


@dataclass(frozen=True)
class RandomRotationDirection:
    """A revolute joint free in [0, r] or [-r, 0].

    Attributes:
        nominal_range: the object's own range [rad].
        p_positive: probability of the positive direction.
        range_fraction: an episode's r is uniform between these fractions of the nominal (safe 0.9-1, others 0.5-1).
        range_name: what the range is called among hidden values.
    """

    nominal_range: float
    p_positive: float = 0.5
    range_fraction: tuple[float, float] = (0.5, 1.0)
    range_name: str = "turn_range"

    def __post_init__(self) -> None:
        """Rejects ranges that are empty or not fractions."""
        check_fraction("p_positive", self.p_positive)
        low, high = (check_fraction("range_fraction", value, zero=False) for value in self.range_fraction)
        check_positive("nominal_range", self.nominal_range)
        if low > high:
            allowed = "fractions in rising order"
            raise ConfigurationError(
                "Empty rotation range.", got=self.range_fraction, allowed=allowed, hint="(0.5, 1.0)"
            )

    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> RotationState:
        """Draws direction and range; overrides ``direction`` (+1 or -1) and the range's name [rad]."""
        import torch

        positive = uniform(batch_size, generator) < self.p_positive
        low, high = self.range_fraction
        turn_range = self.nominal_range * (low + (high - low) * uniform(batch_size, generator))
        direction = overridden(torch.where(positive, 1, -1), overrides, "direction", (-1, 1))
        return RotationState(direction, overridden(turn_range, overrides, self.range_name))

    def limits(self, state: RotationState) -> JointLimits:
        """Returns the joint's limits, the same all episode long."""
        positive, turn_range = state.direction > 0, state.turn_range
        zero = filled(turn_range, 0.0)
        return JointLimits(where(positive, zero, -turn_range), where(positive, turn_range, zero))
