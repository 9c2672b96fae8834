"""A Hub on 127.0.0.1, everything in memory. Records every request, and can be told to cut the connection within one."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from http.server import ThreadingHTTPServer

from hub_answers import TOKEN, Handler, Request
from hub_store import Repository


@dataclass
class Cut:
    """The connection ends within the ``after``-th request that matches, and within all later ones."""

    pattern: str
    after: int = 1
    seen: int = 0

    def strikes(self, line: str) -> bool:
        self.seen += re.search(self.pattern, line) is not None
        return self.seen >= self.after and re.search(self.pattern, line) is not None


class LoopbackHub:
    """Starts with ``with``; ``url`` is what HF_ENDPOINT has to be."""

    def __init__(self) -> None:
        self.repositories: dict[tuple[str, str], Repository] = {}
        self.stored: dict[str, bytes] = {}
        self.requests: list[Request] = []
        self.cut: Cut | None = None
        self.on_request: Callable[[str], None] = lambda line: None
        hub = self

        class Bound(Handler):
            pass

        Bound.hub = hub
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Bound)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def __enter__(self) -> LoopbackHub:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def files(self, kind: str, name: str, revision: str = "main") -> dict[str, bytes]:
        """What a revision holds, less the file that the Hub itself makes."""
        repository = self.repositories[kind, name]
        return {path: c for path, c in repository.commits[repository.resolve(revision)].items() if path[0] != "."}

    def count(self, pattern: str) -> int:
        return sum(re.search(pattern, request.line) is not None for request in self.requests)

    def environment(self) -> dict[str, str]:
        """Variables for a process that shall use this Hub."""
        return {
            "HF_ENDPOINT": self.url, "HF_TOKEN": TOKEN, "HF_HUB_OFFLINE": "0", "HF_HUB_DISABLE_XET": "1",
            "HF_UPDATE_DOWNLOAD_COUNTS": "0", "HF_HUB_DISABLE_TELEMETRY": "1",
            "HF_HUB_DISABLE_PROGRESS_BARS": "1",
        }  # fmt: skip
