"""A pool of processes that survives its workers' deaths, and notices one that hangs. Free of what it runs.

What a worker needs for its items (a simulator, say) it makes once, in `Session`. Nothing of a job is read from a file:
session and items travel from the parent process to those it has started.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from typing import Protocol, Self

from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError

DEFAULT_TIMEOUT = 600.0
"""Without a heartbeat for this long [s], a worker hangs. The first one includes starting a simulator."""
MAX_DEATHS = 2
"""An item may bring down one worker; the second time it is given up."""
MAX_DEATHS_IN_A_ROW = 6
_STOP_SECONDS = 5.0
_BEAT_SECONDS = 1.0
"""Signs of life are sent no more often than this."""

Heartbeat = Callable[[], None]
"""Called now and then while an item runs."""
type Work[Item] = Callable[[Item, Heartbeat], object]
"""Runs one item."""
type Session[Item] = Callable[[], AbstractContextManager[Work[Item]]]
"""Made in a worker: what it holds from item to item. A function of a module, or a `functools.partial` of one."""


_preloaded: list[str] = []


def preload(*modules: str) -> None:
    """Lets all workers of this process start as copies of one that has imported ``modules``; it begins at once.

    For the start of a command: importing a simulator takes a core 4 s, in each worker otherwise. Where processes cannot
    be copied, workers are spawned, as without this. A missing module is left to the code that needs it.
    """
    if _preloaded or "forkserver" not in multiprocessing.get_all_start_methods():
        return
    from multiprocessing.forkserver import ensure_running, set_forkserver_preload

    set_forkserver_preload(list(modules))
    with _thread_limits():
        ensure_running()
    _preloaded.extend(modules)


def _context() -> SpawnContext | ForkServerContext:
    return multiprocessing.get_context("forkserver") if _preloaded else multiprocessing.get_context("spawn")


class WorkerError(AdaManipError, RuntimeError):
    """A worker met an error that no other item would survive, or workers keep dying."""


@dataclass(frozen=True)
class JobResult[Item]:
    """What became of an item.

    Attributes:
        item: which.
        value: what the work returned; None if it was given up.
        death: how its workers ended, if it was given up; None if not.
        seconds: it took.
    """

    item: Item
    value: object = None
    death: str | None = None
    seconds: float = 0.0


class Executor[Item](Protocol):
    """Whoever does a job's items: the processes of a `WorkerPool`, or actors of a cluster."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def run(self, items: Iterable[Item]) -> Iterator[JobResult[Item]]:
        """Yields the result of each item, in the order they finish; raises `WorkerError`."""
        ...


@dataclass
class _Worker[Item]:
    process: BaseProcess
    pipe: Connection
    item: Item
    begin: float = field(default_factory=time.monotonic)
    heard: float = field(default_factory=time.monotonic)


class WorkerPool[Item]:
    """Runs items on up to ``count`` processes. Use as a context manager: leaving it ends them.

    Args:
        session: makes what a worker holds from item to item.
        count: of processes.
        timeout: a worker that gives no heartbeat for so long [s] is ended, as if it had died.
    """

    def __init__(self, session: Session[Item], count: int, *, timeout: float = DEFAULT_TIMEOUT) -> None:
        if count < 1 or not timeout > 0:
            got = f"{count} workers, timeout {timeout} s"
            raise ConfigurationError(
                "No such pool.", got=got, allowed="1 or more workers, a timeout above 0", hint="--workers 2"
            )
        self._session, self._count, self._timeout = session, count, timeout
        self._workers: list[_Worker[Item]] = []
        self._deaths: dict[Item, int] = {}
        self._deaths_in_a_row = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.pipe.close()
            worker.process.terminate()
        for worker in self._workers:
            _end(worker.process)
        self._workers.clear()

    def run(
        self, items: Iterable[Item], *, done: Callable[[Item], bool] = lambda item: False
    ) -> Iterator[JobResult[Item]]:
        """Yields the result of each item that is not ``done``, in the order they finish; raises `WorkerError`."""
        queue = deque(item for item in items if not done(item))
        while queue or self._workers:
            while queue and len(self._workers) < self._count:
                self._workers.append(self._start(queue.popleft()))
            ready = wait([worker.pipe for worker in self._workers], timeout=min(1.0, self._timeout / 4))
            for worker in list(self._workers):
                if worker.pipe in ready:
                    yield from self._heard(worker, queue)
                elif time.monotonic() - worker.heard > self._timeout:
                    worker.process.kill()
                    yield from self._died(worker, queue, f"hung: no heartbeat for {self._timeout:g} s")

    def _start(self, item: Item) -> _Worker[Item]:
        context = _context()
        here, there = context.Pipe()
        renderer = max(1, (os.cpu_count() or 1) // self._count)
        process = context.Process(target=_work, args=(there, self._session, renderer), daemon=True)
        with _thread_limits():
            process.start()
        there.close()
        worker = _Worker(process, here, item)
        self._assign(worker, item)
        return worker

    @staticmethod
    def _assign(worker: _Worker[Item], item: Item) -> None:
        worker.item, worker.begin = item, time.monotonic()
        worker.heard = worker.begin
        with contextlib.suppress(OSError):  # a dead worker is noticed when its answer is read
            worker.pipe.send(item)

    def _heard(self, worker: _Worker[Item], queue: deque[Item]) -> Iterator[JobResult[Item]]:
        try:
            kind, value = worker.pipe.recv()
        except (EOFError, OSError):
            yield from self._died(worker, queue, None)
            return
        worker.heard = time.monotonic()
        if kind == "beat":
            return
        if kind == "error":
            raise WorkerError(f"{worker.item}: {value}")
        self._deaths_in_a_row = 0
        result = JobResult(worker.item, value, seconds=worker.heard - worker.begin)
        if queue:
            self._assign(worker, queue.popleft())
        else:
            self._retire(worker)
        yield result

    def _retire(self, worker: _Worker[Item]) -> None:
        worker.pipe.close()
        self._workers.remove(worker)
        _end(worker.process)

    def _died(self, worker: _Worker[Item], queue: deque[Item], cause: str | None) -> Iterator[JobResult[Item]]:
        self._retire(worker)
        cause = cause or _cause(worker.process.exitcode)
        self._deaths_in_a_row += 1
        if self._deaths_in_a_row >= MAX_DEATHS_IN_A_ROW:
            raise WorkerError(f"{self._deaths_in_a_row} workers in a row ended by themselves, the last one: {cause}.")
        self._deaths[worker.item] = self._deaths.get(worker.item, 0) + 1
        if self._deaths[worker.item] < MAX_DEATHS:
            queue.appendleft(worker.item)
        else:
            yield JobResult(worker.item, death=cause, seconds=time.monotonic() - worker.begin)


def _end(process: BaseProcess) -> None:
    process.join(_STOP_SECONDS)
    if process.is_alive():
        process.kill()
        process.join()


def _cause(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        with contextlib.suppress(ValueError):
            return f"signal {signal.Signals(-exit_code).name}"
    return f"exit status {exit_code}"


@contextlib.contextmanager
def _thread_limits() -> Iterator[None]:
    """Sets the number of threads that a process started meanwhile reads when it loads its libraries.

    One for arithmetic whatever the number of workers, so that sums are taken in the same order.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})


# In the worker ----------------------------------------------------------------------------------------------------


def _work[Item](pipe: Connection, session: Session[Item], renderer: int) -> None:
    """Serves items from ``pipe`` until it closes; its software renderer has ``renderer`` threads."""
    os.environ["LP_NUM_THREADS"] = str(renderer)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides what it means
    threading.Thread(target=_die_with_parent, daemon=True).start()
    try:
        with session() as work:
            while True:
                try:
                    item = pipe.recv()
                except (EOFError, OSError):
                    return  # nothing more to do
                pipe.send(("result", work(item, _beat(pipe))))
    except Exception as error:  # the parent shows it: a worker has no screen of its own
        with contextlib.suppress(OSError):
            pipe.send(("error", str(error) if isinstance(error, AdaManipError) else traceback.format_exc()))


def _beat(pipe: Connection) -> Heartbeat:
    latest = time.monotonic()

    def beat() -> None:
        nonlocal latest
        if time.monotonic() - latest > _BEAT_SECONDS:
            latest = time.monotonic()
            pipe.send(("beat", None))

    return beat


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
