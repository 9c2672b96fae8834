"""Which clusters are used: none without Ray, none that can be reached and is open. No cluster is started here."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.collection.collect import CollectOptions
from lerobot_adamanip.collection.item_queue import ItemQueue
from lerobot_adamanip.collection.ray_cluster import (
    connected,
    is_loopback,
    require_address,
    require_closed,
    require_token,
)
from lerobot_adamanip.collection.ray_nodes import EQUAL, NodeFacts, node_facts, require_equal_versions
from lerobot_adamanip.util.errors import ConfigurationError

# Stands for a machine on which the extra is not installed.
WITHOUT_RAY = """
import sys
class Absent:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] == "ray":
            raise ModuleNotFoundError("No module named 'ray'", name="ray")
sys.meta_path.insert(0, Absent)
from lerobot_adamanip.cli.main import main
sys.exit(main(["collect", sys.argv[1], "--cluster", "local"]))
"""


def test_without_ray_the_error_names_the_extra(tmp_path: Path) -> None:
    line = [sys.executable, "-c", WITHOUT_RAY, str(tmp_path / "dataset")]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "lerobot_env_adamanip[cluster]" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_collecting_on_one_machine_imports_no_ray() -> None:
    code = "import lerobot_adamanip.cli.collect, lerobot_adamanip.collection.collect, sys; print('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


@pytest.mark.parametrize(
    ("address", "loopback"),
    [("127.0.0.1:6379", True), ("localhost:1", True), ("[::1]:6379", True), ("127.1.2.3:1", True),
     ("10.0.0.5:6379", False), ("head:6379", False), ("0.0.0.0:6379", False), ("localhost.evil.org:1", False)],
)  # fmt: skip
def test_what_only_this_machine_reaches(address: str, loopback: bool) -> None:
    require_address(address)
    assert is_loopback(address) == loopback


@pytest.mark.parametrize("address", ["", "head", "ray://head:10001", "head:6379; rm", "--x:1", "head:", "a b:1"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ConfigurationError, match="HOST:PORT"):
        require_address(address)


def test_a_cluster_that_can_be_reached_demands_a_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    absent = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(tmp_path / "none")}
    for environment in ({}, {"RAY_AUTH_MODE": "token"}, {"RAY_AUTH_TOKEN": "x"}, {"RAY_AUTH_MODE": "disabled"}, absent):
        with pytest.raises(ConfigurationError, match="no token is set") as caught:
            require_token(environment)
        assert "ray get-auth-token --generate" in str(caught.value)
        assert "--insecure-cluster" in str(caught.value)
    (tmp_path / "token").write_text("secret")
    require_token({"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(tmp_path / "token")})
    require_token({"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "secret"})


def test_the_token_is_asked_for_before_anything_is_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("lerobot_adamanip.collection.ray_cluster._answer", lambda *_: pytest.fail("asked"))
    monkeypatch.setattr("lerobot_adamanip.collection.ray_cluster.require_ray", lambda: None)
    for address in ("192.0.2.1:6379", "auto"):
        with pytest.raises(ConfigurationError, match="no token"), connected(address, workers=1, insecure=False):
            pass


def test_an_open_cluster_is_refused_whatever_token_we_have(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "secret")
    asked = []

    def answer(address: str, environment: dict[str, str]) -> str:
        asked.append({name: value for name, value in environment.items() if name.startswith("RAY_AUTH")})
        return "open"

    monkeypatch.setattr("lerobot_adamanip.collection.ray_cluster._answer", answer)
    with pytest.raises(ConfigurationError, match="open"):
        require_closed("192.0.2.1:6379")
    assert asked[-1] == {"RAY_AUTH_MODE": "disabled"}


def test_versions_that_differ_are_named() -> None:
    driver = node_facts("driver")
    require_equal_versions(driver, NodeFacts("n", "other", driver.versions))
    for name in EQUAL:
        with pytest.raises(ConfigurationError, match=f"other versions: {name}") as caught:
            require_equal_versions(driver, NodeFacts("n", "node7", {**driver.versions, name: "0.0"}))
        assert "node7" in str(caught.value)


def test_as_many_workers_as_the_cluster_has_need_a_cluster(tmp_path: Path) -> None:
    assert CollectOptions(workers=0, cluster="local").workers == 0
    assert main(["collect", str(tmp_path / "d"), "--workers", "0"]) == 2


def test_items_are_taken_of_the_present_category_and_then_of_the_largest() -> None:
    queue = ItemQueue(["a1", "b1", "b2", "a2", "b3"], lambda item: item[0])
    assert queue.take(None) == ("b1", "b")
    assert queue.take("a") == ("a1", "a")
    queue.put_back("a1")
    assert [queue.take("a")[0] for _ in range(4)] == ["a1", "a2", "b2", "b3"]
    assert len(queue) == 0
