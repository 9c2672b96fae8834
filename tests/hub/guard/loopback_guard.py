"""Sees every connection that Python code begins, and refuses those that leave loopback, whatever code makes them."""

from __future__ import annotations

import os
import sys

LOG = "ADAMANIP_GUARD_LOG"
"""Environment variable: the file that attempts are written to. Nothing is refused without it."""
_LOOPBACK = ("127.", "::1", "localhost", "0.0.0.0")  # the last: a socket that listens
_installed = False


def _guard(event: str, arguments: tuple[object, ...]) -> None:
    host: object
    if event == "socket.getaddrinfo":
        host = arguments[0]
    elif event in ("socket.connect", "socket.sendto", "socket.sendmsg") and isinstance(arguments[1], tuple):
        host = arguments[1][0]
    else:
        return
    name = host.decode() if isinstance(host, bytes) else str(host or "localhost")
    log = os.environ.get(LOG)
    if log and not name.startswith(_LOOPBACK):
        with open(log, "a", encoding="utf-8") as file:
            file.write(f"{event} {name}\n")
        raise PermissionError(f"{event} {name} is not loopback")


def install() -> None:
    """Installs it in this process, for good."""
    global _installed  # noqa: PLW0603  (an audit hook cannot be taken back, so there is one)
    if not _installed:
        sys.addaudithook(_guard)
        _installed = True
