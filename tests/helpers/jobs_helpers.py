"""Work for `lerobot_adamanip.util.jobs`, importable by spawned workers."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.jobs import Heartbeat, Work

IMPORTER = os.getpid()


@contextlib.contextmanager
def session(folder: Path) -> Iterator[Work]:
    """Squares numbers. ``once:...`` and ``always:...`` items die, hang or fail the first time, or always."""
    (folder / f"session-{os.getpid()}").touch()

    def work(item: object, beat: Heartbeat) -> object:
        if isinstance(item, int):
            return item * item, os.getpid()
        if item == "who":
            return os.environ.get("OMP_NUM_THREADS")
        if item == "imported by":
            return os.getpid(), IMPORTER
        when, _, what = str(item).partition(":")
        marker = folder / what
        if when == "always" or not marker.exists():
            marker.touch()
            _do(what, beat)
        return what

    try:
        yield work
    finally:
        (folder / f"ended-{os.getpid()}").touch()


def _do(what: str, beat: Heartbeat) -> None:
    if what == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "hang":
        time.sleep(600)
    if what == "short":
        time.sleep(1.2)
    if what == "slow":
        for _ in range(30):
            time.sleep(0.1)
            beat()
    if what == "refuse":
        raise DatasetError("no such thing")
    if what == "write":
        raise OSError("No space left")
    if what == "break":
        raise ZeroDivisionError("a mistake")
