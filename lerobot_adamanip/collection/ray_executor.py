"""Executor on actors of a Ray cluster, with the interface of `lerobot_adamanip.util.jobs.WorkerPool`.

Ray's restarts and `ray.util.ActorPool` are not sufficient. A restarted actor keeps its item while it waits for a CPU,
although others are idle. An item that crashes every actor is never given up. A hanging actor is not detected.
"""

from __future__ import annotations

import contextlib
import re
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

import ray
from ray.exceptions import RayError

from lerobot_adamanip.collection.ray_cluster import node_versions, require_equal_versions
from lerobot_adamanip.util.jobs import (
    MAX_CONSECUTIVE_CRASHES,
    THREAD_LIMITS,
    Crashes,
    JobResult,
    RunningTime,
    Session,
    Work,
    WorkerError,
    error_text,
)

MAX_CRASHES = 3
"""Crashes after which an item is given up: one more than on one machine, because nodes may crash for other reasons."""
_POLL_SECONDS = 0.5


class SessionActor[Item]:
    """Actor that runs items on a node. It creates its session with the first item."""

    def __init__(self, session: Session[Item]) -> None:
        self._stack, self._session = contextlib.ExitStack(), session
        self._work: Work[Item] | None = None

    def greet(self) -> Mapping[str, str]:
        """Returns the node's `node_versions`."""
        return node_versions()

    def do(self, item: Item) -> tuple[str, object]:
        """Runs an item. Returns ``result`` and its value, or ``error`` and its text."""
        try:
            if self._work is None:
                self._work = self._stack.enter_context(self._session())
            return "result", self._work(item, lambda: None)  # no heartbeats: each item has a time limit instead
        except Exception as error:
            return "error", error_text(error)


@dataclass
class _Call[Item]:
    """Pending Ray call: a greeting (no item), or an item. ``started``: time of the executor's `RunningTime` [s]."""

    actor: Any
    started: float
    item: Item | None = None


class RayExecutor[Item]:
    """Runs items on actors of the connected cluster. Use as a context manager.

    An actor uses one CPU and runs one item at a time. If it crashes or exceeds the timeout, another actor restarts the
    item; after `MAX_CRASHES` the item is given up.

    Args:
        session: creates an actor's session; must be a module-level function or a partial of one.
        count: maximum number of actors.
        timeout: time limit of an item, after which it counts as a crash, and of waiting for the first free CPU [s].
    """

    def __init__(self, session: Session[Item], count: int, *, timeout: float) -> None:
        self._session, self._count, self._timeout = session, count, timeout
        self._versions = node_versions()
        self._running_time = RunningTime(2 * _POLL_SECONDS)
        self._queue: deque[Item] = deque()
        self._calls: dict[Any, _Call[Item]] = {}
        self._actors: list[Any] = []
        self._idle: list[Any] = []
        # A node that crashes takes all its actors with it.
        self._crashes = Crashes[Item](MAX_CRASHES, MAX_CONSECUTIVE_CRASHES + count)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for actor in list(self._actors):
            self._end(actor)
        self._calls.clear()

    def run(self, items: Iterable[Item]) -> Iterator[JobResult[Item]]:
        """Yields the result of each item, in order of completion; raises `WorkerError`."""
        self._queue = deque(items)
        while self._queue or self._running():
            while self._queue and self._idle:
                actor, item = self._idle.pop(), self._queue.popleft()
                self._calls[actor.do.remote(item)] = _Call(actor, self._running_time(), item)
            while len(self._actors) < min(self._count, len(self._queue) + self._running()):
                self._start_actor()
            ready, _ = ray.wait(list(self._calls), num_returns=1, timeout=_POLL_SECONDS)
            for reference in ready:
                yield from self._answered(self._calls.pop(reference), reference)
            yield from self._overdue()

    def _running(self) -> int:
        return sum(call.item is not None for call in self._calls.values())

    def _start_actor(self) -> None:
        options = {
            "num_cpus": 1, "max_restarts": 0, "max_task_retries": 0, "scheduling_strategy": "SPREAD",
            "runtime_env": {"env_vars": {**THREAD_LIMITS, "LP_NUM_THREADS": "1"}},
        }  # fmt: skip
        actor: Any = ray.remote(SessionActor).options(**options).remote(self._session)
        self._actors.append(actor)
        self._calls[actor.greet.remote()] = _Call(actor, self._running_time())

    def _answered(self, call: _Call[Item], reference: Any) -> Iterator[JobResult[Item]]:
        try:
            answer = ray.get(reference)
        except RayError as error:
            yield from self._crashed(call, crash(error), reason(error))
            return
        self._idle.append(call.actor)
        if call.item is None:
            require_equal_versions(self._versions, answer)
            return
        kind, value = answer
        if kind == "error":
            raise WorkerError(f"{call.item}: {value}")
        self._crashes.consecutive = 0
        yield JobResult(call.item, value, seconds=self._running_time() - call.started)

    def _overdue(self) -> Iterator[JobResult[Item]]:
        now = self._running_time()
        late = {key: call for key, call in self._calls.items() if now - call.started > self._timeout}
        late = {key: call for key, call in late.items() if not ray.wait([key], timeout=0)[0]}
        for reference, call in late.items():
            if call.item is not None:
                del self._calls[reference]
                cause = f"hung: it took more than {self._timeout:g} s"
                yield from self._crashed(call, cause, cause)
        if late and len(late) == len(self._calls) and not self._running():
            raise WorkerError(f"No CPU of the cluster became free within {self._timeout:g} s.")

    def _crashed(self, call: _Call[Item], cause: str, details: str) -> Iterator[JobResult[Item]]:
        """Releases an actor; its item is tried again or given up.

        Args:
            call: unanswered call.
            cause: cause of the crash, as stored in the dataset.
            details: Ray's message, for the screen.
        """
        self._end(call.actor)
        is_final = self._crashes.is_final(call.item, details)
        if is_final:
            yield JobResult(call.item, death=cause, seconds=self._running_time() - call.started)  # type: ignore[arg-type]
        elif call.item is not None:
            self._queue.appendleft(call.item)

    def _end(self, actor: Any) -> None:
        self._actors.remove(actor)
        with contextlib.suppress(RayError, ValueError):
            ray.kill(actor, no_restart=True)


def crash(error: RayError) -> str:
    """Returns the type of a crash and of the process exit, without addresses and ids, for a dataset."""
    kind = re.search(r"exit type: ([A-Z_]+)", str(error))
    return type(error).__name__ + (f", {kind[1]}" if kind else "")


def reason(error: RayError) -> str:
    """Returns Ray's message of a crash in one line; for the screen only."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:400]}"
