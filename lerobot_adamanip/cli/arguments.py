"""Arguments shared by several commands, and printing of results."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
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


def require_effects(command: Any, idle: Mapping[str, Sequence[str]]) -> None:
    """Raises `ConfigurationError` for a chosen option of a command that would have no effect.

    Args:
        command: the dataclass of the options.
        idle: where they have one, as an error says it, -> names of options without one here.
    """
    defaults = {item.name: item.default for item in fields(command)}
    for allowed, names in idle.items():
        for option in (f"--{name.replace('_', '-')}" for name in names if getattr(command, name) != defaults[name]):
            raise _no_effect(option, option, f"{option} {allowed}")


def require_expert_options(expert: str, trials: int, strategy: str, rules: str) -> None:
    """Raises `ConfigurationError` for options of the adaptive expert that it, or another expert, would ignore."""
    from lerobot_adamanip.mechanisms.table import COMPOSED  # with NumPy, which not every command needs

    is_composed = rules in COMPOSED
    idle = {
        "--trials": trials != 1 and (expert != "adaptive" or is_composed),
        "--expert-strategy": strategy == "upstream" and is_composed,
    }
    for option in (name for name, is_idle in idle.items() if is_idle):
        got = f"{option} with --expert {expert} --mechanism-rules {rules}"
        allowed = f"{option} with --expert adaptive and other mechanism rules than {', '.join(COMPOSED)}"
        raise _no_effect(option, got, allowed)


def _no_effect(option: str, got: str, allowed: str) -> ConfigurationError:
    return ConfigurationError("An option has no effect here.", got=got, allowed=allowed, hint=f"leave out {option}")


def print_result(as_json: bool, values: Mapping[str, Any], text: str) -> None:
    """Prints one JSON object (paths as text, numbers that are not finite as null) or a text."""
    print(json.dumps(_finite(values), default=str, allow_nan=False) if as_json else text)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
