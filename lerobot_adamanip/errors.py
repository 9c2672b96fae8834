"""Errors a user can act on. Every message says what went wrong, what was given, what is allowed and what to try."""

from __future__ import annotations

from collections.abc import Iterable


class AdaManipError(Exception):
    """Base of every error this project raises on purpose."""


class ConfigurationError(AdaManipError, ValueError):
    """An argument or an option has a value that cannot work."""


class DatasetError(AdaManipError, RuntimeError):
    """A dataset is missing, half written, or of another layout than asked for."""


class SimulatorError(AdaManipError, RuntimeError):
    """The simulator cannot run here: packages missing, or no Vulkan device to render with."""


class UnreachableError(AdaManipError, RuntimeError):
    """No layout or pose within the arm's reach was found."""


def explain(what: str, *, got: object, allowed: object, try_: str) -> str:
    """Formats the four facts that every error message of this project carries."""
    return f"{what}\n  got:     {got}\n  allowed: {allowed}\n  try:     {try_}"


def require_choice(what: str, got: str, choices: Iterable[str], *, try_: str | None = None) -> str:
    """Returns ``got`` if it is one of ``choices``; raises `ConfigurationError` that lists them if not."""
    names = sorted(choices)
    if got in names:
        return got
    raise ConfigurationError(
        explain(
            f"Unknown {what}.", got=repr(got), allowed=", ".join(names), try_=try_ or f"one of the allowed {what} names"
        )
    )


def no_vulkan_device(reason: object) -> SimulatorError:
    """Returns the error for a machine on which SAPIEN finds nothing to render with."""
    return SimulatorError(
        explain(
            "SAPIEN found no Vulkan device to render with.",
            got=reason,
            allowed="a GPU with a Vulkan driver, or Mesa >= 24.3's lavapipe (mesa-vulkan-drivers)",
            try_="adamanip doctor",
        )
    )
