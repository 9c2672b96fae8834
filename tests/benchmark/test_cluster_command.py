"""A benchmark on a Ray cluster: its commands run on nodes, and come to what they come to on one machine."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import FAKE, FakeRunner, benchmark, results, run_all, templates
from two_nodes import TwoNodes

from lerobot_adamanip.benchmark.cluster_command import LOST, ClusterCommands, cluster_commands
from lerobot_adamanip.benchmark.command import Running
from lerobot_adamanip.util.errors import ConfigurationError

pytestmark = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")
LASTING = "import os, sys, time; open(sys.argv[1], 'w').write(str(os.getpid())); time.sleep(600)"
DRIVER = """
import sys, time
from pathlib import Path
from lerobot_adamanip.benchmark.cluster_command import cluster_commands
folder = Path(sys.argv[2])
with cluster_commands(sys.argv[1], folder, insecure=False, gpu=False) as commands:
    commands(sys.argv[3:], folder=folder, log=folder / "log", lock=0, threads=1)
    time.sleep(600)
"""


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoNodes]:
    made = TwoNodes(tmp_path_factory.mktemp("nodes"))
    yield made
    made.cluster.shutdown()


@pytest.fixture
def commands(nodes: TwoNodes, tmp_path: Path) -> Iterator[ClusterCommands]:
    nodes.fill()
    with cluster_commands(nodes.address, tmp_path / "out", insecure=False, gpu=False) as made:
        yield made


def until(holds: Callable[[], Any], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.05)


def lasting(commands: ClusterCommands, folder: Path) -> tuple[Running, int]:
    """A command that runs on a node, and its process."""
    line = [sys.executable, "-c", LASTING, str(folder / "pid")]
    running = commands(line, folder=folder, log=folder / "log", lock=0, threads=1)
    return running, its_process(folder)


def its_process(folder: Path) -> int:
    with contextlib.suppress(FileNotFoundError):
        until(lambda: (folder / "pid").exists() and (folder / "pid").read_text())
    return int((folder / "pid").read_text())


def runs(process: int) -> bool:
    """Whether a process runs, and is not one that has ended and that nobody has asked about."""
    with contextlib.suppress(FileNotFoundError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def test_it_comes_to_what_one_machine_comes_to(commands: ClusterCommands, tmp_path: Path) -> None:
    assert (commands.cores, commands.smallest) == (2, 1)
    run_all(benchmark(tmp_path / "whole", FakeRunner(tmp_path / "fake")))
    made = tmp_path / "fake" / "templates.json"
    made.write_text(json.dumps(templates()))

    def begin(command: Sequence[str], **given: Any) -> Running:
        return commands([sys.executable, "-I", "-S", str(FAKE), str(made), *command], **given)

    states = run_all(benchmark(tmp_path / "out", begin, jobs=2))  # type: ignore[arg-type]
    assert {each.state for each in states} == {"done"}
    assert results(tmp_path / "out") == results(tmp_path / "whole")


def test_two_commands_run_at_once_and_see_the_threads_they_have(commands: ClusterCommands, tmp_path: Path) -> None:
    code = "import os, sys, time; print(os.environ['OMP_NUM_THREADS'], os.getcwd()); time.sleep(3); sys.exit(3)"
    begin = time.monotonic()
    both = [
        commands([sys.executable, "-c", code], folder=tmp_path, log=tmp_path / f"log{number}", lock=0, threads=8)
        for number in range(2)
    ]
    until(lambda: all(each.poll() is not None for each in both))
    assert time.monotonic() - begin < 60
    assert [each.poll() for each in both] == [3, 3]
    for number in range(2):
        assert (tmp_path / f"log{number}").read_text().split() == ["1", str(tmp_path)]


def test_one_that_is_stopped_ends_on_its_node(commands: ClusterCommands, tmp_path: Path) -> None:
    running, process = lasting(commands, tmp_path)
    assert running.poll() is None
    running.stop()
    until(lambda: not runs(process))
    assert running.poll() == LOST
    assert "The command was lost" in (tmp_path / "log").read_text()


def test_one_whose_node_dies_is_told_as_lost(nodes: TwoNodes, commands: ClusterCommands, tmp_path: Path) -> None:
    running, process = lasting(commands, tmp_path)
    while len(nodes.nodes) > 0:
        nodes.power_cut()
    until(lambda: running.poll() is not None, 90)
    assert running.poll() == LOST
    until(lambda: not runs(process))
    nodes.fill()


def test_one_ends_with_the_worker_that_is_killed(commands: ClusterCommands, tmp_path: Path) -> None:
    running, process = lasting(commands, tmp_path)
    worker = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(worker, signal.SIGKILL)
    until(lambda: not runs(process))
    until(lambda: running.poll() is not None)
    assert running.poll() == LOST


def test_one_ends_with_the_benchmark_that_is_killed(nodes: TwoNodes, tmp_path: Path) -> None:
    nodes.fill()
    line = [sys.executable, "-c", LASTING, str(tmp_path / "pid")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    driver = subprocess.Popen([sys.executable, "-c", DRIVER, nodes.address, str(tmp_path), *line], env=environment)
    process = its_process(tmp_path)
    assert runs(process)
    driver.kill()
    driver.wait()
    until(lambda: not runs(process))


def test_a_folder_that_is_not_shared_is_refused(nodes: TwoNodes, tmp_path: Path, monkeypatch: Any) -> None:
    nodes.fill()
    monkeypatch.chdir(tmp_path)  # nodes have working folders of their own
    with (
        pytest.raises(ConfigurationError, match="does not share the benchmark's folder"),
        cluster_commands(nodes.address, Path("out"), insecure=False, gpu=False),
    ):
        pass
    assert list((tmp_path / "out").iterdir()) == []


def test_without_a_gpu_no_node_runs_what_needs_one(nodes: TwoNodes, tmp_path: Path) -> None:
    nodes.fill()
    with (
        pytest.raises(ConfigurationError, match="none with a CPU and a GPU"),
        cluster_commands(nodes.address, tmp_path / "out", insecure=False, gpu=True),
    ):
        pass
