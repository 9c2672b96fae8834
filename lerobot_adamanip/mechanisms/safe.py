"""The safe: lock, random rotation direction and switch contact in one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.mechanisms.base import Command, Mechanism, Overrides, Reading, check_names
from lerobot_adamanip.mechanisms.lock import LockState
from lerobot_adamanip.mechanisms.rotation_direction import RandomRotationDirection, RotationState
from lerobot_adamanip.mechanisms.switch_contact import SwitchContact
from lerobot_adamanip.mechanisms.turn_to_open import direction_words, range_words

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch


@dataclass(frozen=True)
class SafeMechanismConfig:
    """Draws and thresholds of the safe (paper code, section "safe").

    Attributes:
        p_locked: probability that an episode starts locked.
        p_clockwise: probability that the knob turns clockwise, seen from the front; direction +1.
        range_fraction: an episode's knob range is uniform between these fractions of the object's.
        release_fraction: of that range, at which the lock gives.
        lock_on_turn: upstream's variant, see `SwitchContact`.
    """

    p_locked: float = 0.5
    p_clockwise: float = 0.5
    range_fraction: tuple[float, float] = (0.9, 1.0)
    release_fraction: float = 0.85
    lock_on_turn: bool = False


@dataclass(frozen=True)
class SafeState:
    """States of the two families."""

    lock: LockState
    rotation: RotationState


class SafeMechanism(Mechanism[SafeState]):
    """Joints ``door`` (0 shut ... ``door_upper``) and ``knob`` (0 at rest; one way only).

    Args:
        door_upper: opening limit [rad].
        knob_range: the object's nominal knob range [rad].
        success: door angle beyond which the safe is open [rad] (paper code: pi/7).
        config: draws and thresholds.
    """

    joints = ("door", "knob")

    def __init__(
        self,
        door_upper: float,
        knob_range: float,
        success: float = math.pi / 7,
        config: SafeMechanismConfig = SafeMechanismConfig(),
    ) -> None:
        self.config, self.goals = config, {"door": success}
        self._lock = SwitchContact(
            door_upper, config.p_locked, config.release_fraction, lock_on_turn=config.lock_on_turn
        )
        self._rotation = RandomRotationDirection(knob_range, config.p_clockwise, config.range_fraction, "knob_range")

    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> SafeState:
        """Draws ``locked``, ``direction`` and ``knob_range``; each can be overridden by that name."""
        check_names(overrides, ("locked", "direction", "knob_range"))
        lock = self._lock.draw(batch_size, generator, overrides)
        return SafeState(lock, self._rotation.draw(batch_size, generator, overrides))

    def step(self, state: SafeState, reading: Reading) -> tuple[SafeState, Command]:
        """The knob alone releases the door; pulling never does."""
        lock, door = self._lock.step_with(state.lock, reading["knob"], state.rotation.turn_range, reading["door"])
        return SafeState(lock, state.rotation), {"door": door, "knob": self._rotation.limits(state.rotation)}

    def hidden(self, state: SafeState, index: int) -> dict[str, Any]:
        """Returns ``locked``, ``direction`` and ``knob_range`` [rad] of one environment, as drawn."""
        return {
            "locked": bool(state.lock.locked[index]),
            "direction": int(state.rotation.direction[index]),
            "knob_range": float(state.rotation.turn_range[index]),
        }

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        config = self.config
        spoils = f"; turning an unlocked one by {self._lock.lock_fraction:g} locks it" if config.lock_on_turn else ""
        return {
            "hidden": "locked or not, direction, range",
            "draws": f"locked with p = {config.p_locked:g}; {direction_words(config.p_clockwise)}; "
            f"range {range_words(config.range_fraction)}",
            "thresholds": f"knob at {config.release_fraction:g} of its range frees door{spoils}",
        }
