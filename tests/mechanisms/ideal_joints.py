"""Mechanisms on ideal joints: a joint goes where it is wished, clipped to its limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lerobot_adamanip.mechanisms import (
    LampMechanism,
    Limits,
    Mechanism,
    MicrowaveMechanism,
    SafeMechanism,
    TurnToOpenMechanism,
)

UPPER, TRAVEL = 1.578, 0.013
CAP = TurnToOpenMechanism("cap", "lift", key_range=2.35, final_upper=0.05, success=0.025)
LEVER = TurnToOpenMechanism("lever", "leaf", key_range=1.05, final_upper=1.57, success=math.pi / 7)
MICROWAVE = MicrowaveMechanism(UPPER, TRAVEL, math.pi / 7)
LAMP = LampMechanism(0.022, 1.4)
SAFE = SafeMechanism(UPPER, 1.5)
TURN_LOCKS = SafeMechanism(UPPER, 1.5, lock_on_turn=True)
MECHANISMS: dict[str, Mechanism[Any]] = {
    "cap": CAP, "lever": LEVER, "microwave": MICROWAVE, "lamp": LAMP, "safe": SAFE, "turn locks": TURN_LOCKS,
}  # fmt: skip
Joints = Mapping[str, float]


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def rest(mechanism: Mechanism[Any]) -> dict[str, float]:
    return dict.fromkeys(mechanism.joints, 0.0)


def drawn(mechanism: Mechanism[Any], count: int, seed: int = 0, **overrides: Any) -> list[Any]:
    """States of episodes that follow each other."""
    source = generator(seed)
    return [mechanism.draw(source, overrides) for _ in range(count)]


def play(mechanism: Mechanism[Any], hidden: Joints, wishes: Sequence[Joints]) -> list[dict[str, float]]:
    """Where the joints were after each wish; joints that a wish leaves out are wished at zero."""
    state, limits = mechanism.step(mechanism.draw(generator(), hidden), rest(mechanism))
    seen = []
    for wish in wishes:
        seen.append({name: min(max(wish.get(name, 0.0), lower), upper) for name, (lower, upper) in limits.items()})
        state, limits = mechanism.step(state, seen[-1])
    return seen


def limits_after(mechanism: Mechanism[Any], hidden: Joints, *positions: Joints) -> dict[str, Limits]:
    """Each joint's limits after rest and these positions, however impossible; left out is zero."""
    state = mechanism.draw(generator(), hidden)
    for joints in ({}, *positions):
        state, limits = mechanism.step(state, rest(mechanism) | dict(joints))
    return limits
