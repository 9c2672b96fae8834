"""Turn to open: bottle, pen, pressure cooker, coffee maker, window and door.

A part turns one way only, through a range nobody sees; once it has turned far enough the final joint is free: a lid
lifts (Rotate & Slide), a leaf swings (Lock with Random Rotation Direction).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot_adamanip.mechanisms.base import Command, Mechanism, Overrides, Reading, check_names
from lerobot_adamanip.mechanisms.rotate_slide import RotateSlideState, RotateThenSlide
from lerobot_adamanip.mechanisms.rotation_direction import RandomRotationDirection


@dataclass(frozen=True)
class TurnToOpenMechanismConfig:
    """Draws and thresholds.

    Attributes:
        p_positive: probability that the part turns in its joint's positive direction.
        range_fraction: an episode's range is uniform between these fractions of the object's.
        release_fraction: of that range, at which the final joint is free (paper code: 0.85).
    """

    p_positive: float = 0.5
    range_fraction: tuple[float, float] = (0.5, 1.0)
    release_fraction: float = 0.85


class TurnToOpenMechanism(Mechanism[RotateSlideState]):
    """A key joint that turns one way, and a final joint that it holds.

    Args:
        key: joint that turns (``cap``).
        final: joint that opens (``lift``), 0 shut.
        key_range: the object's nominal range [rad].
        final_upper: limit of the final joint [rad or m].
        success: position of the final joint beyond which the object is open [rad or m].
        config: draws and thresholds.
    """

    def __init__(
        self,
        key: str,
        final: str,
        *,
        key_range: float,
        final_upper: float,
        success: float,
        config: TurnToOpenMechanismConfig = TurnToOpenMechanismConfig(),
    ) -> None:
        self.key, self.final, self.config = key, final, config
        self.joints, self.goals = (final, key), {final: success}
        turn = RandomRotationDirection(key_range, config.p_positive, config.range_fraction)
        self._family = RotateThenSlide(turn, final_upper, config.release_fraction)

    def draw(self, batch_size: int, generator: Any, overrides: Overrides | None = None) -> RotateSlideState:
        """Draws ``direction`` and ``turn_range``; each can be overridden by that name."""
        check_names(overrides, ("direction", "turn_range"))
        return self._family.draw(batch_size, generator, overrides)

    def step(self, state: RotateSlideState, reading: Reading) -> tuple[RotateSlideState, Command]:
        """Turning alone frees the final joint; pulling never does."""
        following, turn, slide = self._family.step(state, reading[self.key], reading[self.final])
        return following, {self.key: turn, self.final: slide}

    def hidden(self, state: RotateSlideState, index: int) -> dict[str, Any]:
        """Returns ``direction`` and ``turn_range`` [rad] of one environment, as drawn."""
        return {
            "direction": int(state.rotation.direction[index]),
            "turn_range": float(state.rotation.turn_range[index]),
        }

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        config = self.config
        return {
            "hidden": "range" if config.p_positive in (0.0, 1.0) else "direction, range",
            "draws": f"{direction_words(config.p_positive)}; range {range_words(config.range_fraction)}",
            "thresholds": f"{self.key} at {config.release_fraction:g} of its range frees {self.final}",
        }


def direction_words(p_positive: float) -> str:
    """Returns how a direction is drawn, in words."""
    if p_positive in (0.0, 1.0):
        return f"direction fixed ({'+' if p_positive else '-'})"
    return f"direction +/- with p = {p_positive:g}"


def range_words(fraction: tuple[float, float]) -> str:
    """Returns how a range is drawn, in words."""
    return f"U({fraction[0]:g}, {fraction[1]:g}) of the object's"
