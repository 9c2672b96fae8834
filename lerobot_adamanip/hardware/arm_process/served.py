"""What a program that runs an arm's process has to bring: backends by name, each with the requests it answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from lerobot_adamanip.hardware.arm import ArmBackend
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox

Handler = Callable[[dict[str, Any]], dict[str, Any]]
"""Answers one request: JSON-able values in, JSON-able values out; raises `AdaManipError` or ValueError for a refusal.
It runs between two ticks, in the one thread that calls the backend, and may take as long as it needs: no tick, and no
watchdog, runs meanwhile. The status that the recorder sees next is of after it."""

RESET = "reset"
"""The request that puts scene and arm up anew: what is measured after it depends on nothing before it."""


@dataclass(frozen=True)
class Served:
    """A backend and what it answers beside what every backend does.

    Attributes:
        backend: moves the arm.
        handlers: request -> what answers it, e.g. `RESET`. `server.OWN_REQUESTS` are the server's own.
        describe: told once, right after `connect`: what the recorder should know (JSON-able).
    """

    backend: ArmBackend
    handlers: Mapping[str, Handler] = field(default_factory=dict)
    describe: Callable[[], dict[str, Any]] = dict


BackendFactory = Callable[[dict[str, Any], Mapping[str, Mailbox]], Served]
"""(options, frame mailboxes by name) -> a backend that is not yet connected. Raises ValueError for a wrong option."""
