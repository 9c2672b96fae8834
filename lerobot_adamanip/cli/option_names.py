"""Checks command-line options. The error for an unknown option suggests the nearest known name."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from lerobot_adamanip.util.errors import ConfigurationError, listed, nearest, require_choice


def check_options(command: str, options: type[Any], arguments: Sequence[str]) -> None:
    """Raises `ConfigurationError` for an unknown option or an invalid choice.

    Args:
        command: name of the subcommand.
        options: class of the subcommand, a dataclass whose fields are the options.
        arguments: as typed, after the subcommand.
    """
    known, lists, given = dict(_options(options)), set(_lists(options)), set[str]()
    for place, argument in enumerate(arguments):
        if not argument.startswith("--") or argument in ("--", "--help"):
            continue
        typed, equals, value = argument.partition("=")
        name = typed.replace("_", "-")
        if name not in known:
            near = nearest(typed, known)
            hint = f"did you mean {near}?" if near else f"adamanip {command} --help"
            what = f"Unknown option of `adamanip {command}`."
            raise ConfigurationError(what, got=typed, allowed=listed(sorted(known)), hint=hint)
        if name in given & lists:
            raise ConfigurationError(
                f"{name} of `adamanip {command}` is given twice: its first values would be lost.",
                got=f"{name} ... {name} ...",
                allowed="all values after one of them",
                hint=f"{name} FIRST SECOND",
            )
        given.add(name)
        if choices := known[name]:
            value = value if equals else "".join(arguments[place + 1 : place + 2])
            require_choice(f"value of {name}", value, choices)


def _options(options: type[Any]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yields the name of each option as typed and its choices. Options with free values have no choices."""
    from tyro.conf import Positional

    positional = get_args(Positional[int])[1]
    hints = get_type_hints(options, include_extras=True)
    for field in dataclasses.fields(options):
        kind, name = hints[field.name], field.name
        notes = getattr(kind, "__metadata__", ())
        if positional in notes:
            continue
        for note in notes:
            name = getattr(note, "name", None) or name
            kind = get_args(kind)[0]
        choices = get_args(kind) if get_origin(kind) is Literal else ()
        yield f"--{'no-' if field.default is True else ''}{name.replace('_', '-')}", choices


def _lists(options: type[Any]) -> Iterator[str]:
    """Yields the options that take several values at once, and may be given only once."""
    from tyro.conf import UseAppendAction

    appends = get_args(UseAppendAction[int])[1]
    for name, kind in get_type_hints(options, include_extras=True).items():
        notes, plain = getattr(kind, "__metadata__", ()), get_args(kind)[0] if get_origin(kind) is Annotated else kind
        if get_origin(plain) is tuple and appends not in notes:
            yield f"--{name.replace('_', '-')}"


_OWN = {"observe_cloud=true": "--cloud", "observe_effort=true": "--effort", "observe_images=false": "--no-images"}
"""Options of LeRobot's commands -> those of `adamanip collect` with other names."""


def in_own_words(message: str, command: Any) -> str:
    """Returns a message with the options of LeRobot's commands, such as ``--env.fps=10``, as this command has them."""
    names = {field.name for field in dataclasses.fields(command)}

    def own(match: re.Match[str]) -> str:
        name, value = match[1], match[2].strip("'[]").replace(",", " ") if "[" in match[2] else match[2]
        if name == "type" and value.startswith("adamanip_"):
            name, value = "category", value.removeprefix("adamanip_")
        option = _OWN.get(f"{name}={value}", f"--{name.replace('_', '-')}" + (f" {value}" if value != "true" else ""))
        return option if option.split()[0][2:].replace("-", "_") in names else match[0]

    return re.sub(r"--env\.(\w+)=('[^']*'|[\w.,:-]+)", own, message)


def unreadable_options(command: str, printed: str) -> ConfigurationError:
    """Returns the error for options that tyro refuses, from the box that tyro prints.

    Below its title, the first section of the box is the reason. A second one may describe the option. The terminal's
    encoding decides which characters the box is drawn with.
    """
    sections: list[list[str]] = [[]]
    for line in printed.splitlines()[1:]:
        text = line.strip("│|╭╰╮╯+ ")
        if set(text) <= set("─-"):
            sections.append([])
        elif not line[1:10].isspace():  # deeper lines are the help of missing options
            sections[-1].append(text)
    reason, *described = [section for section in sections if section] or [[printed.strip()]]
    return ConfigurationError(
        f"The options of `adamanip {command}` cannot be read.",
        got=" ".join(reason),
        allowed=" ".join(described[0][1:]) if len(described) > 1 else "the options and arguments of --help",
        hint=f"adamanip {command} --help",
    )
