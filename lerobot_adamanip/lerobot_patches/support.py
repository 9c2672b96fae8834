"""What patches share: replacing an attribute of LeRobot, and setting back what was there."""

from __future__ import annotations

import logging
import os
import sys
from types import ModuleType
from typing import Any

NO_PATCHES = "ADAMANIP_NO_PATCHES"
"""Environment variable: set to 1, LeRobot stays as it is."""
_log = logging.getLogger(__name__)
_replaced: list[tuple[Any, str, Any]] = []
_warned: set[str] = set()


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


def are_off(loss: str) -> bool:
    """Whether `NO_PATCHES` is set; then one line in the log says what a user loses."""
    off = os.environ.get(NO_PATCHES, "") not in ("", "0")
    if off:
        warn_once(f"{NO_PATCHES} is set, so LeRobot stays as it is. {loss}")
    return off


def warn_once(line: str) -> None:
    """Logs a warning, once per process."""
    if line not in _warned:
        _warned.add(line)
        _log.warning(line)
