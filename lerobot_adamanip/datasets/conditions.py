"""Conditions on episodes: ``failed_tries>=1``, ``object_id=safe_000,safe_003``. They are parsed, not executed."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lerobot_adamanip.util.errors import ConfigurationError, listed, nearest

Value = bool | int | float | str
Facts = Mapping[str, Value | None]
"""An episode's values by name; None if unknown."""
_ORDERED: Mapping[str, Callable[[Any, Any], bool]] = {
    ">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt,
}  # fmt: skip
_GRAMMAR = re.compile(r"\s*([A-Za-z_][\w.]*)\s*(==|!=|>=|<=|=|>|<)\s*(.*?)\s*", re.DOTALL)
_WORDS = {"true": True, "false": False}


@dataclass(frozen=True)
class Condition:
    """Comparison of one column, by ``=``, ``!=``, ``<``, ``<=``, ``>`` or ``>=``."""

    column: str
    operation: str
    values: tuple[Value, ...]
    """Values to compare with; ``=`` holds if any is equal, ``!=`` if none is."""
    ranges: tuple[tuple[int, int], ...] = ()
    """Ranges of whole numbers for ``=`` and ``!=``: first, end (excluded)."""

    def holds(self, facts: Facts) -> bool:
        """Returns whether an episode fulfils the condition; unknown values never do."""
        found: Any = facts[self.column]
        if found is None:
            return False
        if any(isinstance(value, str) for value in self.values):
            found = as_text(found)
        if self.operation in _ORDERED:
            return _ORDERED[self.operation](found, self.values[0])
        equal = found in self.values or any(first <= found < end for first, end in self.ranges)
        return equal is (self.operation == "=")


def parse_condition(text: str, facts: Sequence[Facts]) -> Condition:
    """Parses a condition on episodes with these values.

    Its form is COLUMN OPERATION VALUE. For ``=`` and ``!=`` several values may follow, separated by commas; whole
    numbers may be ranges like ``0:10`` (10 excluded).

    Raises:
        ConfigurationError: the form, the column or the type of a value is wrong.
    """
    match = _GRAMMAR.fullmatch(text)
    if match is None or not match[3]:
        raise ConfigurationError(
            "The condition has a wrong form.",
            got=repr(text),
            allowed="COLUMN OPERATION VALUE, operation one of =, !=, <, <=, >, >=",
            hint="--where 'failed_tries>=1'",
        )
    column, operation, value = match[1], match[2].replace("==", "="), match[3]
    kind = _kind(column, operation + value, facts)
    if operation in _ORDERED:
        if kind in (bool, str):
            raise _unfit(text, column, facts, f"= or !=, since {column} is no number")
        return Condition(column, operation, (_value(text, column, kind, value, facts),))
    ranges, values = [], []
    for word in (part.strip() for part in value.split(",")):
        if kind is int and (found := re.fullmatch(r"(-?\d+):(-?\d+)", word)):
            ranges.append((int(found[1]), int(found[2])))
        else:
            values.append(_value(text, column, kind, word, facts))
    return Condition(column, operation, tuple(values), tuple(ranges))


def choose(conditions: Sequence[str], facts: Sequence[Facts]) -> list[int]:
    """Returns the indices of the episodes that fulfil all conditions; raises `ConfigurationError` if there are none."""
    parsed = [parse_condition(text, facts) for text in conditions]
    chosen = [number for number, each in enumerate(facts) if all(one.holds(each) for one in parsed)]
    if not chosen:
        columns = dict.fromkeys(one.column for one in parsed)
        raise ConfigurationError(
            "No episode fulfils the conditions.",
            got=" and ".join(conditions),
            allowed="; ".join(f"{column}: {_range(column, facts)}" for column in columns),
            hint="a less strict condition",
        )
    return chosen


def _kind(column: str, rest: str, facts: Sequence[Facts]) -> type:
    kinds = {type(each[column]) for each in facts if each.get(column) is not None}
    if not kinds:
        names = sorted({name for each in facts for name, value in each.items() if value is not None})
        word = column.lower()
        begun = (name for name in names if name.startswith(word) or name.rpartition(".")[2].startswith(word))
        near = next(begun, None) or nearest(word, names)
        hint = f"--where '{near}{rest}'" if near else "--where 'success=true'"
        raise ConfigurationError("Episodes lack this column.", got=repr(column), allowed=", ".join(names), hint=hint)
    if len(kinds) == 1:
        return kinds.pop()
    # Merged datasets may store a value as true and as 1, or as a number and as text.
    return str if str in kinds else float


def _value(text: str, column: str, kind: type, word: str, facts: Sequence[Facts]) -> Value:
    try:
        if kind is bool:
            return _WORDS[word.lower()]
        if kind is float and word.lower() in _WORDS:
            return _WORDS[word.lower()]
        return float(word) if kind is int and re.fullmatch(r"-?\d+\.\d*", word) else kind(word)
    except (KeyError, ValueError):
        raise _unfit(text, column, facts, _range(column, facts)) from None


def as_text(value: Value) -> str:
    """Returns a value as it is typed in a condition."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _unfit(text: str, column: str, facts: Sequence[Facts], allowed: str) -> ConfigurationError:
    shown = as_text(next(value for each in facts if (value := each[column]) is not None))
    return ConfigurationError(
        "The condition does not fit its column.", got=repr(text), allowed=allowed, hint=f"--where '{column}={shown}'"
    )


def _range(column: str, facts: Sequence[Facts]) -> str:
    """Returns the values of a column as text."""
    values: list[Any] = [each[column] for each in facts if each[column] is not None]
    if all(isinstance(value, bool) for value in values):
        return "true or false" if len(set(values)) == 2 else f"always {str(values[0]).lower()}"
    if all(isinstance(value, int | float) for value in values):
        return f"{min(values):g} to {max(values):g}"
    return listed(sorted({as_text(value) for value in values}))
