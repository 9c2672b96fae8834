"""A handful of worker processes, each with a simulator of its own, and what happens when one dies."""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import os
import signal
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from lerobot_adamanip.demos.collection import CollectionSpec, EpisodeSpec
from lerobot_adamanip.demos.worker import Report, worker_main
from lerobot_adamanip.errors import AdaManipError

_STOP_SECONDS = 5.0
_MAX_CRASHES = 2
"""An item may bring down one worker; the second time it is given up."""
_MAX_CRASHES_IN_A_ROW = 6


class WorkerError(AdaManipError, RuntimeError):
    """A worker met an error that no other episode would survive, or workers keep dying."""


@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection
    item: EpisodeSpec


class WorkerPool:
    """Runs items on up to ``count`` spawned processes. Use as a context manager: leaving it ends them."""

    def __init__(self, count: int, options: CollectionSpec, folder: Path, max_attempts: int) -> None:
        self._count = count
        self._arguments = (options.to_json(), str(folder), max_attempts)
        self._workers: list[_Worker] = []
        self._crashes: dict[EpisodeSpec, int] = {}
        self._crashes_in_a_row = 0

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.pipe.close()
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(_STOP_SECONDS)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
        self._workers.clear()

    def run(self, items: Iterable[EpisodeSpec]) -> Iterator[Report]:
        """Yields a report per item, in the order they finish; raises `WorkerError`."""
        queue = deque(items)
        while queue or self._workers:
            while queue and len(self._workers) < self._count:
                self._workers.append(self._start(queue.popleft()))
            ready = set(wait([w.pipe for w in self._workers]))
            for worker in [w for w in self._workers if w.pipe in ready]:
                report = self._receive(worker)
                if report is None:
                    self._workers.remove(worker)
                    report = self._crashed(worker, queue)
                elif queue:
                    self._assign(worker, queue.popleft())
                else:
                    self._retire(worker)
                if report is not None:
                    yield report

    def _start(self, item: EpisodeSpec) -> _Worker:
        context = mp.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=worker_main, args=(there, *self._arguments), daemon=True)
        with _thread_limits(self._count):
            process.start()
        there.close()
        worker = _Worker(process, here, item)
        self._assign(worker, item)
        return worker

    @staticmethod
    def _assign(worker: _Worker, item: EpisodeSpec) -> None:
        worker.item = item
        with contextlib.suppress(OSError):  # a dead worker is noticed when its answer is read
            worker.pipe.send(asdict(item))

    def _retire(self, worker: _Worker) -> None:
        worker.pipe.close()
        self._workers.remove(worker)
        worker.process.join(_STOP_SECONDS)
        if worker.process.is_alive():
            worker.process.kill()

    def _receive(self, worker: _Worker) -> Report | None:
        try:
            content: dict[str, Any] = worker.pipe.recv()
        except (EOFError, OSError):
            return None
        if content["error"] is not None:
            raise WorkerError(f"{worker.item.object_id}, episode {worker.item.slot}: {content['error']}")
        self._crashes_in_a_row = 0
        return Report(**{**content, "item": worker.item})

    def _crashed(self, worker: _Worker, queue: deque[EpisodeSpec]) -> Report | None:
        worker.pipe.close()
        worker.process.join(_STOP_SECONDS)
        cause = _cause(worker.process.exitcode)
        self._crashes_in_a_row += 1
        if self._crashes_in_a_row >= _MAX_CRASHES_IN_A_ROW:
            raise WorkerError(f"{self._crashes_in_a_row} workers in a row ended by themselves, the last one: {cause}.")
        self._crashes[worker.item] = self._crashes.get(worker.item, 0) + 1
        if self._crashes[worker.item] < _MAX_CRASHES:
            queue.appendleft(worker.item)
            return None
        return Report(worker.item, failures=({"seed": None, "reason": f"its worker died twice ({cause})"},))


def _cause(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        with contextlib.suppress(ValueError):
            return f"signal {signal.Signals(-exit_code).name}"
    return f"exit status {exit_code}"


@contextlib.contextmanager
def _thread_limits(workers: int) -> Iterator[None]:
    """Sets thread counts that a spawned worker reads when it loads its libraries.

    One thread for arithmetic whatever the number of workers, so that sums are taken in the same order; the software
    renderer, whose result does not depend on it, shares the cores out.
    """
    renderer = max(1, (os.cpu_count() or 1) // workers)
    wanted = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    wanted["LP_NUM_THREADS"] = str(renderer)
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})
