"""Hidden state as pure functions: the rules of each category, and their presets.

`MECHANISM_RULES` names the presets; docs/differences.md gives the source of each.
"""

from __future__ import annotations

from lerobot_adamanip.mechanisms.base import Limits, Mechanism, Overrides, Positions
from lerobot_adamanip.mechanisms.best_tries import best_tries
from lerobot_adamanip.mechanisms.composed import ChangingMechanism, RowMechanism
from lerobot_adamanip.mechanisms.families import (
    LampMechanism,
    MicrowaveMechanism,
    SafeMechanism,
    TurnToOpenMechanism,
)
from lerobot_adamanip.mechanisms.table import (
    DEFAULT_MECHANISM_RULES,
    LIFTED,
    MECHANISM_RULES,
    RULES,
    CategoryRules,
    categories_with,
    fixed_direction,
    infeasible,
    make_mechanism,
    require_rules,
    rules_of,
)

__all__ = [
    "DEFAULT_MECHANISM_RULES", "LIFTED", "MECHANISM_RULES", "RULES", "CategoryRules", "ChangingMechanism",
    "LampMechanism", "Limits", "Mechanism", "MicrowaveMechanism", "Overrides", "Positions", "RowMechanism",
    "SafeMechanism", "TurnToOpenMechanism", "best_tries", "categories_with", "fixed_direction", "infeasible",
    "make_mechanism", "require_rules", "rules_of",
]  # fmt: skip
