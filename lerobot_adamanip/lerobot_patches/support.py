"""Shared code of the patches: replaces attributes of LeRobot and restores them."""

from __future__ import annotations

import logging
import os
import sys
from types import ModuleType
from typing import Any

NO_PATCHES = "ADAMANIP_NO_PATCHES"
"""Environment variable. Set to 1, it turns all patches off."""
_log = logging.getLogger(__name__)
_replaced: list[tuple[Any, str, Any]] = []
_warned: set[str] = set()
_ABSENT = object()


class UnsupportedError(Exception):
    """A patch does not fit this LeRobot. The message gives the reason."""


def loaded(name: str) -> ModuleType | None:
    """Returns a LeRobot module if it is loaded, also if it runs as the main program."""
    main = sys.modules.get("__main__")
    # an embedded interpreter may have no main module, or one without a specification
    if getattr(getattr(main, "__spec__", None), "name", None) == name:
        return main
    return sys.modules.get(name)


def replace(owner: Any, name: str, value: Any) -> None:
    """Sets an attribute of a module or class of LeRobot, also one that it lacks."""
    _replaced.append((owner, name, vars(owner).get(name, _ABSENT)))
    setattr(owner, name, value)


def count() -> int:
    """Returns the number of replaced attributes."""
    return len(_replaced)


def restore(but: int = 0) -> None:
    """Restores replaced attributes, the latest first, except the first ``but`` ones."""
    while len(_replaced) > but:
        owner, name, value = _replaced.pop()
        if value is not _ABSENT:
            setattr(owner, name, value)
        elif name in vars(owner):
            delattr(owner, name)


def are_off(loss: str) -> bool:
    """Returns whether `NO_PATCHES` is set. If so, logs ``loss`` once."""
    off = os.environ.get(NO_PATCHES, "") not in ("", "0")
    if off:
        warn_once(f"{NO_PATCHES} is set, so LeRobot stays unpatched. {loss}")
    return off


def warn_once(line: str) -> None:
    """Logs a warning once per process."""
    if line not in _warned:
        _warned.add(line)
        _log.warning(line)
