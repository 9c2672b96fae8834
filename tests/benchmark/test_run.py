"""Running a benchmark: each step once, shared where it can be, and on from wherever it was killed."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import random
import re
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmark_helpers import (
    ORIGIN,
    VERSIONS,
    FakeRunner,
    benchmark,
    cells_of,
    content,
    declared,
    results,
    run_all,
    with_scale,
)
from safetensors.numpy import save_file

from lerobot_adamanip.benchmark import run
from lerobot_adamanip.benchmark.command import begin_command, end_command
from lerobot_adamanip.benchmark.plan import plan
from lerobot_adamanip.evaluation.results import CellRun, read_result
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

# What is forked here runs nothing of the threads that other tests' libraries have left.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
DEATHS, PAUSE = 6, 0.002
STEP = "training_state/training_step.json"


def run_of(path: Path) -> CellRun:
    run = read_result(path).run
    assert run is not None
    return run


TRAINED = ["adamanip", "lerobot-train", "lerobot-eval", "lerobot-eval"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The results of a benchmark that was never interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    states = run_all(benchmark(folder / "out", FakeRunner(folder)))
    assert [each.state for each in states] == ["done"] * 6
    return results(folder / "out")


def test_cells_share_demonstrations_and_trainings(tmp_path: Path) -> None:
    runner = FakeRunner(tmp_path)
    run_all(benchmark(tmp_path / "out", runner))
    assert runner.programs == ["lerobot-eval", "lerobot-eval", *TRAINED, *TRAINED]
    assert (set(runner.threads), runner.most_at_once) == ({0}, 1), "one at a time may use all threads"
    run_all(benchmark(tmp_path / "out", runner))
    assert len(runner.called) == 10, "nothing is done twice"


def test_a_result_says_what_made_it(tmp_path: Path) -> None:
    made = benchmark(tmp_path / "out", FakeRunner(tmp_path))
    run_all(made)
    found = read_result(tmp_path / "out" / "cells" / "ours-safe-unseen-1000.json")
    run = run_of(tmp_path / "out" / "cells" / "ours-safe-unseen-1000.json")
    assert list(run.steps) == ["collect", "train", "evaluate"]
    assert f"--dataset.root=demonstrations/{run.steps['collect'].key} " in run.steps["train"].command
    assert "--seed=1000" in run.steps["train"].command
    assert found.command == run.steps["evaluate"].command
    assert (found.scenes, found.seeds) == ("test", (1000, 1004))
    (row,) = found.rows
    assert (row.subject, row.category, row.objects) == ("Ours", "safe", "unseen")
    numbers = row.metrics
    assert numbers.success.episodes == 5
    assert sum((numbers.key_frames or {}).values()) == numbers.success.count
    assert sum(each.episodes for name, each in (numbers.hidden or {}).items() if name.endswith("locked")) == 5
    assert (found.simulation_version, run.data_version) == (VERSIONS.simulation, VERSIONS.data)
    assert found.commit == made.origin.commit
    assert found.all_versions == made.origin.versions
    assert {cost.begun for cost in run.costs.values()} == {1}
    assert run.costs["train"].machine == found.machine == {"cores": 2, "gpu": False}
    text = (tmp_path / "out" / "cells" / "ours-safe-unseen-1000.json").read_text()
    assert str(tmp_path) not in text


def test_rounds_of_corrections_go_on_after_a_death(tmp_path: Path) -> None:
    methods = content()["methods"]
    methods["ours"]["rounds"] = [{"corrections": 2, "steps": 4, "start": start} for start in ("new", "trained")]
    corrected = declared(methods={name: methods[name] for name in ("ours", "ours_on_static")})
    run_all(benchmark(tmp_path / "whole", FakeRunner(tmp_path), corrected))
    for moment in ("collect:2", "train:6"):
        root = tmp_path / moment.replace(":", "")
        assert killed(root, FakeRunner(tmp_path, die=moment), declaration=corrected)
        wait_for_the_orphan(root)
        run_all(benchmark(root, FakeRunner(tmp_path), corrected))
        assert results(root) == results(tmp_path / "whole")
    found = run_of(tmp_path / "whole" / "cells" / "ours-safe-seen-1000.json")
    assert list(found.costs) == list(found.steps)
    assert list(found.steps)[2:6] == ["correct", "merge", "train_2", "correct_2"]


@pytest.mark.parametrize("jobs", [2, 8])
def test_several_at_once_come_to_the_same(tmp_path: Path, whole: dict[str, Any], jobs: int) -> None:
    runner = FakeRunner(tmp_path, pause=PAUSE)
    states = run_all(benchmark(tmp_path / "out", runner, jobs=jobs))
    assert sorted(each.cell.name for each in states) == sorted(f.removesuffix(".json") for f in whole)
    assert {each.state for each in states} == {"done"}
    assert results(tmp_path / "out") == whole
    assert len(runner.called) == 10, "what cells share is made once"
    assert 1 < runner.most_at_once <= jobs
    costs = [run_of(path).costs["evaluate"] for path in (tmp_path / "out" / "cells").iterdir()]
    assert {(each.begun, each.machine["cores"]) for each in costs} == {(1, 2 // min(jobs, 2))}
    assert set(runner.threads) == {1}


def test_a_step_that_takes_long_shows_the_end_of_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "SIGN_OF_LIFE_SECONDS", 0.05)
    said: list[str] = []
    made = benchmark(tmp_path / "out", FakeRunner(tmp_path, pause=0.02), say=said.append)
    made.folder.make()
    first = plan(cells_of(made)[0], made.declaration, made.scale, made.versions)
    made.folder.log(next(first.chain())).write_text("step 1\nstep 2\n\n")
    next(made.run(cells_of(made)))
    assert re.fullmatch(r"\[1/6\] \S+: evaluating, log: \S+", said[0])
    assert re.fullmatch(r"\[1/6\] \S+: evaluating for \d+ s: step 2", said[1])


def test_what_a_finished_step_was_made_of_is_no_longer_needed(tmp_path: Path) -> None:
    runner = FakeRunner(tmp_path)
    run_all(benchmark(tmp_path / "out", runner))
    count = len(runner.called)
    for folder in ("demonstrations", "trainings"):
        files.remove_tree(tmp_path / "out" / folder)
    for path in (tmp_path / "out" / "cells").iterdir():
        path.unlink()
    assert {each.state for each in run_all(benchmark(tmp_path / "out", runner))} == {"done"}
    assert len(runner.called) == count


# Kills ------------------------------------------------------------------------------------------------------------


def killed(root: Path, runner: FakeRunner, *, seconds: float = 0.0, log: str = "", **given: Any) -> bool:
    """Runs the benchmark in a process that is killed; returns whether it was.

    By its runner; or after some seconds; or as soon as a file of that name is written in its folder.
    """

    def kill() -> None:
        while log and not list(root.rglob(log)):
            time.sleep(0.001)
        os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if child == 0:
        if seconds or log:
            threading.Timer(seconds, kill).start()
        status = 1
        try:
            run_all(benchmark(root, runner, **given))
            status = 0
        finally:
            os._exit(status)
    _, waited = os.waitpid(child, 0)
    status = os.waitstatus_to_exitcode(waited)
    assert status in (0, -signal.SIGKILL), status
    return status != 0


def wait_for_the_orphan(root: Path) -> None:
    """The command of a killed benchmark goes on, and keeps the next one out until it ends."""
    end = time.monotonic() + 30
    while time.monotonic() < end:
        try:
            with files.locked(root, "busy", ""):
                return
        except DatasetError:
            time.sleep(0.005)
    raise AssertionError("the folder stays locked")


@pytest.mark.parametrize(
    "moment",
    [
        "collect:1", "collect:5", "evaluate:1", "evaluate:4",
        "train:2",  # before it has a checkpoint
        "train:5",  # half of one
        "train:7",  # without a link to its only one
        "train:9", "train:14",  # without a link to one of several
        "train:20",  # after the last one, without a link: nothing is left to do
    ],
)  # fmt: skip
def test_a_death_in_any_step_changes_no_result(tmp_path: Path, whole: dict[str, Any], moment: str) -> None:
    root = tmp_path / "out"
    assert killed(root, FakeRunner(tmp_path, die=moment))
    wait_for_the_orphan(root)
    runner = FakeRunner(tmp_path)
    run_all(benchmark(root, runner))
    assert results(root) == whole
    resumed = [command for command in runner.called if "--resume=true" in command]
    assert len(resumed) == (moment in ("train:9", "train:14")), "from its last whole checkpoint"
    step = moment.partition(":")[0]
    begun = [json.loads(path.read_text())["begun"] for path in (root / "steps").glob(f"{step}-*.json")]
    assert sorted(begun)[-2:] == [1, 2], "it was killed in that step"


def test_random_deaths_change_no_result(tmp_path: Path, whole: dict[str, Any]) -> None:
    begin = time.monotonic()
    run_all(benchmark(tmp_path / "timed", FakeRunner(tmp_path, pause=PAUSE), jobs=2))
    lasts, drawn, deaths, begun = time.monotonic() - begin, random.Random(0), 0, 0
    roots = (tmp_path / f"benchmark-{number}" for number in itertools.count())
    while deaths < DEATHS:
        # One may finish before its first death: each has a folder of its own, whatever the count of deaths.
        root, runner = next(roots), FakeRunner(tmp_path, pause=PAUSE)
        root.mkdir()
        while deaths < DEATHS and killed(root, runner, seconds=drawn.uniform(0.01, lasts / 2), jobs=2):
            deaths += 1
            wait_for_the_orphan(root)
        run_all(benchmark(root, runner, jobs=2))
        assert results(root) == whole
        begun += sum(json.loads(path.read_text())["begun"] - 1 for path in (root / "steps").glob("*.json"))
    assert begun >= DEATHS // 2, "most deaths were in the midst of a step"


def test_a_command_that_is_left_behind_keeps_others_out(tmp_path: Path) -> None:
    root, runner = tmp_path / "out", FakeRunner(tmp_path, pause=0.2)
    assert killed(root, runner, log="episodes.jsonl")
    with pytest.raises(DatasetError, match="left behind"):
        run_all(benchmark(root, runner))
    wait_for_the_orphan(root)


@pytest.mark.parametrize("moment", ["train:9", "train:17", "evaluate:1"])
@pytest.mark.parametrize("emptied", ["pretrained_model/model", "pretrained_model/train_config.json", STEP])
def test_a_checkpoint_that_lost_a_file_in_a_power_cut_changes_no_result(
    tmp_path: Path, whole: dict[str, Any], moment: str, emptied: str
) -> None:
    """After the first or second checkpoint, or once the training is done and its policy is to be evaluated."""
    root = tmp_path / "out"
    trained = declared(methods={name: one for name, one in content()["methods"].items() if name != "untrained"})
    assert killed(root, FakeRunner(tmp_path, die=moment), declaration=trained)
    wait_for_the_orphan(root)
    (last,) = root.glob("trainings/*/checkpoints/last")
    (last / emptied).write_text("")
    runner = FakeRunner(tmp_path)
    assert {each.state for each in run_all(benchmark(root, runner, trained))} == {"done"}
    assert results(root) == {name: one for name, one in whole.items() if not name.startswith("untrained")}
    resumed = [command for command in runner.called if "--resume=true" in command]
    is_resumed = moment == "train:17" or (moment == "evaluate:1" and emptied != STEP)
    assert len(resumed) == is_resumed, "from the newest whole checkpoint, if there is one"


def test_weights_that_were_cut_are_no_checkpoint(tmp_path: Path) -> None:
    made = benchmark(tmp_path / "out", FakeRunner(tmp_path))
    run_all(made)
    step = plan(cells_of(made)[-1], made.declaration, made.scale, made.versions).needs[0]
    weights = tmp_path / "out" / step.product / "checkpoints" / "last" / "pretrained_model" / "model.safetensors"
    save_file({"a": np.zeros(9)}, weights)
    assert made.folder.is_done(step)
    weights.write_bytes(weights.read_bytes()[:-8])
    assert not made.folder.is_done(step)
    steps, config = made.folder.resumable(step) or (0, Path())
    assert (steps, config.parts[-3:]) == (6, ("000006", "pretrained_model", "train_config.json"))


# What changes and what fails --------------------------------------------------------------------------------------


def test_states_are_told_without_running(tmp_path: Path) -> None:
    runner = FakeRunner(tmp_path)
    made = benchmark(tmp_path / "out", runner)
    assert {made.state(cell).state for cell in cells_of(made)} == {"missing"}
    assert not (tmp_path / "out").exists()
    assert killed(tmp_path / "out", FakeRunner(tmp_path, die="train:1"))
    assert [made.state(cell).state for cell in cells_of(made)] == ["done"] * 2 + ["begun"] * 2 + ["missing"] * 2
    assert runner.called == []


def test_other_options_and_another_data_version_make_a_result_stale_and_it_is_made_again(tmp_path: Path) -> None:
    runner = FakeRunner(tmp_path)
    run_all(benchmark(tmp_path / "out", runner))
    made = benchmark(tmp_path / "out", runner, with_scale(steps=9))
    states = [made.state(cell).state for cell in cells_of(made)]
    assert states == ["done"] * 2 + ["stale"] * 4, "a policy without training has no such options"
    made = benchmark(tmp_path / "out", runner, versions=dataclasses.replace(VERSIONS, data=9))
    assert {made.state(cell).state for cell in cells_of(made)} == {"stale"}
    longer, before = benchmark(tmp_path / "out", runner, with_scale(steps=9)), len(runner.called)
    assert {each.state for each in run_all(longer)} == {"done"}
    again = runner.programs[before:]
    assert again == [program for program in TRAINED if program != "adamanip"] * 2, "the demonstrations are the same"


def test_what_is_not_available_is_left_out_with_its_reason(tmp_path: Path) -> None:
    runner = FakeRunner(tmp_path)
    made = benchmark(tmp_path / "out", runner, unavailable={"ours_on_static": "not installed"})
    states = run_all(made)
    left = [each for each in states if each.state == "unavailable"]
    assert [(each.cell.method, each.reason) for each in left] == [("ours_on_static", "not installed")] * 2
    assert len(results(tmp_path / "out")) == 4


@pytest.mark.parametrize(
    ("status", "reason"),
    [(7, "ended with status 7: steps/train-"), (0, "has not written what the next steps read: trainings/")],
)
def test_a_step_that_fails_is_tried_once_and_keeps_no_other_cell_from_running(
    tmp_path: Path, status: int, reason: str
) -> None:
    runner = FakeRunner(tmp_path)
    runner.failing, runner.status = "lerobot-train", status
    states = run_all(benchmark(tmp_path / "out", runner))
    assert [each.state for each in states] == ["done"] * 2 + ["failed"] * 4
    assert states[2].reason.startswith(f"lerobot-train {reason}")
    assert runner.programs.count("lerobot-train") == 2
    runner.failing = ""
    assert {each.state for each in run_all(benchmark(tmp_path / "out", runner))} == {"done"}


def test_an_error_of_one_cell_keeps_no_other_from_running(tmp_path: Path) -> None:
    methods = dict(declared().methods)
    methods["ours_on_static"] = dataclasses.replace(methods["ours_on_static"], title="a|b")  # of no result
    made = benchmark(tmp_path / "out", FakeRunner(tmp_path), dataclasses.replace(declared(), methods=methods))
    states = {each.cell.name: each for each in run_all(made)}
    assert Counter(each.state for each in states.values()) == {"done": 4, "failed": 2}
    assert "These values make no result file" in states["ours_on_static-safe-seen-1000"].reason


def test_an_update_of_a_package_is_told_and_repeats_nothing(tmp_path: Path) -> None:
    runner = FakeRunner(tmp_path)
    run_all(benchmark(tmp_path / "out", runner))
    before = len(runner.called)
    newer = dataclasses.replace(ORIGIN, versions={**ORIGIN.versions, "torch": "2.12.0", "numpy": "2.0"})
    states = run_all(benchmark(tmp_path / "out", runner, origin=newer))
    told = "measured with other versions than installed: torch 2.11.0 and 2.12.0"
    assert {(each.state, each.reason) for each in states} == {("done", told)}
    assert len(runner.called) == before


def test_a_log_of_another_version_or_too_few_episodes_is_no_result(tmp_path: Path) -> None:
    runner = FakeRunner(tmp_path)
    changed = dataclasses.replace(VERSIONS, simulation=99)
    states = run_all(benchmark(tmp_path / "out", runner, versions=changed))
    assert {each.state for each in states} == {"failed"}
    assert "not 5, test scenes of simulation version 99" in states[0].reason
    assert results(tmp_path / "out") == {}
    other = content()["methods"]
    other["untrained"]["evaluate"] = ["--env.split=validation"]
    states = run_all(benchmark(tmp_path / "scenes", runner, declared(methods=other)))
    assert "5 episodes, test scenes" in states[0].reason
    assert "not 5, validation scenes" in states[0].reason
    fewer = content()["methods"]
    fewer["untrained"]["evaluate"] = ["--eval.batch_size=1", "--eval.n_episodes=4"]
    states = run_all(benchmark(tmp_path / "fewer", runner, declared(methods=fewer)))
    assert states[0].result is not None
    assert states[0].result.rows[0].metrics.success.episodes == 4, "a method's own options win"


def test_a_checkpoint_is_of_the_declared_revision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refs, root = tmp_path / "hub" / "models--me--act-safe" / "refs", tmp_path / "out"
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hub"))
    refs.mkdir(parents=True)
    (root / "me" / "act-safe").mkdir(parents=True)
    (root / "me" / "act-safe" / "model").write_text("weights")

    def run_at(revision: str) -> list[str]:
        given = {"title": "Given", "policy": "act", "checkpoint": "me/act-{category}", "revision": revision}
        made = benchmark(root, FakeRunner(tmp_path), declared(reference="given", methods={"given": given}))
        return sorted({f"{each.state} {each.reason}".strip() for each in run_all(made)})

    (failure,) = run_at("a" * 40)
    assert "main's, no commit in the Hub cache" in failure
    (refs / "main").write_text("a" * 40)
    assert run_at("a" * 40) == ["done"]
    (failure,) = run_at("v1.0")
    assert f"main's, {'a' * 40} in the Hub cache, not of v1.0" in failure
    (refs / "v1.0").write_text("a" * 40)
    assert run_at("v1.0") == ["done"]
    command = read_result(root / "cells" / "given-safe-seen-1000.json").command
    assert "--policy.pretrained_revision=v1.0" in command


def test_a_result_has_the_commits_of_its_steps(tmp_path: Path) -> None:
    root, path = tmp_path / "out", tmp_path / "out" / "cells" / "ours-safe-seen-1000.json"
    begun = dataclasses.replace(ORIGIN, commit="a" * 40, changed=True)
    run_all(benchmark(root, FakeRunner(tmp_path), origin=begun))
    path.unlink()
    run_all(benchmark(root, FakeRunner(tmp_path)))
    found = read_result(path)
    assert (found.commit, found.changed) == (begun.commit, True), "no step was made again"
    assert found.commits == {("a" * 40, True)}
    for note in (root / "steps").glob("*.json"):  # as written before steps held a commit
        content = json.loads(note.read_text())
        note.write_text(json.dumps({name: content[name] for name in content.keys() - {"commit", "changed"}}))
    path.unlink()
    run_all(benchmark(root, FakeRunner(tmp_path)))
    assert read_result(path).commits == {(ORIGIN.commit, False)}


@pytest.mark.parametrize("change", [{"commit": "a" * 40}, {"changed": True}])
@pytest.mark.parametrize("moment", range(1, 6))
def test_a_checkout_that_changes_during_a_run_is_in_its_result(
    tmp_path: Path, change: dict[str, Any], moment: int
) -> None:
    """Before or after each of three steps."""
    calls = itertools.count()
    made = benchmark(
        tmp_path / "out",
        FakeRunner(tmp_path),
        origin_now=lambda: dataclasses.replace(ORIGIN, **change) if next(calls) >= moment else ORIGIN,
    )
    (cell,) = (cell for cell in cells_of(made) if (cell.method, cell.objects) == ("ours", "seen"))
    (state,) = made.run([cell])
    assert state.result is not None
    assert (len(state.result.commits) > 1, state.result.changed) != (False, False)
    assert next(calls) == 6


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda text: "".join(text.splitlines(keepends=True)[:3]), id="lost lines"),
        pytest.param(lambda text: text.replace('"poses": "randomized"', '"poses": "fixed"'), id="other episodes"),
    ],
)
def test_an_evaluation_whose_log_is_not_of_its_command_runs_again(tmp_path: Path, damage: Callable[[str], str]) -> None:
    root, runner = tmp_path / "out", FakeRunner(tmp_path)
    run_all(benchmark(root, runner))
    before, called = results(root), len(runner.called)
    result = root / "cells" / "untrained-safe-seen-1000.json"
    log = root / "evaluations" / run_of(result).key / "episodes.jsonl"
    log.write_text(damage(log.read_text()))
    result.unlink()
    assert {each.state for each in run_all(benchmark(root, runner))} == {"done"}
    assert (results(root), len(runner.called)) == (before, called + 1), "it is evaluated again"


# Programs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("threads", "own", "told"),
    [(0, None, "None glibc.malloc.hugetlb=1"), (2, None, "2 glibc.malloc.hugetlb=1"), (0, "mine", "None mine")],
)
def test_a_program_has_the_folder_and_the_environment_unless_the_user_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int, own: str | None, told: str
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    if own is not None:
        monkeypatch.setenv("GLIBC_TUNABLES", own)
    log = tmp_path / "log"
    names = ("HF_HUB_OFFLINE", "OMP_NUM_THREADS", "GLIBC_TUNABLES")
    code = f"import os; print(os.getcwd(), *(os.environ.get(name) for name in {names})); exit(3)"
    with files.locked(tmp_path, "busy", "") as lock:
        program = Path(sys.executable).name
        process = begin_command([program, "-c", code], folder=tmp_path, log=log, lock=lock, threads=threads)
        assert process.wait(30) == 3
    assert log.read_text().startswith(f"{tmp_path} 1 {told}")


def test_a_program_is_stopped_even_if_it_will_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lerobot_adamanip.benchmark.command._STOP_SECONDS", 0.2)
    code = "import signal, time; signal.signal(15, signal.SIG_IGN); print('begun', flush=True); time.sleep(60)"
    log = tmp_path / "log"
    with files.locked(tmp_path, "busy", "") as lock:
        process = begin_command([Path(sys.executable).name, "-c", code], folder=tmp_path, log=log, lock=lock)
        while not log.read_text():
            time.sleep(0.005)
        end_command(process)
    assert process.poll() == -signal.SIGKILL
    with files.locked(tmp_path, "the program still runs", ""):
        pass


def test_an_interruption_ends_all_programs(tmp_path: Path) -> None:
    def interrupt() -> None:
        end = time.monotonic() + 30
        while len(runner.processes) < 4 and time.monotonic() < end:
            time.sleep(0.005)
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    root, runner = tmp_path / "out", FakeRunner(tmp_path, pause=0.5)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=interrupt).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            run_all(benchmark(root, runner, jobs=4))
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(runner.processes) == 4
    assert all(process.poll() is not None for process in runner.processes)
    with files.locked(root, "a program still runs", ""):
        pass


def test_a_missing_program_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="lerobot-dance"):
        begin_command(["lerobot-dance"], folder=tmp_path, log=tmp_path / "log", lock=0)
