"""Lock: the final part stays shut until a key part has been moved far enough (paper, section 3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.mechanisms.base import JointLimits, Overrides, check_positive, opening, overridden, uniform
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch
    from torch import Tensor


def check_fraction(name: str, value: float, *, zero: bool = True) -> float:
    """Returns ``value`` if it lies in [0, 1] (or (0, 1]); raises `ConfigurationError` if not."""
    if 0.0 <= value <= 1.0 and (zero or value > 0.0):
        return value
    raise ConfigurationError(
        f"{name} is a fraction.", got=value, allowed="0 ... 1" if zero else "above 0, at most 1", hint="0.5"
    )


@dataclass(frozen=True)
class LockState:
    """``locked`` (B,) bool: the draw. ``released`` (B,) bool: open from the start, or opened since; one-way."""

    locked: Tensor
    released: Tensor


@dataclass(frozen=True)
class Lock:
    """Holds the final joint at [0, 0] until the key joint has covered ``release_fraction`` of its range.

    Attributes:
        final_upper: limit of the final joint once released [rad or m].
        p_locked: probability that an episode starts locked.
        release_fraction: of the key's range (paper code: 0.85, microwave 0.7).
    """

    final_upper: float
    p_locked: float = 0.5
    release_fraction: float = 0.85

    def __post_init__(self) -> None:
        """Rejects what is no fraction, and a final part that could not open."""
        check_positive("final_upper", self.final_upper)
        check_fraction("p_locked", self.p_locked)
        check_fraction("release_fraction", self.release_fraction, zero=False)

    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> LockState:
        """Draws which episodes start locked; override ``locked``."""
        locked = overridden(uniform(batch_size, generator) < self.p_locked, overrides, "locked", (False, True))
        return LockState(locked, ~locked)

    def step(self, state: LockState, key: Tensor, key_range: Tensor) -> tuple[LockState, JointLimits]:
        """Releases by the key alone, however the final part is pulled. ``key``, ``key_range``: (B,)."""
        released = state.released | (abs(key) >= self.release_fraction * key_range)
        return LockState(state.locked, released), opening(released, self.final_upper)
