"""Check names of Hub repositories and releases before work starts."""

from __future__ import annotations

import contextlib
import re

from lerobot_adamanip.util.errors import ConfigurationError


def require_repo_id(repo_id: str | None, *, suffix: str = "") -> None:
    """Raises `ConfigurationError` if the Hub would refuse the name of a dataset or policy; accepts None.

    The name with ``suffix``, that of a second repository, is checked too.
    """
    for name in () if repo_id is None else (repo_id, repo_id + suffix):
        _require(name, "The Hub does not accept this repository name.")


def require_hub_name(repo_id: str | None) -> str:
    """Returns ``repo_id`` if it is a valid name on the Hub; raises `ConfigurationError` otherwise."""
    owner, _, name = (repo_id or "").partition("/")
    reason = "no owner and name of the Hub" if not (owner and name) or owner == "local" else ""
    return _require(repo_id or "", "This is not a valid repository name for the Hub.", reason)


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
    """Returns a tag that is valid and not a version number; raises `ConfigurationError` otherwise.

    LeRobot parses every branch and tag as a version (PEP 440) of its format and loads the best match: data tagged
    ``3.1`` or ``2026.11`` would be preferred to ``v3.0``, or refused.
    """
    from packaging.version import InvalidVersion, Version

    with contextlib.suppress(InvalidVersion):
        Version(tag)
        raise ConfigurationError(
            "A release's tag must not look like a version.",
            got=repr(tag),
            allowed="a name that is not a version, since LeRobot would read it as one of its format",
            hint=f"--release release-{tag}",
        )
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9._-]{0,60}", tag) is None or tag == "main":
        raise ConfigurationError(
            "Not a valid tag.", got=repr(tag), allowed="a letter, then letters, digits, '.', '_', '-'", hint="release-1"
        )
    return tag
