"""Options of a command line that its subcommand does not know: refused with the name that it may mean."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin, get_type_hints

from lerobot_adamanip.util.errors import ConfigurationError, listed, nearest, require_choice

FORMER: Mapping[str, Mapping[str, str]] = {
    "collect": {
        "--root": "DIR",
        "--mechanism-preset": "--mechanism-rules",
        "--expert-preset": "--expert-strategy",
        "--pose-preset": "--poses",
    },
    "replay": {"--root": "DIR", "--video": "--out"},
    "stats": {"--plot": "--out"},
    "view": {"--image": "--out", "--save": "--out"},
    "objects": {"--sheet": "--out"},
    "report": {"--plot": "--out", "--result": "--out"},
    "calibrate": {"--output": "--out"},
}
"""Subcommand -> former name of an option -> its name now; DIR is the first argument."""


def check_options(command: str, options: type[Any], arguments: Sequence[str]) -> None:
    """Raises `ConfigurationError` for an option that does not exist, or has a value that is not among its choices.

    Args:
        command: name of the subcommand.
        options: its class, a dataclass whose fields are the options.
        arguments: as typed, after the subcommand.
    """
    known = dict(_options(options))
    for place, argument in enumerate(arguments):
        if not argument.startswith("--") or argument in ("--", "--help"):
            continue
        typed, equals, value = argument.partition("=")
        name = typed.replace("_", "-")
        if name not in known:
            raise _unknown(command, typed, known)
        if choices := known[name]:
            given = value if equals else "".join(arguments[place + 1 : place + 2])
            require_choice(f"value of {name}", given, choices)


def _unknown(command: str, typed: str, known: Mapping[str, tuple[str, ...]]) -> ConfigurationError:
    name = FORMER.get(command, {}).get(typed.replace("_", "-"))
    if name is not None:
        use = f"adamanip {command} {name if name == 'DIR' else f'... {name}'}"
        said = f"{typed} of `adamanip {command}` is {'the first argument' if name == 'DIR' else name} now."
        return ConfigurationError(said, got=typed, allowed=name, hint=use)
    near = nearest(typed, known)
    return ConfigurationError(
        f"Unknown option of `adamanip {command}`.",
        got=typed,
        allowed=listed(sorted(known)),
        hint=f"did you mean {near}?" if near else f"adamanip {command} --help",
    )


def _options(options: type[Any]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yields each option as it is typed, and the values it can have, empty where they are not a few words."""
    from tyro.conf import Positional

    place = get_args(Positional[int])[1]
    hints = get_type_hints(options, include_extras=True)
    for field in dataclasses.fields(options):
        kind, renamed = hints[field.name], None
        notes = getattr(kind, "__metadata__", ())
        if place in notes:
            continue
        for note in notes:
            renamed = getattr(note, "name", None) or renamed
            kind = get_args(kind)[0]
        name = (renamed or field.name).replace("_", "-")
        choices = get_args(kind) if get_origin(kind) is Literal else ()
        yield f"--{'no-' if field.default is True else ''}{name}", choices
