"""Process pool that recovers from crashed and hanging workers, for any kind of work.

Each worker creates its resources (for instance a simulator) once, in its `Session`. The parent process sends session
and items to the processes that it has started; jobs are never read from files.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Self

from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.files import full_disk_error

DEFAULT_TIMEOUT = 600.0
"""A worker without a heartbeat for this long counts as hanging [s]. The first one includes the simulator's start."""
MAX_CRASHES, MAX_CONSECUTIVE_CRASHES = 2, 6
"""Crashes after which an item is given up, and consecutive crashes that end the whole job."""
THREAD_LIMITS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a worker. With one thread, sums have the same order for any number of workers."""
_STOP_SECONDS = 5.0
_MIN_BEAT_SECONDS = 1.0
_MAX_POLL_SECONDS = 1.0

Heartbeat = Callable[[], None]
"""Called at intervals while an item runs."""
type Work[Item] = Callable[[Item, Heartbeat], object]
"""Runs one item."""
type Session[Item] = Callable[[], AbstractContextManager[Work[Item]]]
"""Context manager in a worker that keeps resources between items. Must be module-level or a `functools.partial`."""

_preloaded: list[str] = []


def preload(*modules: str) -> None:
    """Makes this process's workers copies of one that has imported ``modules``; starts importing at once.

    Call it at the start of a command: otherwise each worker imports the simulator, which takes 4 s of CPU time. Where
    processes cannot be copied, workers are spawned. A missing module raises later, in the code that needs it.
    """
    if _preloaded or "forkserver" not in multiprocessing.get_all_start_methods():
        return
    from multiprocessing.forkserver import ensure_running, set_forkserver_preload

    set_forkserver_preload(list(modules))
    with thread_limits():
        ensure_running()
    _preloaded.extend(modules)


class WorkerError(AdaManipError, RuntimeError):
    """Error in the work, which would affect other items too, or repeated crashes of workers."""


@dataclass(frozen=True)
class JobResult[Item]:
    """Result of an item.

    Attributes:
        item: the item.
        value: return value of the work; None if the item was given up.
        death: cause of the last crash, if the item was given up.
        seconds: duration.
    """

    item: Item
    value: Any = None
    death: str | None = None
    seconds: float = 0.0


class RunningTime:
    """Clock that hardly advances while this process is stopped, so that its workers do not count as hanging.

    A process stops for instance after Ctrl-Z, when its machine is paused, or while its caller handles a result.

    Args:
        max_step: maximum advance between two calls [s]. Call the clock more often than that.
        clock: source of the time [s].
    """

    def __init__(self, max_step: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._max_step, self._clock = max_step, clock
        self._latest, self._seconds = clock(), 0.0

    def __call__(self) -> float:
        """Returns the time [s]."""
        now = self._clock()
        self._seconds += min(now - self._latest, self._max_step)
        self._latest = now
        return self._seconds


class Crashes[Item]:
    """Counts crashes to decide whether an item is tried again.

    Args:
        per_item: number of crashes after which an item is given up.
        consecutive: number of consecutive crashes, without a result in between, that ends the job.
    """

    def __init__(self, per_item: int, consecutive: int) -> None:
        self._per_item, self._max_consecutive = per_item, consecutive
        self._counts = Counter[Item]()
        self.consecutive = 0
        """Set it to 0 at each result."""

    def is_final(self, item: Item | None, cause: str) -> bool:
        """Counts a crash; returns whether the item is given up. Raises `WorkerError` after too many crashes."""
        self.consecutive += 1
        if self.consecutive >= self._max_consecutive:
            raise WorkerError(f"{self.consecutive} workers in a row crashed, the last one: {cause}.")
        if item is None:
            return False
        self._counts[item] += 1
        return self._counts[item] >= self._per_item


@dataclass
class _Worker[Item]:
    """A worker; ``started`` is a time of `time.monotonic`, ``last_heartbeat`` one of the pool's `RunningTime`."""

    process: BaseProcess
    pipe: Connection
    item: Item
    started: float = 0.0
    last_heartbeat: float = 0.0

    def assign(self, item: Item, now: float) -> None:
        self.item, self.started, self.last_heartbeat = item, time.monotonic(), now
        with contextlib.suppress(OSError):  # a crashed worker is detected when its answer is read
            self.pipe.send(item)

    def end(self) -> None:
        self.pipe.close()
        self.process.join(_STOP_SECONDS)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


class WorkerPool[Item]:
    """Runs items on up to ``count`` processes. Use as a context manager; its exit ends the processes.

    Args:
        session: creates a worker's resources.
        count: maximum number of processes.
        timeout: a worker without a heartbeat for this long is ended and counts as crashed [s].
        clock: source of the time that `timeout` limits [s].
    """

    def __init__(
        self,
        session: Session[Item],
        count: int,
        *,
        timeout: float = DEFAULT_TIMEOUT,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._session, self._count, self._timeout = session, count, timeout
        self._poll_seconds = min(_MAX_POLL_SECONDS, timeout / 4)
        self._running_time = RunningTime(2 * self._poll_seconds, clock)
        self._workers: list[_Worker[Item]] = []
        self._queue: deque[Item] = deque()
        self._crashes = Crashes[Item](MAX_CRASHES, MAX_CONSECUTIVE_CRASHES)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def run(self, items: Iterable[Item]) -> Iterator[JobResult[Item]]:
        """Yields the result of each item, in order of completion; raises `WorkerError`."""
        self._queue = deque(items)
        while self._queue or self._workers:
            while self._queue and len(self._workers) < self._count:
                self._workers.append(self._start(self._queue.popleft()))
            ready = wait([worker.pipe for worker in self._workers], timeout=self._poll_seconds)
            now = self._running_time()
            for worker in list(self._workers):
                if worker.pipe in ready:
                    yield from self._received(worker, now)
                elif now - worker.last_heartbeat > self._timeout and not worker.pipe.poll():
                    worker.process.kill()
                    yield from self._crashed(worker, f"hung: no heartbeat for {self._timeout:g} s")

    def _start(self, item: Item) -> _Worker[Item]:
        context: Any = multiprocessing.get_context("forkserver" if _preloaded else "spawn")
        here, there = context.Pipe()
        render_threads = max(1, (os.cpu_count() or 1) // self._count)
        process = context.Process(target=_serve, args=(there, self._session, render_threads), daemon=True)
        with thread_limits():
            process.start()
        there.close()
        worker = _Worker(process, here, item)
        worker.assign(item, self._running_time())
        return worker

    def _received(self, worker: _Worker[Item], now: float) -> Iterator[JobResult[Item]]:
        try:
            kind, value = worker.pipe.recv()
        except (EOFError, OSError):
            yield from self._crashed(worker)
            return
        worker.last_heartbeat = now
        if kind == "error":
            raise WorkerError(f"{worker.item}: {value}")
        if kind == "result":
            self._crashes.consecutive = 0
            result = JobResult(worker.item, value, seconds=time.monotonic() - worker.started)
            if self._queue:
                worker.assign(self._queue.popleft(), now)
            else:
                self._retire(worker)
            yield result

    def _retire(self, worker: _Worker[Item]) -> None:
        self._workers.remove(worker)
        worker.end()

    def _crashed(self, worker: _Worker[Item], cause: str = "") -> Iterator[JobResult[Item]]:
        self._retire(worker)
        cause = cause or _exit_cause(worker.process.exitcode)
        if self._crashes.is_final(worker.item, cause):
            yield JobResult(worker.item, death=cause, seconds=time.monotonic() - worker.started)
        else:
            self._queue.appendleft(worker.item)


def _exit_cause(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        with contextlib.suppress(ValueError):
            return f"signal {signal.Signals(-exit_code).name}"
    return f"exit status {exit_code}"


@contextlib.contextmanager
def thread_limits() -> Iterator[None]:
    """Sets `THREAD_LIMITS` while a process starts, because libraries read them when they are loaded."""
    before = {name: os.environ.get(name) for name in THREAD_LIMITS}
    os.environ.update(THREAD_LIMITS)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})


# In the worker ----------------------------------------------------------------------------------------------------


def error_text(error: Exception) -> str:
    """Returns an error of the work as text for the parent process, because exceptions may not pickle."""
    shown = full_disk_error(error) or error
    return str(shown) if isinstance(shown, AdaManipError) else "".join(traceback.format_exception(error))


def _serve[Item](pipe: Connection, session: Session[Item], render_threads: int) -> None:
    """Runs items from ``pipe`` until it closes; a software renderer uses ``render_threads`` threads."""
    os.environ["LP_NUM_THREADS"] = str(render_threads)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent handles it
    threading.Thread(target=_exit_with_parent, daemon=True).start()

    try:
        with session() as work:
            while True:
                try:
                    item = pipe.recv()
                except (EOFError, OSError):
                    return  # nothing more to do
                pipe.send(("result", work(item, _heartbeat(pipe))))
    except Exception as error:
        with contextlib.suppress(OSError):
            pipe.send(("error", error_text(error)))


def _heartbeat(pipe: Connection) -> Heartbeat:
    latest = time.monotonic()

    def beat() -> None:
        nonlocal latest
        if time.monotonic() - latest > _MIN_BEAT_SECONDS:
            latest = time.monotonic()
            pipe.send(("heartbeat", None))

    return beat


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
