"""What a mechanism is: a pure, batched function from what its joints read to how far each joint may move."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

Reading = Mapping[str, Tensor]
"""Joint name -> position (B,) [rad or m]."""


@dataclass(frozen=True)
class JointLimits:
    """A joint may move in [lower, upper]; both (B,) [rad or m]."""

    lower: Tensor
    upper: Tensor


Command = Mapping[str, JointLimits]
Overrides = Mapping[str, bool | int | float]
StateT = TypeVar("StateT")


class Mechanism(ABC, Generic[StateT]):
    """Rules of one object. Pure: no simulator, no random numbers in `step`, inputs are never changed.

    A state is a frozen dataclass of (B,) tensors: the episode's hidden draw, and what the mechanism remembers.
    """

    joints: tuple[str, ...]
    """Names of the joints it reads and limits."""

    @abstractmethod
    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> StateT:
        """Draws hidden states of ``batch_size`` new episodes.

        ``overrides`` fixes hidden values by name. The generator is advanced equally with and without them, so that an
        override changes nothing else.
        """

    @abstractmethod
    def step(self, state: StateT, reading: Reading) -> tuple[StateT, Command]:
        """Returns the next state and each joint's limits."""

    @abstractmethod
    def hidden(self, state: StateT, index: int) -> dict[str, Any]:
        """Returns one environment's hidden draw, JSON-able, by the names that ``overrides`` takes."""


def uniform(batch_size: int, generator: torch.Generator) -> Tensor:
    """(B,) float64 draws in [0, 1)."""
    return torch.rand(batch_size, generator=generator, dtype=torch.float64)


def overridden(drawn: Tensor, overrides: Overrides | None, name: str) -> Tensor:
    """Returns ``drawn``, or the overriding value in its shape and dtype."""
    if overrides is None or name not in overrides:
        return drawn
    return torch.full_like(drawn, overrides[name])


def replace_rows(state: StateT, fresh: StateT, mask: Tensor) -> StateT:
    """Returns ``state`` with the environments of ``mask`` (B,) taken from ``fresh``: how some of a batch are reset."""
    if isinstance(state, Tensor):
        return torch.where(mask, fresh, state)  # type: ignore[call-overload, no-any-return]
    if not is_dataclass(state):
        raise TypeError(f"a state is a dataclass of tensors, got {type(state).__name__}")
    parts = {item.name: replace_rows(getattr(state, item.name), getattr(fresh, item.name), mask) for item in fields(state)}
    return type(state)(**parts)
