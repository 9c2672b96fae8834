"""Errors that users can fix: what is wrong, what was given, what is allowed, what to try."""

from __future__ import annotations

import contextlib
import difflib
import numbers
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

MOST_LISTED = 10
"""Maximum number of items that a message lists."""

GET_PICTURES = "bash scripts/setup_vulkan.sh in a checkout installs Mesa, adamanip doctor shows what is missing"
"""How to get a Vulkan device."""
INSTALL_SIM = "pip install '.[sim]' in a checkout"
"""How to get the simulator."""


class AdaManipError(Exception):
    """Base of the errors that this project raises on purpose.

    Args:
        what: problem in one sentence; without the other arguments it is the whole message. An error is given here by
            Gymnasium, which makes another one of the same type from that of a worker.
        got: given value.
        allowed: allowed values.
        hint: command or keyword to try.
    """

    def __init__(self, what: object, *, got: object = None, allowed: object = None, hint: object = None) -> None:
        facts = (("got", got), ("allowed", allowed), ("try", hint))
        lines = [f"  {name + ':':<8} {value}" for name, value in facts] if allowed is not None else []
        super().__init__("\n".join([str(what), *lines]))


class ConfigurationError(AdaManipError, ValueError):
    """Invalid value of an argument or option."""


class DatasetError(AdaManipError, RuntimeError):
    """Missing, incomplete or unexpected dataset."""


class SimulatorError(AdaManipError, RuntimeError):
    """Simulator not usable: missing packages, or no Vulkan device for rendering."""


class RobotError(AdaManipError, RuntimeError):
    """Failure of the arm, its connection, a camera or a teleoperator; the arm was stopped."""


class UnreachableError(AdaManipError, RuntimeError):
    """No layout or pose within the arm's reach. ``is_certain``: for this object, every other seed fails too."""

    is_certain = False


@contextlib.contextmanager
def shown_by_parsers() -> Iterator[None]:
    """Turns a `ConfigurationError` into an `AdaManipError` of the same text.

    For constructors that draccus calls, because draccus replaces the message of any `ValueError`.
    """
    try:
        yield
    except ConfigurationError as error:
        raise AdaManipError(str(error)) from None


def require_choice(what: str, got: str, choices: Iterable[str], *, hint: str | None = None) -> str:
    """Returns ``got`` if it is one of ``choices``; otherwise raises `ConfigurationError`.

    The error suggests the choice most similar to ``got``, otherwise ``hint``, otherwise the first choice.
    """
    names = sorted(choices)
    if got in names:
        return got
    near = nearest(str(got), names)  # a key of a mapping may have any type
    advice = f"did you mean {near}?" if near else hint or (names[0] if names else None)
    raise ConfigurationError(f"Unknown {what}.", got=repr(got), allowed=listed(names), hint=advice)


def require_types(instance: Any, prefix: str = "") -> None:
    """Replaces the values of a dataclass by equal ones of the annotated types: a list by a tuple, NumPy's numbers.

    Args:
        instance: the dataclass. Dataclasses in it are checked too.
        prefix: what its fields are called in errors, before their names.

    Raises:
        ConfigurationError: a value has another type. ``"false"`` is no bool, True no number, and 10.0 no int.
    """
    annotations = get_type_hints(type(instance))
    for item in fields(instance):
        name, value, annotation = prefix + item.name, getattr(instance, item.name), annotations[item.name]
        if value is item.default:  # None stands for a value that is set later
            continue
        try:
            object.__setattr__(instance, item.name, _converted(value, annotation))
        except (TypeError, OverflowError):  # a whole number may be too large for a float
            allowed = annotation.__name__ if isinstance(annotation, type) else annotation
            raise ConfigurationError(
                f"Wrong type of {name}.",
                got=f"{value!r:.80} ({type(value).__name__})",
                allowed=str(allowed).replace("collections.abc.", "").replace("typing.", ""),
                hint=f"{name}={item.default!r}",
            ) from None
        if is_dataclass(value):
            require_types(value, f"{name}.")


def _converted(value: Any, annotation: Any) -> Any:
    """Returns the value as the annotation has it; raises TypeError."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if annotation is Any:
        return value
    if origin in (Union, UnionType):
        for part in parts:
            try:
                return _converted(value, part)
            except TypeError:
                continue
    elif origin is tuple and isinstance(value, list | tuple):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(kinds) == len(value):
            return tuple(_converted(one, kind) for one, kind in zip(value, kinds, strict=True))
    elif annotation in (int, float):
        number = numbers.Integral if annotation is int else numbers.Real
        if isinstance(value, number) and not isinstance(value, bool):
            return annotation(value)
    elif isinstance(value, origin or annotation):
        return value
    raise TypeError


def nearest(got: str, choices: Iterable[str]) -> str | None:
    """Returns the choice most similar to ``got``, ignoring case; None if none is similar."""
    plain = {name.lower(): name for name in choices}
    near = difflib.get_close_matches(got.lower(), plain, n=1)
    return plain[near[0]] if near else None


def listed(items: Sequence[object]) -> str:
    """Returns the first few items, separated by commas, and the number of the others."""
    more = len(items) - MOST_LISTED
    return ", ".join(map(str, items[:MOST_LISTED])) + (f" and {more} more" if more > 0 else "")


def no_vulkan_device(reason: object) -> SimulatorError:
    """Returns the error for a machine without a rendering device for SAPIEN."""
    return SimulatorError(
        "SAPIEN found no Vulkan device to render with.",
        got=reason,
        allowed="a GPU with a Vulkan driver, or Mesa >= 24.3's lavapipe (mesa-vulkan-drivers)",
        hint=f"--env.image_source=raycast draws pictures without one; {GET_PICTURES}; or do without pictures: "
        "observe_images=False (Python), --env.observe_images=false (LeRobot's commands), "
        "adamanip collect DIR --no-images",
    )


def no_simulator(reason: object) -> SimulatorError:
    """Returns the error for an installation without the simulator."""
    return SimulatorError(
        "The simulator is not installed.",
        got=reason,
        allowed="mani-skill 3.0.1 and sapien 3.0.3",
        hint=INSTALL_SIM,
    )
