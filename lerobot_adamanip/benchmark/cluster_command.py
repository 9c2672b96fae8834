"""Running the commands of a benchmark on a Ray cluster whose nodes share the benchmark's folder.

Ray says where a command runs and when; what it makes lies in the folder, as it does on one machine. Collecting runs
here: `adamanip collect --cluster` hands its episodes to the cluster itself.
"""

from __future__ import annotations

import contextlib
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.benchmark.command import Running, begun, ended, run_command
from lerobot_adamanip.collection.ray_cluster import connected
from lerobot_adamanip.collection.ray_nodes import NodeFacts, node_facts, require_equal_versions
from lerobot_adamanip.util.errors import ConfigurationError

LOCAL_PROGRAM = "adamanip"
_POLL_SECONDS, _STOP_SECONDS, _GREETING_SECONDS = 0.1, 30.0, 120.0
LOST = 70
"""Status of a command that was lost with its node."""


@dataclass(frozen=True)
class ClusterCommands:
    """Begins commands on the nodes of the cluster that this process is connected to; a `command.Runner`.

    Attributes:
        cores: CPUs of the cluster.
        smallest: CPUs of its smallest node, the most that a command gets.
        gpu: each command gets a GPU of its own.
    """

    cores: int
    smallest: int
    gpu: bool = False

    def __call__(self, command: Sequence[str], *, folder: Path, log: Path, lock: int, threads: int) -> Running:
        """Begins a command; see `Runner`. Ray ends it with the worker that began it, and with this process."""
        if command[0] == LOCAL_PROGRAM:
            return run_command(command, folder=folder, log=log, lock=lock, threads=threads)
        import ray

        taken = min(threads or self.smallest, self.smallest)
        options = {"num_cpus": taken, "num_gpus": int(self.gpu), "max_retries": 0, "scheduling_strategy": "SPREAD"}
        there = ray.remote(_run).options(**options)
        return _RemoteCommand(there.remote(list(command), str(folder), str(log), taken), log)


@contextlib.contextmanager
def cluster_commands(address: str, folder: Path, *, insecure: bool, gpu: bool) -> Iterator[ClusterCommands]:
    """Connects to a cluster, and yields what begins commands on it.

    Args:
        address: as of `lerobot_adamanip.collection.ray_cluster.connected`.
        folder: of the benchmark; made if it is not there.
        insecure: go on without a token.
        gpu: each command needs a GPU.

    Raises:
        ConfigurationError: there is no such cluster, a node does not share the folder or has other versions, or none
            has a GPU where one is needed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with connected(address, workers=0, insecure=insecure) as cores:
        smallest = _require_nodes(folder, gpu=gpu)
        yield ClusterCommands(cores, smallest, gpu)


def _require_nodes(folder: Path, *, gpu: bool) -> int:
    """Returns the CPUs of the smallest node that has any; raises as `cluster_commands` does."""
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    found: list[Mapping[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call,unused-ignore]
    wanted = ("CPU", "GPU") if gpu else ("CPU",)
    nodes = [node for node in found if node["Alive"] and all(node["Resources"].get(kind) for kind in wanted)]
    if not nodes:
        raise ConfigurationError(
            "No node of the cluster can run a command.",
            got=f"{len(found)} nodes, none with {'a CPU and a GPU' if gpu else 'a CPU'}",
            allowed="nodes with CPUs, and with a GPU each for a scale of the device cuda",
            hint="ray status",
        )
    mark = folder / f".shared-{secrets.token_hex(8)}"
    mark.write_bytes(b"")
    try:
        greetings = [
            ray.remote(_greet)
            .options(num_cpus=0, scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False))
            .remote(node["NodeID"], str(mark))
            for node in nodes
        ]
        here = node_facts("driver")
        for facts, sees in _answers(greetings):
            require_equal_versions(here, facts)
            if not sees:
                raise ConfigurationError(
                    "A node of the cluster does not share the benchmark's folder.",
                    got=f"{facts.host} finds no {folder}",
                    allowed="a folder that every node has under the same path, as of a network file system",
                    hint="--out /a/shared/folder; or each machine its own --methods or --categories, without --cluster",
                )
    finally:
        mark.unlink(missing_ok=True)
    return min(int(node["Resources"]["CPU"]) for node in nodes)


def _answers(greetings: Sequence[Any]) -> list[tuple[NodeFacts, bool]]:
    import ray
    from ray.exceptions import RayError

    from lerobot_adamanip.collection.ray_executor import reason

    try:
        answers: list[tuple[NodeFacts, bool]] = ray.get(list(greetings), timeout=_GREETING_SECONDS)
    except RayError as error:
        raise ConfigurationError(
            "A node of the cluster does not answer.",
            got=reason(error),
            allowed=f"an answer from every node within {_GREETING_SECONDS:g} s, with this package installed on it",
            hint="ray status; the same packages on every node (pip install -c constraints.txt)",
        ) from error
    return answers


def _greet(node: str, mark: str) -> tuple[NodeFacts, bool]:
    """Returns what a node has, and whether it sees a file."""
    return node_facts(node), Path(mark).exists()


def _run(command: Sequence[str], folder: str, log: str, threads: int) -> int:
    """Runs a command on the node that Ray has chosen, and returns its exit status."""
    process = begun(command, folder=Path(folder), log=Path(log), threads=threads)
    try:
        while (status := process.poll()) is None:
            time.sleep(_POLL_SECONDS)  # a wait that cannot be interrupted would outlast Ray's `cancel`
    finally:
        ended(process)
    return status


@dataclass
class _RemoteCommand:
    """A command on some node."""

    reference: Any
    log: Path
    status: int | None = None

    def poll(self) -> int | None:
        import ray
        from ray.exceptions import RayError

        from lerobot_adamanip.collection.ray_executor import reason

        if self.status is None and ray.wait([self.reference], timeout=0)[0]:
            try:
                self.status = int(ray.get(self.reference))
            except RayError as error:
                with self.log.open("a", encoding="utf-8") as said:
                    said.write(f"The command was lost: {reason(error)}\n")
                self.status = LOST
        return self.status

    def stop(self) -> None:
        import ray

        if self.poll() is None:
            ray.cancel(self.reference, force=False)
            if not ray.wait([self.reference], timeout=_STOP_SECONDS)[0]:
                ray.cancel(self.reference, force=True)
