"""What a batch of ``adaafford`` asks for the outcome of."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Interactions:
    """Interactions (B, K) as tensors; see `InteractionLabels`. What is not ``valid`` is none."""

    before: Tensor
    command: Tensor
    after: Tensor
    opening: Tensor
    moved: Tensor
    tried: Tensor
    valid: Tensor


@dataclass(frozen=True)
class Astray:
    """Actions where nobody has taken hold.

    Attributes:
        places: (B, E, 3) [m] of the tool.
        actions: (B, E, 12) what describes them.
        away: (B, E) bool, whether nobody has taken hold there.
    """

    places: Tensor
    actions: Tensor
    away: Tensor


def trimmed(numbers: Tensor) -> Tensor:
    """Returns rows (B, K) of numbers that are followed by -1, as short as the longest of them; at least one each."""
    longest = int((numbers >= 0).sum(dim=1).amax())
    return numbers[:, : max(1, longest)]
