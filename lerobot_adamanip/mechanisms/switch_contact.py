"""Switch contact: a lock whose key is another part than the one that opens, so the hand has to change over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.mechanisms.arrays import where
from lerobot_adamanip.mechanisms.base import JointLimits, opening
from lerobot_adamanip.mechanisms.lock import Lock, LockState, check_fraction

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    from torch import Tensor

AJAR = 0.02
"""A final part that has moved this far [rad or m] is open, and cannot be locked by its key."""


@dataclass(frozen=True)
class SwitchContact(Lock):
    """A `Lock` with its key on a separate part (safe: knob; microwave: button).

    Attributes:
        lock_on_turn: upstream's variant, not the paper's: in a safe that was not locked, moving the key by more than
            ``lock_fraction`` of its range locks a shut door for the rest of the episode.
        lock_fraction: see there (paper code: 0.15).
    """

    lock_on_turn: bool = False
    lock_fraction: float = 0.15

    def __post_init__(self) -> None:
        """Rejects what is no fraction."""
        super().__post_init__()
        check_fraction("lock_fraction", self.lock_fraction, zero=False)

    def step_with(
        self, state: LockState, key: Tensor, key_range: Tensor, final: Tensor
    ) -> tuple[LockState, JointLimits]:
        """As `Lock.step`; ``final`` (B,) is the final joint's position, which keeps an open door from being locked."""
        if not self.lock_on_turn:
            return self.step(state, key, key_range)
        spoiled = ~state.locked & (~state.released | ((abs(key) > self.lock_fraction * key_range) & (final < AJAR)))
        opened = state.released | (abs(key) >= self.release_fraction * key_range)
        released = where(state.locked, opened, ~spoiled)
        return LockState(state.locked, released), opening(released, self.final_upper)
