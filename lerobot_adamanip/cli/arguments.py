"""Arguments shared by several commands, and printing of results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import tyro

from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.util.errors import ConfigurationError

DatasetFolder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
DatasetFolders = Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DIR [DIR ...]")]
if TYPE_CHECKING:
    Category: TypeAlias = str
    CategoryOrAll: TypeAlias = str
else:
    Category = Literal[tuple(CATEGORIES)]
    CategoryOrAll = Literal[(*CATEGORIES, ALL)]


def require_suffix(path: Path, allowed: tuple[str, ...], hint: str) -> None:
    """Raises `ConfigurationError` for a file name with another ending than the allowed ones, in any case."""
    if path.suffix.lower() not in allowed:
        raise ConfigurationError("Unknown kind of file.", got=path, allowed=", ".join(allowed), hint=hint)


def print_result(as_json: bool, values: Mapping[str, Any], text: str) -> None:
    """Prints one JSON object (paths as text) or a text."""
    print(json.dumps(values, default=str) if as_json else text)
