"""The Hub as this process may use it: names, who is logged in, and one clear error for whatever goes wrong there."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lerobot_adamanip.errors import AdaManipError, ConfigurationError

if TYPE_CHECKING:
    from huggingface_hub import HfApi

AGAIN = "the same command again: what has arrived is not sent a second time"


class HubError(AdaManipError, RuntimeError):
    """The Hub cannot be reached, refuses, or holds something else than was sent."""


def require_repo_id(repo_id: str | None, *, suffix: str = "") -> None:
    """Raises `ConfigurationError` if the Hub would refuse the name of a dataset or policy; None is a default's place.

    Args:
        repo_id: ``name`` or ``owner/name``.
        suffix: that is appended for another repository.
    """
    if repo_id is None:
        return
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]

    try:
        if not repo_id:
            raise HFValidationError("it is empty")
        validate_repo_id(repo_id)
        validate_repo_id(repo_id + suffix)
    except HFValidationError as error:
        raise ConfigurationError(
            "The Hub takes no repository of this name.",
            got=f"{repo_id!r}: {error}",
            allowed="user/name, of letters, digits, '-', '_' and '.', at most 96 of them; no '--', no '..'",
            hint="--repo-id YOUR_NAME/adamanip-safe",
        ) from error


def require_hub_name(repo_id: str | None) -> str:
    """Returns ``repo_id`` if it can be a repository of the Hub; raises `ConfigurationError` if not."""
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]

    owner, _, name = (repo_id or "").partition("/")
    try:
        if not owner or not name or owner == "local":
            raise HFValidationError("no owner and name of the Hub")
        validate_repo_id(str(repo_id))
    except HFValidationError as error:
        raise ConfigurationError(
            "Not a repository of the Hub.",
            got=f"{repo_id!r}: {error}",
            allowed="user/name, of letters, digits, '-', '_' and '.'",
            hint="--repo-id YOUR_NAME/adamanip-safe",
        ) from error
    return str(repo_id)


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


def require_login(api: HfApi) -> None:
    """Raises `HubError` if there is no token, before anything is asked for."""
    from huggingface_hub import constants, get_token

    if constants.is_offline_mode():
        raise _offline()
    if not (api.token or get_token()):
        raise HubError(
            "Nobody is logged in to the Hub.",
            got=f"no token for {api.endpoint}",
            allowed="a token with the right to write",
            hint="hf auth login; or HF_TOKEN in the environment",
        )


@contextlib.contextmanager
def told_clearly(repo_id: str, endpoint: str) -> Iterator[None]:
    """Within it, whatever the Hub's client raises becomes a `HubError`."""
    import httpx
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled

    try:
        yield
    except AdaManipError:
        raise
    except OfflineModeIsEnabled as error:
        raise _offline() from error
    except (HfHubHTTPError, httpx.HTTPError, OSError, RuntimeError, ValueError) as error:
        found = _cause(error)
        if isinstance(found, HfHubHTTPError):
            raise _refused(found, repo_id, endpoint) from error
        if isinstance(found, httpx.HTTPError | OSError):
            raise HubError(
                "The Hub cannot be reached, or the connection broke.",
                got=f"{endpoint}: {type(found).__name__} {found}".strip()[:400],
                allowed="a network that leads there",
                hint=f"HF_ENDPOINT, if the Hub is elsewhere; then {AGAIN}",
            ) from error
        raise HubError(
            "The Hub did not take it.", got=f"{repo_id}: {error}"[:400], allowed="a valid commit", hint=AGAIN
        ) from error


def _cause(error: BaseException) -> BaseException:
    """What lies below an error of the client's threads, which hide it behind one of their own."""
    import httpx
    from huggingface_hub.errors import HfHubHTTPError

    each: BaseException | None = error
    while each is not None:
        if isinstance(each, HfHubHTTPError | httpx.HTTPError | ConnectionError):
            return each
        each = each.__cause__
    return error


def _offline() -> HubError:
    return HubError(
        "The Hub is switched off here.",
        got="HF_HUB_OFFLINE",
        allowed="a process that may use the network",
        hint="unset HF_HUB_OFFLINE (and TRANSFORMERS_OFFLINE)",
    )


def _refused(error: object, repo_id: str, endpoint: str) -> HubError:
    status = getattr(getattr(error, "response", None), "status_code", None)
    reason = {
        401: ("The Hub does not know this login, or hides the repository from it.", "hf auth login"),
        403: ("The Hub does not let this login write there.", "a name of your own, or a token that may write to it"),
        404: ("The Hub does not have it.", "another --repo-id"),
    }
    what, hint = reason.get(status or 0, ("The Hub refused.", AGAIN))
    told = " ".join(str(error).split())
    return HubError(what, got=f"{repo_id} at {endpoint}: {told}"[:400], allowed="a login that may write", hint=hint)
