"""Check names of Hub repositories and releases before any work is done."""

from __future__ import annotations

import contextlib
import re

from lerobot_adamanip.util.errors import ConfigurationError


def require_repo_id(repo_id: str | None, *, suffix: str = "") -> None:
    """Raises `ConfigurationError` if the Hub would refuse the name of a dataset or policy; None is a default's place.

    ``suffix`` is appended for another repository.
    """
    for name in () if repo_id is None else (repo_id, repo_id + suffix):
        _require(name, "The Hub takes no repository of this name.")


def require_hub_name(repo_id: str | None) -> str:
    """Returns ``repo_id`` if it can be a repository of the Hub; raises `ConfigurationError` if not."""
    owner, _, name = (repo_id or "").partition("/")
    reason = "no owner and name of the Hub" if not (owner and name) or owner == "local" else ""
    return _require(repo_id or "", "Not a repository of the Hub.", reason)


def _require(repo_id: str, what: str, reason: str = "") -> str:
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]

    try:
        if reason or not repo_id:
            raise HFValidationError(reason or "it is empty")
        validate_repo_id(repo_id)
    except HFValidationError as error:
        raise ConfigurationError(
            what,
            got=f"{repo_id!r}: {error}",
            allowed="user/name, of letters, digits, '-', '_' and '.', at most 96 of them; no '--', no '..'",
            hint="--repo-id YOUR_NAME/adamanip-safe",
        ) from error
    return repo_id


def require_release_name(tag: str) -> str:
    """Returns a tag that LeRobot cannot take for a version of its format; raises `ConfigurationError` for one it can.

    LeRobot parses every branch and tag as a version (PEP 440) and loads the one that fits it best: data tagged ``3.1``
    or ``2026.11`` would be preferred to, or refused for, its own ``v3.0``.
    """
    from packaging.version import InvalidVersion, Version

    with contextlib.suppress(InvalidVersion):
        Version(tag)
        raise ConfigurationError(
            "A release's tag must not look like a version.",
            got=repr(tag),
            allowed="a name that is no version: LeRobot would take it for one of its format",
            hint=f"--release release-{tag}",
        )
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9._-]{0,60}", tag) is None or tag == "main":
        raise ConfigurationError(
            "Not a tag.", got=repr(tag), allowed="a letter, then letters, digits, '.', '_', '-'", hint="release-1"
        )
    return tag
