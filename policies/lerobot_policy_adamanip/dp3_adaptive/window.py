"""What a head is given: the same in training and at run time."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Window:
    """Inputs of a head, normalised, with S observed steps and H remembered actions.

    Attributes:
        observations: cloud (B, S or 1, N, 3) [m], state (B, S, D), effort (B, S, 7) if used; the last is the present.
            The instruction (B, S or 1, 64) if the policy is told one.
        history: (B, H, A) actions, oldest first. At an episode's start LeRobot pads it with the *label*: whatever is
            not valid may not be looked at, in training and at run time alike.
        valid: (B, H) bool.
    """

    observations: dict[str, Tensor]
    history: Tensor
    valid: Tensor
