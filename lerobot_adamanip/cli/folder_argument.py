"""The folder of a dataset as every command takes it: first, as DIR, or as --root DIR."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, get_origin, get_type_hints

_OPTION = "--root"


def folder_first(command: type[object], options: Sequence[str]) -> list[str]:
    """Returns the options with ``--root DIR`` moved to the front as DIR, for commands that take such a folder.

    Args:
        command: dataclass of its options; ``root``, if it has any, is positional.
        options: as typed.
    """
    words = list(options)
    if get_origin(get_type_hints(command, include_extras=True).get("root")) is not Annotated:
        return words
    for place, word in enumerate(words):
        if word == _OPTION and place + 1 < len(words):
            return [words[place + 1], *words[:place], *words[place + 2 :]]
        if word.startswith(f"{_OPTION}="):
            return [word.partition("=")[2], *words[:place], *words[place + 1 :]]
    return words
