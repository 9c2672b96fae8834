"""A child that must not outlive its parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
from collections.abc import Iterator

PR_SET_PDEATHSIG = 1
"""Linux, `prctl(2)`."""


@contextlib.contextmanager
def killed_with_parent() -> Iterator[None]:
    """Within it, the kernel kills this process when its parent dies.

    For calls that may hang in a driver, where nobody looks whether the parent is still there; nothing may move yet.
    """
    parent = os.getppid()
    _die_with_parent(signal.SIGKILL)
    if os.getppid() != parent:  # it died before the kernel was told
        os.kill(os.getpid(), signal.SIGKILL)
    try:
        yield
    finally:
        _die_with_parent(0)


def _die_with_parent(number: int) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, number, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")


def ended_with(error: BaseException) -> str:
    """Returns an exception as one line."""
    return f"{type(error).__name__}: {error}".splitlines()[0]
