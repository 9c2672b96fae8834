"""Actors on a Ray cluster.

Ray is imported only here and in `ray_cluster`.

An actor is what a worker of `lerobot_adamanip.util.jobs.WorkerPool` is here: it holds what a session makes from item to
item. Items go to it and results come back; nothing is read from or written to a folder that machines would share.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Self, cast

import ray
from ray.exceptions import RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from lerobot_adamanip.collection.item_queue import ItemQueue
from lerobot_adamanip.collection.ray_nodes import NodeFacts, node_facts, require_equal_versions
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError
from lerobot_adamanip.util.jobs import MAX_DEATHS, MAX_DEATHS_IN_A_ROW, JobResult, Session, Work, WorkerError

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "LP_NUM_THREADS")
"""One thread each, for an actor has one core: arithmetic then takes its sums in one order, wherever it runs."""
_POLL_SECONDS = 0.5
_VERDICT_SECONDS = 60.0
"""A node that does not run a trivial task for so long is taken for dead [s]."""


class SessionActor[Item]:
    """What runs in an actor's process. It makes its session with the first item."""

    def __init__(self, session: Session[Item]) -> None:
        self._stack = contextlib.ExitStack()
        self._session = session
        self._work: Work[Item] | None = None

    def greet(self) -> NodeFacts:
        """Returns where this is, and which versions are installed there."""
        return node_facts(ray.get_runtime_context().get_node_id())

    def do(self, item: Item, content: object) -> tuple[str, object]:
        """Runs an item: ``result`` and its value, or ``error`` and its text, so that no exception travels."""
        try:
            if self._work is None:
                self._work = self._stack.enter_context(self._session())
            return "result", self._work(cast("Item", item if content is None else content), _no_beat)
        except Exception as error:  # the driver shows it
            return "error", str(error) if isinstance(error, AdaManipError) else traceback.format_exc()


def _no_beat() -> None:
    """Signs of life would need a second channel: an item as a whole has a time limit instead."""


def _nothing() -> None:
    """What a node has to run to be taken for alive."""


@dataclass(eq=False)
class _Actor:
    handle: Any
    node: str | None = None
    category: str | None = None


@dataclass
class _Call[Item]:
    """Something Ray will answer: a greeting (no item), an item, or (``death`` set) whether its node still lives."""

    actor: _Actor
    item: Item | None = None
    death: str | None = None
    begin: float = field(default_factory=time.monotonic)
    worked: float = 0.0


class RayExecutor[Item]:
    """Runs items on actors of the cluster that this process is connected to. Use as a context manager.

    An actor has one CPU of the cluster and one item at a time. One that dies, or works on an item for too long, costs
    that item's work so far: the item goes to another one, and is given up if it takes two with it. Where a whole node
    died, items are not the cause. Six consecutive crashes, or an error of the work itself, end everything.

    Args:
        session: makes what an actor holds from item to item; a function of a module, or a partial of one, that travels.
        count: of actors at most.
        timeout: a longer work on one item [s] is taken for hanging, and so is longer waiting for a first free CPU.
        category: an actor gets items of its last one's category while there are any, else of the largest one left.
        load: makes of an item what an actor gets, where that is too large to be kept for all items.
    """

    def __init__(
        self,
        session: Session[Item],
        count: int,
        *,
        timeout: float,
        category: Callable[[Item], str] = lambda item: "",
        load: Callable[[Item], object] | None = None,
    ) -> None:
        if count < 1 or not timeout > 0:
            raise ConfigurationError(
                "No such executor.",
                got=f"{count} actors, timeout {timeout} s",
                allowed="1 or more, above 0",
                hint="--workers 2",
            )
        self._session, self._count, self._timeout = session, count, timeout
        self._category, self._load = category, load
        self._expected = node_facts("driver")
        self._calls: dict[Any, _Call[Item]] = {}
        self._actors: list[_Actor] = []
        self._deaths: dict[Item, int] = {}
        self._deaths_in_a_row = self._failed_starts = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for actor in self._actors:
            _kill(actor)
        self._actors.clear()
        self._calls.clear()

    def run(self, items: Iterable[Item]) -> Iterator[JobResult[Item]]:
        """Yields the result of each item, in the order they finish; raises `WorkerError`."""
        queue = ItemQueue(items, self._category)
        idle: list[_Actor] = []
        while queue or any(call.item is not None for call in self._calls.values()):
            while queue and idle:
                self._assign(idle.pop(), queue)
            self._recruit(queue)
            ready, _ = ray.wait(list(self._calls), num_returns=1, timeout=_POLL_SECONDS)
            for reference in ready:
                call = self._calls.pop(reference)
                yield from self._answered(call, reference, queue, idle)
            self._overdue(queue)

    def _recruit(self, queue: ItemQueue[Item]) -> None:
        """Asks for as many actors as there is work for."""
        working = sum(call.item is not None and call.death is None for call in self._calls.values())
        while len(self._actors) < min(self._count, len(queue) + working):
            options = {
                "num_cpus": 1, "max_restarts": 0, "max_task_retries": 0, "scheduling_strategy": "SPREAD",
                "runtime_env": {"env_vars": dict.fromkeys(THREADS, "1")},
            }  # fmt: skip
            actor = _Actor(ray.remote(SessionActor).options(**options).remote(self._session))
            self._actors.append(actor)
            self._calls[actor.handle.greet.remote()] = _Call(actor)

    def _assign(self, actor: _Actor, queue: ItemQueue[Item]) -> None:
        item, actor.category = queue.take(actor.category)
        content = None if self._load is None else self._load(item)
        self._calls[actor.handle.do.remote(item, content)] = _Call(actor, item)

    def _answered(
        self, call: _Call[Item], reference: Any, queue: ItemQueue[Item], idle: list[_Actor]
    ) -> Iterator[JobResult[Item]]:
        try:
            answer = ray.get(reference)
        except RayError as error:
            if call.death is not None:
                self._node_died(call, queue)
            else:
                self._died(call, crash(error), reason(error))
            return
        if call.death is not None:
            yield from self._actor_died(call, queue)
            return
        if call.item is None:
            require_equal_versions(self._expected, answer)
            call.actor.node, self._failed_starts = answer.node, 0
        else:
            kind, value = cast("tuple[str, object]", answer)
            if kind == "error":
                raise WorkerError(f"{call.item}: {value}")
            self._deaths_in_a_row = 0
            yield JobResult(call.item, value, seconds=time.monotonic() - call.begin)
        idle.append(call.actor)

    def _overdue(self, queue: ItemQueue[Item]) -> None:
        now = time.monotonic()
        for reference, call in list(self._calls.items()):
            waited = now - call.begin
            if call.death is not None and waited > _VERDICT_SECONDS:
                del self._calls[reference]
                self._node_died(call, queue)
            elif call.death is None and call.item is not None and waited > self._timeout:
                del self._calls[reference]
                self._died(call, f"hung: it took more than {self._timeout:g} s")
        if all(call.item is None and now - call.begin > self._timeout for call in self._calls.values()) and self._calls:
            raise WorkerError(f"No CPU of the cluster became free within {self._timeout:g} s.")

    # Deaths -----------------------------------------------------------------------------------------------------

    def _died(self, call: _Call[Item], cause: str, told: str = "") -> None:
        """Lets an actor go, and asks whether its node still lives, to tell which of the two crashed.

        Args:
            call: that it did not answer.
            cause: of the crash, as a dataset may say it.
            told: by Ray, for the screen.
        """
        _kill(call.actor)
        self._actors.remove(call.actor)
        if call.actor.node is None:
            self._failed_starts += 1
            # One node's death may end all starts once; what cannot be imported there cannot be the next time either.
            if "creation task" in told or self._failed_starts > MAX_DEATHS_IN_A_ROW + self._count:
                raise WorkerError(f"No worker starts on a node of the cluster: {told or cause}")
            return
        alone = NodeAffinitySchedulingStrategy(call.actor.node, soft=False)
        ping = ray.remote(_nothing).options(num_cpus=0, max_retries=0, scheduling_strategy=alone).remote()
        self._calls[ping] = _Call(call.actor, call.item, death=cause, worked=time.monotonic() - call.begin)

    @staticmethod
    def _node_died(call: _Call[Item], queue: ItemQueue[Item]) -> None:
        if call.item is not None:
            queue.put_back(call.item)

    def _actor_died(self, call: _Call[Item], queue: ItemQueue[Item]) -> Iterator[JobResult[Item]]:
        self._deaths_in_a_row += 1
        if self._deaths_in_a_row >= MAX_DEATHS_IN_A_ROW:
            raise WorkerError(
                f"{self._deaths_in_a_row} workers in a row ended by themselves, the last one: {call.death}"
            )
        if call.item is None:
            return
        self._deaths[call.item] = self._deaths.get(call.item, 0) + 1
        if self._deaths[call.item] < MAX_DEATHS:
            queue.put_back(call.item)
        else:
            yield JobResult(call.item, death=call.death, seconds=call.worked)


def _kill(actor: _Actor) -> None:
    with contextlib.suppress(RayError, ValueError):
        ray.kill(actor.handle, no_restart=True)


EXIT_KINDS = ("INTENDED_USER_EXIT", "INTENDED_SYSTEM_EXIT", "NODE_OUT_OF_MEMORY", "SYSTEM_ERROR", "USER_ERROR")
"""How Ray says that a process has ended."""


def crash(error: RayError) -> str:
    """Returns the type of a crash and how the process ended: what a dataset may say, without addresses and ids."""
    kind = next((name for name in EXIT_KINDS if f"exit type: {name}" in str(error)), None)
    return type(error).__name__ + (f", {kind}" if kind else "")


def reason(error: RayError) -> str:
    """Returns what Ray says of a crash, in one line; for the screen only."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {' '.join(lines)[:400]}"
