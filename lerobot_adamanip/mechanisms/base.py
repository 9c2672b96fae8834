"""Rules of an object: pure functions from joint positions to joint limits."""

from __future__ import annotations

import math
import numbers
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from typing import Any, Protocol

import numpy as np

from lerobot_adamanip.util.errors import ConfigurationError

type Positions = Mapping[str, float]
"""Joint name -> position [rad or m]."""
type Limits = tuple[float, float]
"""A joint may move in [lower, upper] [rad or m]."""
Overrides = Mapping[str, bool | int | float]
SHUT: Limits = (0.0, 0.0)


class Draws(Protocol):
    """Source of uniform random numbers: `numpy.random.Generator`, or `contract.seeds.BalancedDraws`."""

    def random(self) -> float:
        """Returns the next number in [0, 1)."""


class Mechanism[StateT](ABC):
    """Rules of one object. Pure: no simulator, no random numbers in `step`, inputs are never changed.

    A state is a frozen dataclass with the episode's hidden draw (fields named as in `hidden_names`) and the mechanism's
    memory.
    """

    joints: tuple[str, str]
    """Names of the joints it reads and limits."""
    goals: Mapping[str, float]
    """Joint name -> distance from rest [rad or m]; an episode succeeds when one of these joints is beyond it."""
    hidden_names: tuple[str, ...]
    """Names of the hidden values, in overrides and results."""

    def draw(self, generator: Draws, overrides: Overrides | None = None) -> StateT:
        """Draws the hidden state of a new episode.

        ``overrides`` fixes hidden values by name. The generator advances equally with and without them, so an override
        changes no other value. Raises `ConfigurationError` for an unknown name or an impossible value.
        """
        if unknown := [str(name) for name in overrides or () if name not in self.hidden_names]:
            got, allowed = ", ".join(sorted(unknown)), ", ".join(self.hidden_names)
            raise ConfigurationError("Unknown hidden value.", got=got, allowed=allowed, hint="leave it out")
        return self._draw(generator, overrides or {})

    @abstractmethod
    def _draw(self, generator: Draws, overrides: Overrides) -> StateT: ...

    @abstractmethod
    def step(self, state: StateT, positions: Positions) -> tuple[StateT, dict[str, Limits]]:
        """Returns the next state and each joint's limits."""

    @abstractmethod
    def rules(self) -> dict[str, str]:
        """Returns ``hidden``, ``draws`` and ``thresholds`` in words, for the documentation's table."""

    def hidden(self, state: StateT) -> dict[str, Any]:
        """Returns the hidden draw, JSON-able, under the names that ``overrides`` accepts."""
        return {name: getattr(state, name) for name in self.hidden_names}

    def succeeded(self, positions: Positions) -> bool:
        """Returns whether a joint is beyond its goal, in the single precision of the simulator."""
        return any(bool(np.float32(abs(positions[joint])) > np.float32(goal)) for joint, goal in self.goals.items())


def overridden[ValueT: (bool, int, float)](
    drawn: ValueT, overrides: Overrides, name: str, choices: Collection[int] = (), most: float = math.inf
) -> ValueT:
    """Returns the override of ``name`` in the type of ``drawn``; without one, ``drawn``.

    Raises:
        ConfigurationError: the value is not in ``choices``; or there are none and it is not positive and finite, or is
            above ``most``.
    """
    if name not in overrides:
        return drawn
    value = overrides[name]
    is_flag = isinstance(value, bool | np.bool_)
    is_number = isinstance(value, numbers.Real) and not is_flag
    positive = is_number and 0 < value < math.inf
    possible = (is_number or is_flag) and value in choices if choices else positive and value <= most
    if not possible:
        allowed = " or ".join(map(str, choices)) or f"a number above 0 and up to {most:g}"
        raise ConfigurationError(f"Impossible {name}.", got=repr(value), allowed=allowed, hint="leave it out")
    return type(drawn)(value)


def draw_flag(generator: Draws, overrides: Overrides, name: str) -> bool:
    """Draws a hidden value that is True with p = 1/2; override ``name``."""
    return overridden(generator.random() < 0.5, overrides, name, (False, True))


def draw_direction(generator: Draws, p_positive: float, overrides: Overrides) -> int:
    """Draws the direction in which a part turns, +1 or -1; override ``direction``."""
    return overridden(1 if generator.random() < p_positive else -1, overrides, "direction", (-1, 1))


def draw_range(
    generator: Draws, nominal: float, fractions: tuple[float, float], overrides: Overrides, name: str
) -> float:
    """Draws the range of a part [rad], uniform between two fractions of ``nominal``, its most; override ``name``."""
    low, high = fractions
    return overridden(float(nominal * (low + (high - low) * generator.random())), overrides, name, most=nominal)


def turn_limits(direction: int, turn_range: float) -> Limits:
    """Returns the limits of a joint that turns one way only."""
    return (0.0, turn_range) if direction > 0 else (-turn_range, 0.0)


def check_positive(name: str, value: float) -> float:
    """Returns ``value`` if it is above 0 and finite; raises `ConfigurationError` if not."""
    if 0 < value < math.inf:
        return value
    raise ConfigurationError(f"{name} has to be positive.", got=value, allowed="above 0", hint="the object's own")


def direction_words(p_positive: float) -> str:
    """Returns how a direction is drawn, in words."""
    if p_positive in (0.0, 1.0):
        return f"direction fixed ({'+' if p_positive else '-'})"
    return f"direction +/- with p = {p_positive:g}"


def range_words(fractions: tuple[float, float]) -> str:
    """Returns how a range is drawn, in words."""
    return f"U({fractions[0]:g}, {fractions[1]:g}) of the object's"
