"""Entry point of the arm process. `ArmClient` runs ``python -m`` this package with SOCKET MEMORY FACTORY."""

from __future__ import annotations

import contextlib
import ctypes
import os
import pkgutil
import signal
import sys
from collections.abc import Iterator
from multiprocessing.connection import Connection

from lerobot_adamanip.hardware.arm_process.encoding import decode, encode
from lerobot_adamanip.hardware.arm_process.mailbox import map_mailboxes
from lerobot_adamanip.hardware.arm_process.messages import MAX_TEXT, BackendFactory, Reply, Start
from lerobot_adamanip.hardware.arm_process.server import ArmServer
from lerobot_adamanip.util.errors import AdaManipError

PR_SET_PDEATHSIG = 1
"""Linux constant of `prctl(2)`."""


def main(socket: int, memory: int, factory_name: str) -> int:
    """Runs the arm process to its end and returns its exit status.

    Args:
        socket: inherited descriptor of the socket.
        memory: inherited descriptor of the shared memory.
        factory_name: ``module:function`` of a `BackendFactory`. The module registers its options as a message.
    """
    connection = Connection(socket)
    served = None
    try:
        factory: BackendFactory = pkgutil.resolve_name(factory_name)
        start = decode(connection.recv_bytes(), Start)
        boxes = map_mailboxes(memory, start.capacities)
        served = factory(start.options, boxes)
        with killed_with_parent():
            served.backend.connect()
    except Exception as error:
        _tell(connection, Reply(0, _in_words(error)))
        if served is not None:
            served.backend.close()
        return 1
    try:
        _tell(connection, Reply(0, None, served.describe()))
        ArmServer(served, connection, boxes, start.server).run()
    except Exception as error:
        _tell(connection, Reply(0, f"the arm's process failed: {_in_words(error)}"))
        raise
    finally:
        served.backend.close()
    return 0


def _tell(connection: Connection, reply: Reply) -> None:
    with contextlib.suppress(OSError):
        connection.send_bytes(encode(reply))


def _in_words(error: Exception) -> str:
    told = str(error) if isinstance(error, AdaManipError) else f"{type(error).__name__}: {error}"
    return told[:MAX_TEXT]


@contextlib.contextmanager
def killed_with_parent() -> Iterator[None]:
    """Makes the kernel kill this process if its parent dies within the context.

    For driver calls that may hang before the arm moves: no other code checks the parent then.
    """
    parent, library = os.getppid(), ctypes.CDLL(None, use_errno=True)
    if library.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:  # the parent died before the request to the kernel
        os.kill(os.getpid(), signal.SIGKILL)
    try:
        yield
    finally:
        library.prctl(PR_SET_PDEATHSIG, 0, 0, 0, 0)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]))
