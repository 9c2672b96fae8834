"""Failed tries of an optimal strategy that does not know the hidden state."""

from __future__ import annotations

from collections.abc import Collection

from lerobot_adamanip.mechanisms.table import fixed_direction

BEST_TRIES = {"locked": (1.0, 1), "direction": (0.5, 1), "mode": (1.0, 2)}
"""Hidden value -> failed tries of an optimal blind strategy, expected and at worst. It pulls at a locked door once,
because that is cheaper than turning the key. It turns the wrong way half of the time, and tries three modes in
sequence. How far a key turns costs nothing: a turn to its stop is one try, which succeeds."""
COMPOSED_TRIES = {
    "row": {"direction": (0.5, 1), "second_pulls": (0.75, 1)},
    "row of a sprung key": {"direction": (0.5, 1), "second_pulls": (0.25, 1)},
    "changing": {"direction": (0.5, 1), "relocks": (0.5, 1)},
}
"""The same for the rules of these names; a test computes them. In a row the second and the third lock cost one failed
try at worst together: the strategy moves the key first, and if that is blocked the pull goes on to the end or to a
notch, which costs nothing. A lock that shuts again costs the pull that shuts it. Its key is then turned back and on:
whether it goes on, or has to be turned out again, is felt in a try that has moved it."""
SPRUNG = ("window", "door")
"""Categories whose key springs back when it is let go, if no lock keeps it: that shows the second lock of a row."""


def best_tries(category: str, mechanism_rules: str, hidden: Collection[str]) -> tuple[float, int]:
    """Returns the failed tries of an optimal blind strategy, expected and at worst.

    Args:
        category: category of the object.
        mechanism_rules: see `MECHANISM_RULES`.
        hidden: names of the hidden values.
    """
    known = {"direction"} if fixed_direction(category, mechanism_rules) else set()
    sprung = " of a sprung key" if mechanism_rules == "row" and category in SPRUNG else ""
    table = COMPOSED_TRIES.get(f"{mechanism_rules}{sprung}", BEST_TRIES)
    tries = [each for name, each in table.items() if name in hidden and name not in known]
    return sum(expected for expected, _ in tries), sum(worst for _, worst in tries)
