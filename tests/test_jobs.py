"""`jobs`: every item is done once, whatever happens to the processes that do it."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from jobs_helpers import session

from lerobot_adamanip.util import jobs
from lerobot_adamanip.util.jobs import JobResult, WorkerError, WorkerPool

CRASHES = [1, "once:die", "always:die", 2, "once:hang", 3]
"""Items, and how some of them behave. Every executor comes to the same results."""


@pytest.fixture(autouse=True)
def _copied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers start as copies, as a command's do."""
    monkeypatch.setattr(jobs, "_preloaded", [])
    jobs.preload("jobs_helpers", "no_such_module")


def run(folder: Path, items: list[Any], count: int = 1, **options: Any) -> dict[Any, JobResult[Any]]:
    with WorkerPool[Any](functools.partial(session, folder), count, **options) as pool:
        results = list(pool.run(items))
    assert sorted(map(str, items)) == sorted(str(result.item) for result in results)
    return {result.item: result for result in results}


@pytest.mark.parametrize("copied", [True, False])
def test_every_item_is_done_once_by_few_processes(
    tmp_path: Path, copied: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = dict(os.environ)
    monkeypatch.setattr(jobs, "_preloaded", ["jobs_helpers"] if copied else [])
    results = run(tmp_path, [*range(8), "who"], count=2)
    assert dict(os.environ) == before
    assert results.pop("who").value == "1"  # thread for arithmetic
    assert {item: result.value[0] for item, result in results.items()} == {n: n * n for n in range(8)}
    processes = {result.value[1] for result in results.values()}
    assert len(processes) <= 2
    assert len(list(tmp_path.glob("session-*"))) == len(list(tmp_path.glob("ended-*"))) == 2


def test_crashes_and_hangs_cost_only_what_causes_them(tmp_path: Path) -> None:
    results = run(tmp_path, [*CRASHES, "always:hang"], count=2, timeout=3.0)
    given_up = {item: result.death for item, result in results.items() if result.death is not None}
    assert given_up == {"always:die": "signal SIGKILL", "always:hang": "hung: no heartbeat for 3 s"}
    assert [results[item].value for item in ("once:die", "once:hang")] == ["die", "hang"]


def test_slow_work_with_heartbeats_is_let_alone(tmp_path: Path) -> None:
    result = run(tmp_path, ["always:slow"], timeout=2.0)["always:slow"]
    assert (result.value, result.seconds > 2.0) == ("slow", True)
    assert len(list(tmp_path.glob("session-*"))) == 1


@pytest.mark.parametrize(
    ("item", "text"),
    [("always:refuse", "no such thing"), ("always:break", "ZeroDivisionError"), ("always:write", "No space left")],
)
def test_an_error_of_the_work_itself_ends_everything(tmp_path: Path, item: str, text: str) -> None:
    with pytest.raises(WorkerError, match=text):
        run(tmp_path, [item, 1])


class Clock:
    """A clock whose ``offset`` [s] a test changes, as if time had passed."""

    offset = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.offset


def test_a_pause_of_this_process_costs_no_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, wait = Clock(), jobs.wait

    def paused(*arguments: Any, **options: Any) -> Any:
        ready = wait(*arguments, **options)
        clock.offset += 3600
        monkeypatch.setattr(jobs, "wait", wait)
        return ready

    monkeypatch.setattr(jobs, "wait", paused)
    assert run(tmp_path, ["always:short"], timeout=8.0, clock=clock)["always:short"].value == "short"
    assert len(list(tmp_path.glob("session-*"))) == 1


def test_a_slow_caller_costs_no_worker(tmp_path: Path) -> None:
    clock = Clock()
    with WorkerPool[Any](functools.partial(session, tmp_path), 2, timeout=8.0, clock=clock) as pool:
        for result in pool.run([1, "always:short"]):
            assert result.death is None
            clock.offset += 3600
    assert len(list(tmp_path.glob("session-*"))) == 2


def test_a_worker_that_hangs_is_found_although_this_process_pauses(tmp_path: Path) -> None:
    jumps = itertools.count()
    results = run(tmp_path, [1, "always:hang"], timeout=1.0, clock=lambda: 3600.0 * next(jumps))
    assert results["always:hang"].death == "hung: no heartbeat for 1 s"


def test_workers_that_all_crash_end_it(tmp_path: Path) -> None:
    with pytest.raises(WorkerError, match="in a row"):
        run(tmp_path, ["always:die"] * 9, count=2)


COPY = """
import functools, os, pathlib, sys
from lerobot_adamanip.util import jobs
if __name__ == "__main__":
    jobs.preload("jobs_helpers")
    import jobs_helpers
    with jobs.WorkerPool(functools.partial(jobs_helpers.session, pathlib.Path(sys.argv[1])), 1) as pool:
        (result,) = pool.run(["imported by"])
    worker, importer = result.value
    assert importer not in (worker, os.getpid())
"""


def test_a_copy_has_imported_the_named_modules_already(tmp_path: Path) -> None:
    script = tmp_path / "imports.py"
    script.write_text(COPY)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, str(script), str(tmp_path)], env=environment, check=True)


ORPHAN = """
import functools, pathlib, sys
from lerobot_adamanip.util import jobs
if __name__ == "__main__":
    if sys.argv[2] == "copied":
        jobs.preload("jobs_helpers")
    import jobs_helpers
    with jobs.WorkerPool(functools.partial(jobs_helpers.session, pathlib.Path(sys.argv[1])), 1) as pool:
        list(pool.run(["always:hang"]))
"""


@pytest.mark.parametrize("start", ["copied", "spawned"])
def test_a_worker_ends_with_the_process_that_started_it(tmp_path: Path, start: str) -> None:
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    arguments = [sys.executable, str(script), str(tmp_path), start]
    with subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE) as parent:
        try:
            while not (tmp_path / "hang").exists():
                assert parent.poll() is None
                time.sleep(0.05)
            parent.kill()
            parent.communicate(timeout=20)  # until the worker has closed the output, too
        finally:
            parent.kill()
            for name in tmp_path.glob("session-*"):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(name.name.partition("-")[2]), signal.SIGKILL)
