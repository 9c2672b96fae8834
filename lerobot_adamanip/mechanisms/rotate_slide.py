"""Rotate and slide: a part has to be turned to an angle nobody sees before it can be lifted or pulled out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lerobot_adamanip.mechanisms.base import JointLimits, Overrides, check_positive, opening
from lerobot_adamanip.mechanisms.lock import check_fraction
from lerobot_adamanip.mechanisms.rotation_direction import RandomRotationDirection, RotationState

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch
    from torch import Tensor


@dataclass(frozen=True)
class RotateSlideState:
    """The rotation's draw, and whether the slide is free (B,) bool."""

    rotation: RotationState
    free: Tensor


@dataclass(frozen=True)
class RotateThenSlide:
    """A prismatic joint held at 0 until its part has turned through ``release_fraction`` of the episode's range.

    Attributes:
        rotation: direction and range of the turn.
        slide_upper: limit of the slide once free [m].
        release_fraction: of the range (paper code: 0.85).
        latched: stays free once it has been; if not, turning back holds it again, unless it has already slid.
    """

    rotation: RandomRotationDirection
    slide_upper: float = 0.05
    release_fraction: float = 0.85
    latched: bool = True

    def __post_init__(self) -> None:
        """Rejects what is no fraction, and a slide that could not move."""
        check_positive("slide_upper", self.slide_upper)
        check_fraction("release_fraction", self.release_fraction, zero=False)

    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> RotateSlideState:
        """Draws the rotation; the slide starts held."""
        rotation = self.rotation.draw(batch_size, generator, overrides)
        import torch

        return RotateSlideState(rotation, torch.zeros_like(rotation.direction, dtype=torch.bool))

    def step(
        self, state: RotateSlideState, turn: Tensor, slide: Tensor
    ) -> tuple[RotateSlideState, JointLimits, JointLimits]:
        """Returns the next state and the limits of turn and slide. ``turn`` (B,) [rad], ``slide`` (B,) [m]."""
        turned = abs(turn) >= self.release_fraction * state.rotation.turn_range
        # A part half way out cannot be pushed back in by turning it, so what has slid stays free.
        kept = state.free if self.latched else state.free & (slide > 1e-3)
        free = turned | kept
        return (
            RotateSlideState(state.rotation, free),
            self.rotation.limits(state.rotation),
            opening(free, self.slide_upper),
        )
