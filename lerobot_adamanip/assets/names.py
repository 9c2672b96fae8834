"""Ids of external assets, ``safe:sa1``: a category and the name of a folder, as a user sees both."""

from __future__ import annotations

import re
import unicodedata

from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

MAX_NAME_BYTES = 100
"""An id is part of a file's name, and has to stay shorter than a dataset's limit for ids."""
_ALLOWED = "letters, digits, spaces and _ . + -, no dot or space first, no space last"


def is_asset_id(identifier: str) -> bool:
    """Whether an id names an external asset (``safe:sa1``) rather than a generated one (``safe_001``)."""
    return ":" in identifier


def asset_id(category: str, name: str) -> str:
    """Returns ``safe:sa1`` for ("safe", "sa1")."""
    return f"{require_choice('category', category, ROLES)}:{_checked_name(name)}"


def parse_asset_id(identifier: str) -> tuple[str, str]:
    """Returns ("safe", "sa1") for ``safe:sa1``; raises `ConfigurationError` for anything else."""
    category, colon, name = identifier.partition(":")
    if not colon or category not in ROLES:
        raise ConfigurationError(
            "Unknown object id.",
            got=repr(identifier),
            allowed=f"<category>:<folder>, category one of {', '.join(ROLES)}",
            hint="safe:sa1, with --env.assets=DIR and DIR/safe/sa1/mobility.urdf",
        )
    return category, _checked_name(name)


def name_problem(name: str) -> str:
    """Returns why a folder with this name cannot be an object; an empty text if it can.

    Separators of paths, ids and selections are refused: an id can be a file's name, and cannot leave its directory.
    """
    if wrong := dict.fromkeys(re.findall(r"[^\w.+ -]", name)):
        listed = ", ".join(_character(each) for each in list(wrong)[:5])
        return f"a folder with this name cannot be an object (has {listed}): rename the folder"
    if len(name.encode()) > MAX_NAME_BYTES:
        return f"a folder with so long a name cannot be an object (over {MAX_NAME_BYTES} bytes): rename the folder"
    if not re.fullmatch(r"[\w+-]([\w.+ -]*[\w.+-])?", name):
        return f"a folder with this name cannot be an object ({name!r}: {_ALLOWED}): rename the folder"
    return ""


def shown_name(name: str) -> str:
    """Returns a folder's name for messages: what cannot be printed is escaped."""
    return "".join(each if each.isprintable() else _escaped(each) for each in name)


def _character(each: str) -> str:
    """A character that a user can recognize, even if it is drawn into the letter before it."""
    if each.isascii() and each.isprintable():
        return repr(each)
    return f"U+{ord(each):04X} {unicodedata.name(each, '')}".rstrip()


def _escaped(each: str) -> str:
    return each.encode("unicode_escape", "surrogatepass").decode("ascii")


def _checked_name(name: str) -> str:
    if problem := name_problem(name):
        raise ConfigurationError(
            "A folder with this name cannot be an object.",
            got=f"{shown_name(name)!r}: {problem}",
            allowed=f"{_ALLOWED}, {MAX_NAME_BYTES} bytes at most",
            hint="rename the folder",
        )
    return name
