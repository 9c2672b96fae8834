"""An arm's program: a table of backends, and ``sys.exit(run_server(BACKENDS, sys.argv[1]))``."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping
from multiprocessing.connection import Connection

from lerobot_adamanip.hardware.arm_process.mailbox import SharedMailboxes
from lerobot_adamanip.hardware.arm_process.messages import Reply, pack_reply
from lerobot_adamanip.hardware.arm_process.options import parse_start
from lerobot_adamanip.hardware.arm_process.parent import ended_with, killed_with_parent
from lerobot_adamanip.hardware.arm_process.served import BackendFactory
from lerobot_adamanip.hardware.arm_process.server import ArmServer
from lerobot_adamanip.util.errors import AdaManipError


def run_server(backends: Mapping[str, BackendFactory], argument: str) -> int:
    """Runs an arm's process to its end and returns its exit status.

    Args:
        backends: name -> factory: the closed table of this program.
        argument: `Start` as JSON, from the client.
    """
    start = parse_start(argument)
    connection = Connection(start.socket)
    try:
        boxes = SharedMailboxes(start.mailboxes(), start.memory)
        if start.backend not in backends:
            raise ValueError(f"unknown backend {start.backend!r}; known are {', '.join(backends)}")
        served = backends[start.backend](start.options, {name: boxes[name] for name in start.frames})
        with killed_with_parent():
            served.backend.connect()
    except (AdaManipError, ValueError) as error:
        with contextlib.suppress(OSError):
            connection.send_bytes(pack_reply(Reply(0, str(error) or type(error).__name__)))
        return 1
    try:
        with contextlib.suppress(OSError):
            connection.send_bytes(pack_reply(Reply(0, None, served.describe())))
        ArmServer(served, connection, boxes, start).run()
    except Exception as error:
        with contextlib.suppress(OSError):
            connection.send_bytes(pack_reply(Reply(0, f"the arm's process failed: {ended_with(error)}")))
        raise
    finally:
        served.backend.close()
    sys.stdout.flush()
    return 0
