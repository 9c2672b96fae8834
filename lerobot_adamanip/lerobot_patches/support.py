"""What patches share: replacing an attribute of LeRobot, and setting back what was there."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

_replaced: list[tuple[Any, str, Any]] = []


class UnsupportedError(Exception):
    """A patch does not fit this LeRobot; the message says why."""


def loaded(name: str) -> ModuleType | None:
    """Returns a module of LeRobot if it is loaded, also where it is run as a program."""
    main = sys.modules.get("__main__")
    # An embedded interpreter may have no module of that name, or one without a specification.
    if getattr(getattr(main, "__spec__", None), "name", None) == name:
        return main
    return sys.modules.get(name)


def replace(owner: Any, name: str, value: Any) -> None:
    """Sets an attribute of a module or class of LeRobot."""
    _replaced.append((owner, name, vars(owner)[name]))
    setattr(owner, name, value)


def count() -> int:
    """Returns how many attributes are replaced."""
    return len(_replaced)


def restore(but: int = 0) -> None:
    """Sets back all attributes but the first so many that were replaced, the latest first."""
    while len(_replaced) > but:
        setattr(*_replaced.pop())
