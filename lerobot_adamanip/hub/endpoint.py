"""Login to the Hub, and one clear error for everything that goes wrong there."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lerobot_adamanip.util.errors import AdaManipError

if TYPE_CHECKING:
    from huggingface_hub import HfApi

AGAIN = "the same command again: what has arrived is not sent a second time"


class HubError(AdaManipError, RuntimeError):
    """The Hub cannot be reached, refuses, or holds something else than was sent."""


def require_login(api: HfApi) -> None:
    """Raises `HubError` if there is no token, before any request."""
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
def translate_hub_errors(repo_id: str, endpoint: str) -> Iterator[None]:
    """Turns errors of the Hub's client into `HubError`."""
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
    """Returns the error below one of the client's threads, which wrap it."""
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
