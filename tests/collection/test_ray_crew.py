"""The crew on a Ray cluster: two nodes on loopback do what one process does, whatever becomes of them."""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demos_helpers import HERE, fakes, make_spec, patiently, same_bytes
from jobs_helpers import session
from two_nodes import TOKEN, TwoNodes

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.record import RecordingJob, recording_session
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.jobs import JobResult, WorkerError

DEATHS = 20
pytestmark = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")
SCRIPT = """
import sys
from pathlib import Path
from demos_helpers import fakes, make_spec, patiently
from lerobot_adamanip.collection.collect import collect
if __name__ == "__main__":
    root, address = sys.argv[1:]
    collect(Path(root), make_spec(), fakes(delay=0.2), patiently(workers=2, cluster=address))
"""


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoNodes]:
    made = TwoNodes(tmp_path_factory.mktemp("nodes"))
    yield made
    made.cluster.shutdown()


@pytest.fixture
def two(nodes: TwoNodes) -> TwoNodes:
    nodes.fill()
    return nodes


def run(two: TwoNodes, folder: Path, items: list[Any], **options: Any) -> list[JobResult[Any]]:
    from lerobot_adamanip.collection.ray_cluster import connected
    from lerobot_adamanip.collection.ray_executor import RayExecutor

    with connected(two.address, workers=2, insecure=False) as cpus:
        assert cpus == 2
        with RayExecutor[Any](functools.partial(session, folder), 2, **{"timeout": 60.0, **options}) as crew:
            return list(crew.run(items))


def test_two_nodes_record_what_one_process_does(tmp_path: Path, finished: Path, two: TwoNodes) -> None:
    root = tmp_path / "dataset"
    summary = collect(root, make_spec(), fakes(), patiently(workers=0, cluster=two.address))
    assert summary.recorded == 6
    same_bytes(finished, root)
    # Nothing was left in what a worker has for itself, and the token is in no file of Ray's.
    assert [path for path in two.folder.rglob("*") if path.is_file()] == []
    logs = Path(two.cluster.head_node.get_session_dir_path())
    assert not any(TOKEN.encode() in path.read_bytes() for path in logs.rglob("*") if path.is_file())


def test_no_worker_is_told_where_the_collection_lives(tmp_path: Path) -> None:
    job = RecordingJob(make_spec(), fakes(), 5, {"fake": "1"})
    sent = pickle.dumps(functools.partial(recording_session, job))
    assert str(tmp_path).encode() not in sent
    assert not any(isinstance(value, CollectionPaths) for value in vars(job).values())


@pytest.mark.nightly
def test_a_dead_a_hung_and_a_poisonous_item_cost_only_themselves(tmp_path: Path, two: TwoNodes) -> None:
    # Long enough for a new actor to start on a machine that is busy with other tests.
    results = {
        each.item: each for each in run(two, tmp_path, [1, "once:die", "always:die", 2, "once:hang", 3], timeout=20.0)
    }
    assert {item for item, each in results.items() if each.death is not None} == {"always:die"}
    assert str(results["always:die"].death).startswith("ActorDiedError")
    assert results["once:die"].value == "die"
    assert results["once:hang"].value == "hang"
    assert len(results) == 6


@pytest.mark.nightly
@pytest.mark.parametrize(("item", "told"), [("always:refuse", "no such thing"), ("always:break", "ZeroDivisionError")])
def test_an_error_that_is_the_works_own_ends_everything(tmp_path: Path, two: TwoNodes, item: str, told: str) -> None:
    with pytest.raises(WorkerError, match=told):
        run(two, tmp_path, [item])


@pytest.mark.nightly
def test_a_power_cut_and_a_killed_driver_cost_the_episodes_in_flight(
    tmp_path: Path, finished: Path, two: TwoNodes
) -> None:
    root = tmp_path / "dataset"
    process = start(tmp_path, root, two)
    wait_for_episodes(process, root, 1)
    two.power_cut()
    wait_for_episodes(process, root, 3)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = len(list(CollectionPaths(root).episodes.glob("*.safetensors")))
    summary = collect(root, make_spec(), fakes(), patiently(workers=1, cluster=two.address))
    assert summary.recorded == 6 - kept
    same_bytes(finished, root)


def wait_for_episodes(process: subprocess.Popen[bytes], root: Path, count: int) -> None:
    while len(list(CollectionPaths(root).episodes.glob("*.safetensors"))) < count:
        assert process.poll() is None
        time.sleep(0.02)


def start(folder: Path, root: Path, two: TwoNodes) -> subprocess.Popen[bytes]:
    script = folder / "collect_script.py"
    script.write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([HERE, *filter(None, sys.path)])}
    line = [sys.executable, str(script), str(root), two.address]
    return subprocess.Popen(line, start_new_session=True, env=environment)


def test_other_versions_and_another_token_are_refused(
    tmp_path: Path, two: TwoNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lerobot_adamanip.collection import ray_cluster as cluster
    from lerobot_adamanip.collection import ray_executor as ray_crew
    from lerobot_adamanip.collection import ray_nodes as node

    own = node.node_facts("driver")
    other = node.NodeFacts("driver", own.host, {**own.versions, "numpy": "1.0"})
    with monkeypatch.context() as patch:
        patch.setattr(ray_crew, "node_facts", lambda _: other)
        with pytest.raises(ConfigurationError, match="other versions: numpy"):
            run(two, tmp_path, [1])
    monkeypatch.setenv("RAY_AUTH_TOKEN", "0" * 32)
    with (
        pytest.raises(ConfigurationError, match="refuses the token"),
        cluster.connected(two.address, workers=1, insecure=False),
    ):
        pass


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_twenty_random_deaths_lose_nothing(tmp_path: Path, finished: Path, two: TwoNodes) -> None:
    """An actor's, a node's or the driver's, at a random moment; then the same call completes the collection."""
    rng, deaths = np.random.default_rng(0), []
    for number in range(DEATHS):
        two.fill()
        root = tmp_path / str(number) / "dataset"
        root.parent.mkdir()
        process = start(root.parent, root, two)
        kind = ("actor", "node", "driver")[number % 3]
        while not list(CollectionPaths(root).episodes.glob("*.safetensors")) and process.poll() is None:
            time.sleep(0.02)
        time.sleep(float(rng.uniform(0.0, 1.0)))
        before = {path.name: path.read_bytes() for path in CollectionPaths(root).episodes.glob("*.safetensors")}
        deaths.append((kind, end_one(kind, process, two)))
        if kind != "driver":
            assert process.wait(120) == 0
        elif not root.exists():
            after = {path.name: path.read_bytes() for path in CollectionPaths(root).episodes.glob("*.safetensors")}
            assert before.items() <= after.items()
            collect(root, make_spec(), fakes(), patiently(workers=2, cluster=two.address))
        same_bytes(finished, root)
    print(json.dumps(deaths))
    assert sum(died for _, died in deaths) >= DEATHS // 2


def end_one(kind: str, process: subprocess.Popen[bytes], two: TwoNodes) -> bool:
    """Ends an actor, a node or the driver; returns whether there was one at work."""
    if kind == "driver":
        alive = process.poll() is None
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return alive
    if kind == "node":
        two.power_cut()
        return process.poll() is None
    actors = [
        int(path.parent.name) for path in Path("/proc").glob("[0-9]*/cmdline") if b"SessionActor" in _content(path)
    ]
    for pid in actors[:1]:
        os.kill(pid, signal.SIGKILL)
    return bool(actors)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


@pytest.mark.nightly
def test_a_run_with_given_up_items_says_so(tmp_path: Path, two: TwoNodes) -> None:
    spec = make_spec(episodes_per_object=1)
    options = patiently(workers=2, cluster=two.address)
    with pytest.raises(DatasetError, match="its worker died twice"):
        collect(tmp_path / "dataset", spec, fakes(crash="safe_001"), options)


def test_what_a_dataset_says_of_a_crash_names_no_machine() -> None:
    """Attempts are published with the dataset; what Ray tells beside it is for the screen."""
    from ray.exceptions import NodeDiedError, RayError

    from lerobot_adamanip.collection.ray_executor import crash, reason

    told = "The actor died. pid: 4242 namespace: ns-abc ip: 10.20.30.40 Worker exit type: SYSTEM_ERROR"
    assert crash(RayError(told)) == "RayError, SYSTEM_ERROR"
    assert crash(NodeDiedError("ip: 10.20.30.40 exit type: /home/me")) == "NodeDiedError"
    assert "10.20.30.40" in reason(RayError(told))
