"""Hidden state as pure batched functions: five families, the mechanisms that combine them, and which object has which.

Two presets. ``paper``: what the paper's text says. ``upstream``: what its released code does instead, where the two
differ (pressure cooker and coffee maker turn one way only; a safe that was not locked is locked by turning its knob).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from lerobot_adamanip.errors import require_choice
from lerobot_adamanip.mechanisms.base import Command, JointLimits, Mechanism, Overrides, Reading, replace_rows
from lerobot_adamanip.mechanisms.lamp import LampMechanism
from lerobot_adamanip.mechanisms.lock import Lock, LockState
from lerobot_adamanip.mechanisms.microwave import MicrowaveMechanism, MicrowaveMechanismConfig
from lerobot_adamanip.mechanisms.push_rotate import PushOrRotate, PushRotateState
from lerobot_adamanip.mechanisms.rotate_slide import RotateSlideState, RotateThenSlide
from lerobot_adamanip.mechanisms.rotation_direction import RandomRotationDirection, RotationState
from lerobot_adamanip.mechanisms.safe import SafeMechanism, SafeMechanismConfig, SafeState
from lerobot_adamanip.mechanisms.switch_contact import SwitchContact
from lerobot_adamanip.mechanisms.turn_to_open import TurnToOpenMechanism, TurnToOpenMechanismConfig
from lerobot_adamanip.objects.base import ArticulatedObject

MECHANISM_PRESETS = ("paper", "upstream")
LIFTED = 0.025
"""A cap, lid or portafilter is off beyond this [m] (paper code)."""


def _turn_to_open(key: str, final: str, success: float, **upstream: float) -> Callable[[ArticulatedObject, str], Any]:
    def make(obj: ArticulatedObject, preset: str) -> TurnToOpenMechanism:
        config = TurnToOpenMechanismConfig(**(upstream if preset == "upstream" else {}))  # type: ignore[arg-type]
        key_range, final_upper = obj.joint(key).limits[1], obj.joint(final).limits[1]
        return TurnToOpenMechanism(
            key, final, key_range=key_range, final_upper=final_upper, success=success, config=config
        )

    return make


def _safe(obj: ArticulatedObject, preset: str) -> SafeMechanism:
    config = SafeMechanismConfig(lock_on_turn=preset == "upstream")
    return SafeMechanism(obj.joint("door").limits[1], obj.joint("knob").limits[1], math.pi / 7, config)


def _microwave(obj: ArticulatedObject, preset: str) -> MicrowaveMechanism:
    return MicrowaveMechanism(obj.joint("door").limits[1], obj.joint("button").limits[1], math.pi / 7)


def _lamp(obj: ArticulatedObject, preset: str) -> LampMechanism:
    return LampMechanism(obj.joint("button").limits[1], obj.joint("knob").limits[1])


_MECHANISMS: dict[str, Callable[[ArticulatedObject, str], Mechanism[Any]]] = {
    "bottle": _turn_to_open("cap", "lift", LIFTED),
    "pen": _turn_to_open("cap", "lift", LIFTED),
    "pressure_cooker": _turn_to_open("lid", "lift", LIFTED, p_positive=1.0),
    "coffee_maker": _turn_to_open("portafilter", "drop", LIFTED, p_positive=0.0),
    "safe": _safe,
    "microwave": _microwave,
    "window": _turn_to_open("handle", "sash", math.pi / 6),
    "door": _turn_to_open("lever", "leaf", math.pi / 7),
    "lamp": _lamp,
}


def make_mechanism(obj: ArticulatedObject, preset: str = "paper") -> Mechanism[Any]:
    """Returns the rules of an object, by its category; raises `ConfigurationError` for an unknown preset."""
    return _MECHANISMS[obj.category](obj, require_choice("mechanism preset", preset, MECHANISM_PRESETS))


__all__ = [
    "LIFTED", "MECHANISM_PRESETS", "Command", "JointLimits", "LampMechanism", "Lock", "LockState", "Mechanism",
    "MicrowaveMechanism", "MicrowaveMechanismConfig", "Overrides", "PushOrRotate", "PushRotateState",
    "RandomRotationDirection", "Reading", "RotateSlideState", "RotateThenSlide", "RotationState", "SafeMechanism",
    "SafeMechanismConfig", "SafeState", "SwitchContact", "TurnToOpenMechanism", "TurnToOpenMechanismConfig",
    "make_mechanism", "replace_rows",
]  # fmt: skip
