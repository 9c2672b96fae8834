"""Mechanisms on ideal joints: a joint goes where it is wished, clipped to its limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import torch
from torch import Tensor

from lerobot_adamanip.mechanisms import (
    LampMechanism,
    Mechanism,
    MicrowaveMechanism,
    SafeMechanism,
    SafeMechanismConfig,
    TurnToOpenMechanism,
)

DOOR_UPPER, NOMINAL = 1.578, 1.5
CAP = TurnToOpenMechanism("cap", "lift", key_range=2.35, final_upper=0.05, success=0.025)
LEVER = TurnToOpenMechanism("lever", "leaf", key_range=1.05, final_upper=1.57, success=math.pi / 7)
MICROWAVE = MicrowaveMechanism(DOOR_UPPER, 0.013, math.pi / 7)
LAMP = LampMechanism(0.022, 1.4)
SAFE = SafeMechanism(DOOR_UPPER, NOMINAL)
TURN_LOCKS = SafeMechanism(DOOR_UPPER, NOMINAL, config=SafeMechanismConfig(lock_on_turn=True))
MECHANISMS: dict[str, Mechanism[Any]] = {
    "cap": CAP, "lever": LEVER, "microwave": MICROWAVE, "lamp": LAMP, "safe": SAFE, "turn locks": TURN_LOCKS,
}  # fmt: skip
Joints = Mapping[str, float]


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def leaves(state: Any) -> list[Tensor]:
    """The tensors of a state, limits or a tensor."""
    if is_dataclass(state):
        return [leaf for item in fields(state) for leaf in leaves(getattr(state, item.name))]
    return [state]


def same(a: Any, b: Any) -> bool:
    return all(x.dtype == y.dtype and torch.equal(x, y) for x, y in zip(leaves(a), leaves(b), strict=True))


def take(state: Any, rows: Tensor) -> Any:
    """Some rows of a state, in that order."""
    if isinstance(state, Tensor):
        return state[rows]
    return replace(state, **{item.name: take(getattr(state, item.name), rows) for item in fields(state)})


def reading(joints: Joints, batch: int = 1) -> dict[str, Tensor]:
    return {name: torch.full((batch,), value, dtype=torch.float64) for name, value in joints.items()}


def random_reading(mechanism: Mechanism[Any], batch: int, seed: int) -> dict[str, Tensor]:
    """Anything between well below and well above what each joint can do."""
    scale = {"lift": 0.05, "button": 0.02}
    return {
        name: (torch.rand(batch, generator=generator(seed + i), dtype=torch.float64) * 3 - 1.5) * scale.get(name, 1.0)
        for i, name in enumerate(mechanism.joints)
    }


def rest(mechanism: Mechanism[Any]) -> dict[str, float]:
    return dict.fromkeys(mechanism.joints, 0.0)


def play(mechanism: Mechanism[Any], hidden: Mapping[str, Any], wishes: list[Joints]) -> list[dict[str, float]]:
    """Returns where the joints were after each wish; joints that a wish leaves out are wished at zero."""
    state = mechanism.draw(1, generator(), hidden)
    state, command = mechanism.step(state, reading(rest(mechanism)))
    seen = []
    for wish in wishes:
        joints = {
            name: min(max(wish.get(name, 0.0), float(command[name].lower)), float(command[name].upper))
            for name in mechanism.joints
        }
        state, command = mechanism.step(state, reading(joints))
        seen.append(joints)
    return seen


def limits_after(
    mechanism: Mechanism[Any], hidden: Mapping[str, Any], *readings: Joints
) -> dict[str, tuple[float, float]]:
    """Returns each joint's limits after rest and these readings, however impossible; left out is zero."""
    state = mechanism.draw(1, generator(), hidden)
    for joints in ({}, *readings):
        state, command = mechanism.step(state, reading(rest(mechanism) | dict(joints)))
    return {name: (float(limits.lower), float(limits.upper)) for name, limits in command.items()}
