"""`jobs`: every item is done once, whatever becomes of the processes that do it."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from jobs_helpers import session

from lerobot_adamanip.util import jobs
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.jobs import JobResult, WorkerError, WorkerPool


@pytest.fixture(autouse=True, params=["spawned", "copied"])
def start(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How workers start; whatever becomes of them is the same."""
    monkeypatch.setattr(jobs, "_preloaded", [])
    if request.param == "copied":
        jobs.preload("jobs_helpers", "no_such_module")
    return str(request.param)


def run(folder: Path, items: list[Any], count: int = 1, **options: Any) -> list[JobResult[Any]]:
    done = options.pop("done", lambda item: False)
    with WorkerPool[Any](functools.partial(session, folder), count, **options) as pool:
        return list(pool.run(items, done=done))


def started(folder: Path) -> int:
    return len(list(folder.glob("session-*")))


def test_every_item_is_done_once_by_few_processes(tmp_path: Path) -> None:
    results = run(tmp_path, list(range(8)), count=2)
    assert {result.item: result.value[0] for result in results} == {n: n * n for n in range(8)}  # type: ignore[index]
    assert len({result.value[1] for result in results}) <= 2  # type: ignore[index]
    assert started(tmp_path) == 2
    assert len(list(tmp_path.glob("ended-*"))) == 2  # what a session holds is let go of


def test_what_is_done_is_not_done_again(tmp_path: Path) -> None:
    results = run(tmp_path, list(range(6)), done=lambda item: item % 2 == 0)
    assert sorted(result.item for result in results) == [1, 3, 5]
    assert run(tmp_path, [1, 2], done=lambda item: True) == []


def test_a_death_costs_one_process_and_nothing_else(tmp_path: Path) -> None:
    results = run(tmp_path, [1, "once:die", 2])
    assert [result.value for result in results if result.item == "once:die"] == ["die"]
    assert {result.item for result in results} == {1, 2, "once:die"}
    assert all(result.death is None for result in results)


def test_an_item_that_kills_its_workers_is_given_up(tmp_path: Path) -> None:
    results = {result.item: result for result in run(tmp_path, [1, "always:die", 2])}
    assert results["always:die"].death == "signal SIGKILL"
    assert results[2].value is not None
    assert started(tmp_path) == 3


def test_a_worker_that_hangs_is_noticed_and_replaced(tmp_path: Path) -> None:
    begin = time.monotonic()
    results = {result.item: result for result in run(tmp_path, ["once:hang", 3], timeout=2.0)}
    assert results["once:hang"].value == "hang"
    assert results["once:hang"].death is None
    assert time.monotonic() - begin < 60


def test_what_always_hangs_is_given_up_with_the_reason(tmp_path: Path) -> None:
    (result,) = run(tmp_path, ["always:hang"], timeout=1.5)
    assert "no heartbeat for 1.5 s" in str(result.death)


def test_slow_work_that_gives_signs_of_life_is_let_alone(tmp_path: Path) -> None:
    (result,) = run(tmp_path, ["always:slow"], timeout=5.0)
    assert result.value == "slow"
    assert result.seconds > 5.0
    assert started(tmp_path) == 1


@pytest.mark.parametrize(("item", "told"), [("always:refuse", "no such thing"), ("always:break", "ZeroDivisionError")])
def test_an_error_that_is_the_works_own_ends_everything(tmp_path: Path, item: str, told: str) -> None:
    with pytest.raises(WorkerError, match=told):
        run(tmp_path, [item, 1])


def test_workers_that_all_die_end_it(tmp_path: Path) -> None:
    with pytest.raises(WorkerError, match="in a row"):
        run(tmp_path, ["always:die"] * 9)


def test_the_environment_of_the_parent_is_as_before(tmp_path: Path) -> None:
    before = dict(os.environ)
    run(tmp_path, [1])
    assert dict(os.environ) == before


WHO = """
import functools, json, pathlib, sys
from lerobot_adamanip.util import jobs
if __name__ == "__main__":
    if sys.argv[1] == "copied":
        jobs.preload("jobs_helpers")
    from jobs_helpers import session
    with jobs.WorkerPool(functools.partial(session, pathlib.Path(sys.argv[2])), 1) as pool:
        print(json.dumps([result.value for result in pool.run(["who"])]))
"""


def test_a_copy_has_imported_what_was_named_and_counts_with_one_thread(tmp_path: Path, start: str) -> None:
    script = tmp_path / "who.py"
    script.write_text(WHO)
    path = os.pathsep.join(sys.path)
    line = [sys.executable, str(script), start, str(tmp_path)]
    done = subprocess.run(line, env={**os.environ, "PYTHONPATH": path}, check=True, capture_output=True, text=True)
    ((imported_itself, threads),) = json.loads(done.stdout)
    assert imported_itself == (start == "spawned")
    assert threads == "1"


@pytest.mark.parametrize(("count", "timeout"), [(0, 1.0), (1, 0.0), (1, float("nan"))])
def test_impossible_pools_are_refused(count: int, timeout: float) -> None:
    with pytest.raises(ConfigurationError, match="allowed"):
        WorkerPool[Any](functools.partial(session, Path()), count, timeout=timeout)
