"""Recording on a Ray cluster: which clusters are used; two nodes on loopback do the work of one process."""

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
from demos_helpers import HERE, fakes, finished_shards, make_spec, patiently, same_bytes
from jobs_helpers import session
from two_nodes import TOKEN, TwoNodes

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.collection import ray_cluster
from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.collection.ray_cluster import EQUAL, connected, node_versions, require_equal_versions
from lerobot_adamanip.collection.record import RecordingJob, recording_session
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.jobs import JobResult, WorkerError

CRASHES = 20
needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")
SCRIPT = """
import sys
from pathlib import Path
from demos_helpers import fakes, make_spec, patiently
from lerobot_adamanip.collection.collect import collect
if __name__ == "__main__":
    root, address = sys.argv[1:]
    collect(Path(root), make_spec(), fakes(delay=0.2), patiently(workers=2, cluster=address))
"""


# Which clusters are used ----------------------------------------------------------------------------------------------


def test_without_ray_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["collect", str(tmp_path / "dataset"), "--cluster", "local"]) == 2
    assert "lerobot_env_adamanip[cluster]" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_collecting_on_one_machine_imports_no_ray() -> None:
    code = "import lerobot_adamanip.cli.collect, lerobot_adamanip.collection.collect, sys; print('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


@pytest.mark.parametrize(
    ("address", "loopback"),
    [("127.0.0.1:6379", True), ("localhost:1", True), ("[::1]:6379", True), ("127.1.2.3:1", True),
     ("10.0.0.5:6379", False), ("head:6379", False), ("0.0.0.0:6379", False), ("localhost.evil.org:1", False)],
)  # fmt: skip
def test_a_cluster_that_others_reach_needs_a_token(
    address: str, loopback: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(ray_cluster, "_answer", lambda *_: pytest.fail("something was sent"))
    monkeypatch.setenv("HOME", str(tmp_path))
    absent = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(tmp_path / "none")}
    (tmp_path / "token").write_text("secret")
    given = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(tmp_path / "token")}
    for environment in ({}, {"RAY_AUTH_MODE": "token"}, {"RAY_AUTH_TOKEN": "x"}, {"RAY_AUTH_MODE": "disabled"}, absent):
        monkeypatch.setattr(ray_cluster.os, "environ", environment)
        if loopback:
            ray_cluster.require_usable(address, insecure=False)
            continue
        with pytest.raises(ConfigurationError, match="no token is set"), connected(address, workers=1, insecure=False):
            pass
        ray_cluster.require_usable(address, insecure=True)
    for environment in (given, {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "secret"}):
        monkeypatch.setattr(ray_cluster.os, "environ", environment)
        ray_cluster.require_usable(address, insecure=False)


@pytest.mark.parametrize("address", ["", "head", "ray://head:10001", "head:6379; rm", "--x:1", "head:", "a b:1"])
def test_what_is_no_address_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    with pytest.raises(ConfigurationError, match="HOST:PORT"):
        ray_cluster.require_usable(address, insecure=True)


def test_an_open_cluster_is_refused_whatever_token_we_have(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "secret")
    asked = []

    def answer(address: str, environment: dict[str, str]) -> str:
        asked.append({name: value for name, value in environment.items() if name.startswith("RAY_AUTH")})
        return "open"

    monkeypatch.setattr(ray_cluster, "_answer", answer)
    with pytest.raises(ConfigurationError, match="open"):
        ray_cluster.require_closed("192.0.2.1:6379")
    assert asked == [{"RAY_AUTH_MODE": "disabled"}]


def test_versions_that_differ_are_named() -> None:
    driver = node_versions()
    require_equal_versions(driver, {**driver, "host": "another"})
    for name in EQUAL:
        with pytest.raises(ConfigurationError, match=rf"(?s)other versions: {name}\..*node7"):
            require_equal_versions(driver, {**driver, "host": "node7", name: "0.0"})


def test_only_a_cluster_has_a_number_of_workers_of_its_own(tmp_path: Path) -> None:
    assert CollectOptions(workers=0, cluster="local").workers == 0
    assert main(["collect", str(tmp_path / "d"), "--workers", "0"]) == 2


def test_no_worker_is_told_where_the_collection_lives(tmp_path: Path) -> None:
    job = RecordingJob(make_spec(), fakes(), 5, {"fake": "1"})
    assert str(tmp_path).encode() not in pickle.dumps(functools.partial(recording_session, job))
    assert not any(isinstance(value, CollectionPaths) for value in vars(job).values())


# Two nodes ------------------------------------------------------------------------------------------------------------


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
    from lerobot_adamanip.collection.ray_executor import RayExecutor

    with connected(two.address, workers=2, insecure=False) as cpus:
        assert cpus == 2
        with RayExecutor[Any](functools.partial(session, folder), 2, **{"timeout": 60.0, **options}) as executor:
            return list(executor.run(items))


@needs_ray
def test_two_nodes_record_what_one_process_does(tmp_path: Path, finished: Path, two: TwoNodes) -> None:
    root = tmp_path / "dataset"
    summary = collect(root, make_spec(), fakes(), patiently(workers=0, cluster=two.address))
    assert summary.recorded == 6
    same_bytes(finished, root)
    # Nothing is left in a worker's own folders, and the token is in no file of Ray's.
    assert [path for path in two.folder.rglob("*") if path.is_file()] == []
    logs = Path(two.cluster.head_node.get_session_dir_path())
    assert not any(TOKEN.encode() in path.read_bytes() for path in logs.rglob("*") if path.is_file())


@needs_ray
@pytest.mark.nightly
def test_crashes_and_hangs_cost_only_what_causes_them(tmp_path: Path, two: TwoNodes) -> None:
    # Long enough for a new actor to start on a machine that is busy with other tests.
    results = run(two, tmp_path, [1, "once:die", "always:die", 2, "once:hang", 3], timeout=20.0)
    given_up = {each.item: each.death for each in results if each.death is not None}
    assert list(given_up) == ["always:die"]
    assert str(given_up["always:die"]).startswith("ActorDiedError")
    values = {each.item: each.value for each in results}
    assert (values["once:die"], values["once:hang"]) == ("die", "hang")
    assert len(results) == 6


@needs_ray
@pytest.mark.nightly
@pytest.mark.parametrize(("item", "text"), [("always:refuse", "no such thing"), ("always:break", "ZeroDivisionError")])
def test_an_error_of_the_work_itself_ends_everything(tmp_path: Path, two: TwoNodes, item: str, text: str) -> None:
    with pytest.raises(WorkerError, match=text):
        run(two, tmp_path, [item])


@needs_ray
def test_other_versions_and_another_token_are_refused(
    tmp_path: Path, two: TwoNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lerobot_adamanip.collection import ray_executor

    with monkeypatch.context() as patch:
        patch.setattr(ray_executor, "node_versions", lambda: {**node_versions(), "numpy": "1.0"})
        with pytest.raises(ConfigurationError, match="other versions: numpy"):
            run(two, tmp_path, [1])
    monkeypatch.setenv("RAY_AUTH_TOKEN", "0" * 32)
    with pytest.raises(ConfigurationError, match="refuses the token"):
        run(two, tmp_path, [1])


@needs_ray
@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_twenty_random_crashes_lose_nothing(tmp_path: Path, finished: Path, two: TwoNodes) -> None:
    """Of an actor, a node or the driver, at a random moment; then the same call completes the collection."""
    rng, crashes = np.random.default_rng(0), []
    for number in range(CRASHES):
        two.fill()
        root = tmp_path / str(number) / "dataset"
        root.parent.mkdir()
        process = start(root.parent, root, two)
        kind = ("actor", "node", "driver")[number % 3]
        while not finished_shards(root) and process.poll() is None:
            time.sleep(0.02)
        time.sleep(float(rng.uniform(0.0, 1.0)))
        before = finished_shards(root)
        crashes.append((kind, end_one(kind, process, two)))
        if kind != "driver":
            assert process.wait(120) == 0
        elif not root.exists():
            assert before.items() <= finished_shards(root).items()
            collect(root, make_spec(), fakes(), patiently(workers=2, cluster=two.address))
        same_bytes(finished, root)
    print(json.dumps(crashes))
    assert sum(crashed for _, crashed in crashes) >= CRASHES // 2


def start(folder: Path, root: Path, two: TwoNodes) -> subprocess.Popen[bytes]:
    script = folder / "collect_script.py"
    script.write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([HERE, *filter(None, sys.path)])}
    line = [sys.executable, str(script), str(root), two.address]
    return subprocess.Popen(line, start_new_session=True, env=environment)


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
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if b"SessionActor" in path.read_bytes():
                os.kill(int(path.parent.name), signal.SIGKILL)
                return True
        except OSError:  # it has ended
            continue
    return False


@needs_ray
def test_what_a_dataset_says_of_a_crash_names_no_machine() -> None:
    """Attempts are published with the dataset; what Ray tells beside it is for the screen."""
    from ray.exceptions import NodeDiedError, RayError

    from lerobot_adamanip.collection.ray_executor import crash, reason

    text = "The actor died. pid: 4242 namespace: ns-abc ip: 10.20.30.40 Worker exit type: SYSTEM_ERROR"
    assert crash(RayError(text)) == "RayError, SYSTEM_ERROR"
    assert crash(NodeDiedError("ip: 10.20.30.40 exit type: /home/me")) == "NodeDiedError"
    assert "10.20.30.40" in reason(RayError(text))
