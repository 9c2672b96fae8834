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

_PLOT_FORMATS = (".png", ".pdf", ".svg")


def check_plot(path: Path | None) -> None:
    """Raises `ConfigurationError` for a file name with an unknown picture format."""
    if path is not None and path.suffix.lower() not in _PLOT_FORMATS:
        raise ConfigurationError(
            "Unknown kind of picture.", got=path, allowed=", ".join(_PLOT_FORMATS), hint="curve.png"
        )


def print_result(as_json: bool, values: Mapping[str, Any], text: str) -> None:
    """Prints one JSON object (paths as text) or a text."""
    print(json.dumps(values, default=str) if as_json else text)
