"""Hidden state as pure functions: the rules of each category, and which presets there are.

The paper's five families: Lock and Switch Contact (`safe`, `microwave`), Random Rotation Direction (`safe`,
`turn_to_open`), Rotate & Slide (`turn_to_open`), Push / Rotate (`lamp`). Presets: see `MECHANISM_RULES`, and
docs/differences.md for what each of them takes from where.
"""

from __future__ import annotations

from lerobot_adamanip.mechanisms.base import Limits, Mechanism, Overrides, Positions
from lerobot_adamanip.mechanisms.lamp import LampMechanism
from lerobot_adamanip.mechanisms.microwave import MicrowaveMechanism
from lerobot_adamanip.mechanisms.safe import SafeMechanism
from lerobot_adamanip.mechanisms.table import (
    DEFAULT_MECHANISM_RULES,
    LIFTED,
    MECHANISM_RULES,
    RULES,
    CategoryRules,
    fixed_direction,
    infeasible,
    make_mechanism,
)
from lerobot_adamanip.mechanisms.turn_to_open import TurnToOpenMechanism

__all__ = [
    "DEFAULT_MECHANISM_RULES", "LIFTED", "MECHANISM_RULES", "RULES", "CategoryRules", "LampMechanism", "Limits",
    "Mechanism", "MicrowaveMechanism", "Overrides", "Positions", "SafeMechanism", "TurnToOpenMechanism",
    "fixed_direction", "infeasible", "make_mechanism",
]  # fmt: skip
