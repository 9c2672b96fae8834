"""OpenMP threads of a training on a CPU that other programs use too."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import logging
import math
import os
import threading
from pathlib import Path

import torch

WAITING = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
"""Variables by which a user chooses how OpenMP threads wait."""
BUSY_MARGIN = 0.5
"""A load average above the number of CPUs by more than this means that programs wait for a core."""


def cpu_quota(root: Path = Path("/sys/fs/cgroup"), member: Path = Path("/proc/self/cgroup")) -> float:
    """Returns the number of CPUs that this process's control groups (version 2) grant; infinite without a quota."""
    quotas = [math.inf]
    with contextlib.suppress(OSError):
        own = root / member.read_text().rpartition("::")[2].strip().lstrip("/")
        for folder in (own, *own.parents):
            with contextlib.suppress(OSError, ValueError):  # no such group, or the word "max"
                quota, period = map(int, (folder / "cpu.max").read_text().split())
                quotas.append(quota / period)
            if folder == root:
                break
    return min(quotas)


def limit_threads_to_quota() -> None:
    """Lowers torch's number of threads to the CPU quota, unless the user has set it. Torch does not read the quota."""
    quota = cpu_quota()
    if "OMP_NUM_THREADS" not in os.environ and quota < torch.get_num_threads():
        torch.set_num_threads(max(1, int(quota)))


def stop_spinning_if_busy(*_: object) -> None:
    """Calls `stop_spinning` once programs wait for a core of this machine, unless the user has set `WAITING`."""
    with contextlib.suppress(OSError):
        busy = os.getloadavg()[0] > (os.cpu_count() or 1) + BUSY_MARGIN
        if busy and not any(name in os.environ for name in WAITING):
            stop_spinning()


@functools.cache
def stop_spinning() -> bool:
    """Makes waiting OpenMP threads of this process sleep at once, as ``OMP_WAIT_POLICY=passive`` does.

    Threads of libgomp spin 3 ms before they sleep. On a core that another program uses too, this is most of a training
    step. libgomp reads its variables when torch is imported, before any plugin. But it also stops spinning while it
    has more threads than the process has CPUs. So this starts such a number of threads, which sleep.

    Returns:
        whether torch uses libgomp; with another library nothing changes.
    """
    libraries = {line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "libgomp" in line}
    if not libraries:
        return False
    started, never = threading.Event(), threading.Event()
    no_work = ctypes.cast(ctypes.CDLL(None).abs, ctypes.c_void_p)

    def hold_threads() -> None:
        for library in libraries:
            count = ctypes.c_uint(len(os.sched_getaffinity(0)) + 1)
            ctypes.CDLL(library).GOMP_parallel(no_work, None, count, ctypes.c_uint(0))
        started.set()
        never.wait()  # libgomp ends the threads together with this one

    threading.Thread(target=hold_threads, name="openmp_holder", daemon=True).start()
    started.wait()
    logging.getLogger(__name__).info("Other programs use these CPUs: OpenMP threads sleep while they wait.")
    return True
