"""Strict parsing of untrusted JSON: every field is checked, with one clear error.

No value read here is imported, called or used as a path.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

MAX_BYTES = 8_000_000
"""Larger than any file of this project."""

Check = Callable[[str, object], Any]
"""Check of a field: takes name and value; returns the value or raises ValueError that names the field."""


def parse(content: str | bytes, max_bytes: int = MAX_BYTES) -> Any:
    """Parses JSON text; raises ValueError if it is too large or too deep, or has NaN or a duplicate key."""
    if len(content) > max_bytes:
        raise ValueError(f"{len(content)} bytes, more than {max_bytes}")
    try:
        return json.loads(content, object_pairs_hook=_unique_keys, parse_constant=_refuse_constant)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def read(path: Path, max_bytes: int = MAX_BYTES) -> Any:
    """Parses a file; raises OSError or ValueError."""
    with open(path, "rb") as file:
        return parse(file.read(max_bytes + 1), max_bytes)


def _check(is_right: Callable[[Any], object], expected: str) -> Check:
    def check(name: str, value: object) -> Any:
        if not is_right(value):
            raise _wrong(name, value, expected)
        return value

    return check


def integer(lowest: int, highest: int) -> Check:
    """Returns a check for a whole number from ``lowest`` to ``highest``."""
    return _check(
        lambda value: isinstance(value, int) and not isinstance(value, bool) and lowest <= value <= highest,
        f"a whole number, {lowest} ... {highest}",
    )


def number(lowest: float, highest: float) -> Check:
    """Returns a check for a finite number from ``lowest`` to ``highest``."""

    def is_right(value: Any) -> bool:
        plain = isinstance(value, int | float) and not isinstance(value, bool)
        return plain and lowest <= value <= highest and math.isfinite(value)

    return _check(is_right, f"a number, {lowest:g} ... {highest:g}")


flag = _check(lambda value: isinstance(value, bool), "true or false")
"""Checks for true or false."""


def choice(choices: Collection[str]) -> Check:
    """Returns a check for one of several words."""
    return _check(lambda value: isinstance(value, str) and value in choices, " | ".join(choices))


def text(pattern: str, meaning: str) -> Check:
    """Returns a check for text that matches a pattern completely."""
    return _check(lambda value: isinstance(value, str) and re.fullmatch(pattern, value), meaning)


def listing(each: Check, lowest: int, highest: int) -> Check:
    """Returns a check for a list of ``lowest`` to ``highest`` entries; it returns a tuple."""

    def check(name: str, value: object) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or not lowest <= len(value) <= highest:
            raise _wrong(name, value, f"a list of {lowest} ... {highest} entries")
        return tuple(each(f"{name}[{place}]", entry) for place, entry in enumerate(value))

    return check


def mapping(key: Check, each: Check, highest: int) -> Check:
    """Returns a check for a mapping with at most ``highest`` entries."""

    def check(name: str, value: object) -> dict[str, Any]:
        if not isinstance(value, Mapping) or len(value) > highest:
            raise _wrong(name, value, f"at most {highest} named values")
        return {key(f"a name in {name}", known): each(f"{name}.{known}", entry) for known, entry in value.items()}

    return check


def table(checks: Mapping[str, Check], ignored: Collection[str] = ()) -> Check:
    """Returns a check for exactly these fields; ``ignored`` ones are optional and not checked."""

    def check(name: str, value: object) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise _wrong(name, value, "named fields")
        if unknown := sorted(map(str, set(value) - set(checks) - set(ignored))):
            raise ValueError(f"{name} has an unknown field {reprlib.repr(unknown[0])}; known are {', '.join(checks)}")
        if missing := [field for field in checks if field not in value]:
            raise ValueError(f"{name} lacks {', '.join(missing)}")
        return {field: each(field, value[field]) for field, each in checks.items()}

    return check


def some(checks: Mapping[str, Check]) -> Check:
    """Returns a check of these fields of a mapping, null where one is missing; others are kept as they are."""

    def check(name: str, value: object) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise _wrong(name, value, "a JSON object")
        return {**value, **{field: each(f"{name}.{field}", value.get(field)) for field, each in checks.items()}}

    return check


def record[Made](kind: type[Made]) -> Callable[[str, object], Made]:
    """Returns a check that parses a dataclass; each field is annotated with its own check.

    Fields with a default are optional. Fields without a check must be missing.
    """
    hints = get_type_hints(kind, include_extras=True)
    checks = {name: hint.__metadata__[0] for name, hint in hints.items() if get_origin(hint) is Annotated}
    defaults = {}
    for item in fields(kind):  # type: ignore[arg-type]
        if item.name in checks and item.default is not MISSING:
            defaults[item.name] = item.default
        elif item.name in checks and item.default_factory is not MISSING:
            defaults[item.name] = item.default_factory()
    inner = table(checks)

    def check(name: str, value: object) -> Made:
        return kind(**inner(name, {**defaults, **value} if isinstance(value, Mapping) else value))

    return check


def optional(each: Check) -> Check:
    """Returns a check that also accepts null."""
    return lambda name, value: None if value is None else each(name, value)


def either(*checks: Check) -> Check:
    """Returns a check that accepts the values of any of several."""

    def check(name: str, value: object) -> Any:
        expected = []
        for each in checks:
            try:
                return each(name, value)
            except ValueError as error:
                expected.append(str(error).rpartition(", not ")[2])
        raise _wrong(name, value, " or ".join(expected))

    return check


def _wrong(name: str, value: object, expected: str) -> ValueError:
    return ValueError(f"{name} is {reprlib.repr(value)}, not {expected}")


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a name occurs twice")
    return content


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")
