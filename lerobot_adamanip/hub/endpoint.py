"""Login to the Hugging Face Hub, and translation of its errors."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lerobot_adamanip.util.errors import AdaManipError

if TYPE_CHECKING:
    from huggingface_hub import HfApi

RETRY = "run the same command again: files already uploaded are not sent again"
_REFUSALS = {
    401: ("The Hub rejects this login, or hides the repository from it.", "hf auth login"),
    403: ("The Hub does not let this login write there.", "your own namespace, or a token that may write to this one"),
    404: ("The Hub does not have it.", "another --repo-id"),
}
"""HTTP status -> error and hint."""


class HubError(AdaManipError, RuntimeError):
    """The Hub cannot be reached or refuses a request."""


def require_login(api: HfApi) -> None:
    """Raises `HubError` in offline mode or without a token. Sends no request."""
    from huggingface_hub import constants, get_token

    if constants.is_offline_mode():
        raise HubError(
            "The Hub is switched off (offline mode).",
            got="HF_HUB_OFFLINE",
            allowed="a process that may use the network",
            hint="unset HF_HUB_OFFLINE (and TRANSFORMERS_OFFLINE)",
        )
    if not (api.token or get_token()):
        raise HubError(
            "Not logged in to the Hub.",
            got=f"no token for {api.endpoint}",
            allowed="a token with the right to write",
            hint="hf auth login; or HF_TOKEN in the environment",
        )


@contextlib.contextmanager
def translate_hub_errors(repo_id: str, endpoint: str) -> Iterator[None]:
    """Translates errors of the Hub's client to `HubError`."""
    import httpx
    from huggingface_hub.errors import HfHubHTTPError

    try:
        yield
    except AdaManipError:
        raise
    except (httpx.HTTPError, OSError, RuntimeError, ValueError) as error:
        cause: BaseException = error
        while cause.__cause__ and not isinstance(cause, httpx.HTTPError | ConnectionError):  # threads wrap errors
            cause = cause.__cause__
        if isinstance(cause, OSError) and (cause.filename or cause.errno in (errno.ENOSPC, errno.EDQUOT)):
            raise  # a local file or disk
        got = f"{repo_id} at {endpoint}: {type(cause).__name__} {' '.join(str(cause).split())}"[:400]
        if isinstance(cause, HfHubHTTPError):
            what, hint = _REFUSALS.get(cause.response.status_code, ("The Hub refused.", RETRY))
            raise HubError(what, got=got, allowed="a login that may write", hint=hint) from error
        if isinstance(cause, httpx.HTTPError | OSError):
            raise HubError(
                "The Hub cannot be reached, or the connection broke.",
                got=got,
                allowed="a working network connection to it",
                hint=f"HF_ENDPOINT, if the Hub is elsewhere; then {RETRY}",
            ) from error
        raise HubError("The Hub did not accept the files.", got=got, allowed="a valid commit", hint=RETRY) from error
