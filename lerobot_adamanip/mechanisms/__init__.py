"""Hidden state as pure batched functions: five families, the mechanisms that combine them, and which object has which.

Presets: see `MECHANISM_RULES`, and docs/differences.md for what each of them takes from where.
"""

from __future__ import annotations

from lerobot_adamanip.mechanisms.base import Command, JointLimits, Mechanism, Overrides, Reading, replace_rows
from lerobot_adamanip.mechanisms.lamp import LampMechanism
from lerobot_adamanip.mechanisms.lock import Lock, LockState
from lerobot_adamanip.mechanisms.microwave import MicrowaveMechanism, MicrowaveMechanismConfig
from lerobot_adamanip.mechanisms.push_rotate import PushOrRotate, PushRotateState
from lerobot_adamanip.mechanisms.rotate_slide import RotateSlideState, RotateThenSlide
from lerobot_adamanip.mechanisms.rotation_direction import RandomRotationDirection, RotationState
from lerobot_adamanip.mechanisms.safe import SafeMechanism, SafeMechanismConfig, SafeState
from lerobot_adamanip.mechanisms.switch_contact import SwitchContact
from lerobot_adamanip.mechanisms.table import (
    DEFAULT_MECHANISM_RULES,
    LIFTED,
    MECHANISM_RULES,
    RULES,
    CategoryRules,
    fixed_direction,
    make_mechanism,
)
from lerobot_adamanip.mechanisms.turn_to_open import TurnToOpenMechanism, TurnToOpenMechanismConfig

__all__ = [
    "DEFAULT_MECHANISM_RULES", "LIFTED", "MECHANISM_RULES", "RULES", "CategoryRules", "Command", "JointLimits",
    "LampMechanism", "Lock", "LockState", "Mechanism", "MicrowaveMechanism", "MicrowaveMechanismConfig", "Overrides",
    "PushOrRotate", "PushRotateState", "RandomRotationDirection", "Reading", "RotateSlideState", "RotateThenSlide",
    "RotationState", "SafeMechanism", "SafeMechanismConfig", "SafeState", "SwitchContact", "TurnToOpenMechanism",
    "TurnToOpenMechanismConfig", "fixed_direction", "make_mechanism", "replace_rows",
]  # fmt: skip
