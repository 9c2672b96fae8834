"""Failed tries of an optimal strategy that does not know the hidden state."""

from __future__ import annotations

from collections.abc import Collection

from lerobot_adamanip.mechanisms.table import fixed_direction

BEST_TRIES = {"locked": (1.0, 1), "direction": (0.5, 1), "mode": (1.0, 2)}
"""Hidden value -> failed tries of an optimal blind strategy, expected and at worst. It pulls at a locked door once,
because that is cheaper than turning the key. It turns the wrong way half of the time, and tries three modes in
sequence. How far a key turns costs nothing: a turn to its stop is one try, which succeeds."""


def best_tries(category: str, mechanism_rules: str, hidden: Collection[str]) -> tuple[float, int]:
    """Returns the failed tries of an optimal blind strategy, expected and at worst.

    Args:
        category: category of the object.
        mechanism_rules: see `MECHANISM_RULES`.
        hidden: names of the hidden values.
    """
    known = {"direction"} if fixed_direction(category, mechanism_rules) else set()
    tries = [each for name, each in BEST_TRIES.items() if name in hidden and name not in known]
    return sum(expected for expected, _ in tries), sum(worst for _, worst in tries)
