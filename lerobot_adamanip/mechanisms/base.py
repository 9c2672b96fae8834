"""What a mechanism is: a pure, batched function from what its joints read to how far each joint may move."""

from __future__ import annotations

import functools
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.mechanisms.arrays import doubles, filled, is_tensor
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch
    from torch import Tensor

type Reading = Mapping[str, Tensor]
"""Joint name -> position (B,) [rad or m]."""


@dataclass(frozen=True)
class JointLimits:
    """A joint may move in [lower, upper]; both (B,) [rad or m]."""

    lower: Tensor
    upper: Tensor


Command = Mapping[str, JointLimits]
Overrides = Mapping[str, bool | int | float]


class Mechanism[StateT](ABC):
    """Rules of one object. Pure: no simulator, no random numbers in `step`, inputs are never changed.

    A state is a frozen dataclass of (B,) tensors: the episode's hidden draw, and what the mechanism remembers. `step`
    and `succeeded` take NumPy arrays likewise, see `mechanisms.arrays`.
    """

    joints: tuple[str, ...]
    """Names of the joints it reads and limits."""
    goals: Mapping[str, float]
    """Joint name -> distance from rest [rad or m]: one of these joints beyond it is success."""

    @abstractmethod
    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> StateT:
        """Draws hidden states of ``batch_size`` new episodes.

        ``overrides`` fixes hidden values by name. The generator is advanced equally with and without them, so that an
        override changes nothing else. Raises `ConfigurationError` for an unknown name or an impossible value.
        """

    @abstractmethod
    def step(self, state: StateT, reading: Reading) -> tuple[StateT, Command]:
        """Returns the next state and each joint's limits."""

    @abstractmethod
    def hidden(self, state: StateT, index: int) -> dict[str, Any]:
        """Returns one environment's hidden draw, JSON-able, by the names that ``overrides`` takes."""

    @abstractmethod
    def rules(self) -> dict[str, str]:
        """Returns ``hidden``, ``draws`` and ``thresholds`` in words, for the documentation's table."""

    def succeeded(self, reading: Reading) -> Tensor:
        """Returns (B,) bool: whether a joint is beyond its goal."""
        return functools.reduce(operator.or_, (abs(reading[joint]) > goal for joint, goal in self.goals.items()))


def uniform(batch_size: int, generator: torch.Generator) -> Tensor:
    """(B,) float64 draws in [0, 1), on the generator's device."""
    import torch

    return torch.rand(batch_size, generator=generator, dtype=torch.float64, device=generator.device)


def overridden(drawn: Tensor, overrides: Overrides | None, name: str, choices: Collection[int] = ()) -> Tensor:
    """Returns ``drawn``, or the overriding value in its shape and dtype.

    Raises:
        ConfigurationError: the value is none of ``choices``; without choices, no positive number.
    """
    if overrides is None or name not in overrides:
        return drawn
    value = overrides[name]
    positive = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
    if not (value in choices if choices else positive):
        allowed = " or ".join(map(str, choices)) or "a number above 0"
        raise ConfigurationError(f"Impossible {name}.", got=repr(value), allowed=allowed, hint="leave it out")
    import torch

    return torch.full_like(drawn, value)


def opening(is_free: Tensor, upper: float) -> JointLimits:
    """Returns float64 limits [0, upper] where ``is_free`` (B,), [0, 0] elsewhere."""
    # Not torch.where: of two Python numbers it makes float32, which rounds the limit.
    limits = doubles(is_free) * upper
    return JointLimits(filled(limits, 0.0), limits)


def check_names(overrides: Overrides | None, names: Collection[str]) -> None:
    """Raises `ConfigurationError` if an override has none of these names: misspelt, it would do nothing."""
    unknown = set(overrides or ()) - set(names)
    if unknown:
        got, allowed = ", ".join(sorted(unknown)), ", ".join(names)
        raise ConfigurationError("Unknown hidden value.", got=got, allowed=allowed, hint="leave it out")


def check_positive(name: str, value: float) -> float:
    """Returns ``value`` if it is above 0 and finite; raises `ConfigurationError` if not."""
    if 0 < value < math.inf:
        return value
    raise ConfigurationError(f"{name} has to be positive.", got=value, allowed="above 0", hint="the object's own")


def replace_rows[StateT](state: StateT, fresh: StateT, mask: Tensor) -> StateT:
    """Returns ``state`` with the environments of ``mask`` (B,) taken from ``fresh``: how some of a batch are reset."""
    if is_tensor(state):
        import torch

        return torch.where(mask, fresh, state)  # type: ignore[call-overload, no-any-return]
    if not is_dataclass(state) or isinstance(state, type):
        raise TypeError(f"a state is a dataclass of tensors, got {type(state).__name__}")
    names = [item.name for item in fields(state)]
    return replace(state, **{n: replace_rows(getattr(state, n), getattr(fresh, n), mask) for n in names})
