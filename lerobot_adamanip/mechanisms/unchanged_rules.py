"""Categories in which a set of mechanism rules changes nothing."""

from __future__ import annotations

from collections.abc import Iterable

from lerobot_adamanip.mechanisms.table import COMPOSED, DEFAULT_MECHANISM_RULES, RULES, fixed_direction

_UPSTREAM = ("safe",)
"""Categories in which upstream's code differs from the paper's text; a test compares the mechanisms."""


def changed_categories(rules: str) -> tuple[str, ...]:
    """Returns the categories in which ``rules`` differ from the default ones."""
    if rules == "upstream":
        return _UPSTREAM
    if rules in COMPOSED:
        return tuple(COMPOSED[rules])
    return tuple(name for name in RULES if fixed_direction(name, rules) != fixed_direction(name))


def unchanged_rules(categories: Iterable[str], rules: str) -> str | None:
    """Returns a line naming the categories in which ``rules`` change nothing; None if there are none."""
    changed = changed_categories(rules)
    same = [name for name in dict.fromkeys(categories) if name not in changed]
    if rules == DEFAULT_MECHANISM_RULES or not same:
        return None
    return (
        f"The mechanism rules {rules} are the {DEFAULT_MECHANISM_RULES} rules for {', '.join(same)}. "
        f"They change {', '.join(changed)} only."
    )
