"""Entries of the leaderboard: whole, of the declared scenes, and of known origin."""

from __future__ import annotations

import dataclasses
import runpy
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import FakeRunner, benchmark, run_all

from lerobot_adamanip.benchmark.declaration import read_declaration
from lerobot_adamanip.benchmark.leaderboard import (
    COLUMNS,
    DECLARATION,
    SCALES,
    SEED,
    TRACKS,
    leaderboard_page,
    read_entry,
)
from lerobot_adamanip.benchmark.plan import KeyVersions, all_cells, evaluation_options, named_steps, options_key, plan
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.paired import FAILED, OPENED, WITHIN_TRIES
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.results import ResultFile, ResultRow, StepDone, read_result, write_result
from lerobot_adamanip.util.errors import DatasetError

METHOD = "mine"
TABLE = f'\n[methods.mine]\nlike = "dp3_adaptive"\ntitle = "mine"\nscales = {list(SCALES)}\n'
type MakeEntry = Callable[..., Path]


@pytest.fixture(name="example", scope="module")
def _example(tmp_path_factory: pytest.TempPathFactory) -> ResultFile:
    folder = tmp_path_factory.mktemp("example")
    run_all(benchmark(folder / "out", FakeRunner(folder / "fake")))
    return read_result(folder / "out" / "cells" / "ours-safe-seen-1000.json")


@pytest.fixture(name="enter")
def _enter(tmp_path: Path, example: ResultFile) -> MakeEntry:
    def make(name: str, opened: int, method: str = METHOD, table: str = TABLE, **changes: Any) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        (folder / DECLARATION).write_text(TRACKS.read_text() + table)
        tracks = read_declaration(folder / DECLARATION)
        untried = {1: rate(3, 4), 2: rate(2, 4)}
        metrics = Metrics(rate(opened, 60), rate(opened // 2, 60), repeated=rate(2, 8), untried=untried)
        outcomes = f"{WITHIN_TRIES * (opened // 2)}{OPENED * (opened - opened // 2)}".ljust(60, FAILED)
        tries = outcomes.translate(str.maketrans({WITHIN_TRIES: "0", OPENED: "2", FAILED: "1"}))
        for scale in SCALES:
            (folder / scale).mkdir()
            for cell in all_cells(tracks, scale):
                if (cell.method, cell.seed) == (method, SEED):
                    assert example.run is not None
                    key, simulation = options_key(cell, tracks, scale), changes.get("simulation_version")
                    whole = plan(cell, tracks, scale, KeyVersions(simulation or SIMULATION_VERSION))
                    steps = {
                        name: StepDone(key=step.key, command=shlex.join((*step.command, *step.non_key_options)))
                        for name, step in named_steps(whole).items()
                    }
                    run = dataclasses.replace(
                        example.run, scale=scale, method=method, seed=cell.seed, options=key, steps=steps
                    )
                    rules = evaluation_options(steps["evaluate"].command)["--env.mechanism_rules"]
                    row = ResultRow("Mine", rules, cell.category, cell.objects, metrics, outcomes, tries)
                    values = {"rows": (row,), "run": run, "command": steps["evaluate"].command}
                    values |= {"seeds": (700000, 700059), "commit": "0" * 40}
                    one = dataclasses.replace(example, **{**values, **changes})
                    write_result(folder / scale / f"{cell.name}.json", one)
        return folder

    return make


def edit(path: Path, change: Callable[[ResultFile], ResultFile]) -> None:
    write_result(path, change(read_result(path)))


def lacking(folder: Path) -> str:
    with pytest.raises(DatasetError, match="Not an entry") as caught:
        read_entry(folder)
    return str(caught.value)


def test_the_best_entry_comes_first(enter: MakeEntry) -> None:
    page = leaderboard_page({path.name: read_entry(path) for path in (enter("weak", 24), enter("strong", 48))})
    lines = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    assert [line[0] for line in lines[-2:]] == ["strong", "weak"]
    assert lines[-2][1] == "the benchmark's demonstrations"
    assert lines[-2][2:] == [*["40.0 %"] * 5, "25.0 %", "75.0 %", "50.0 %"]
    assert "No entry yet." in leaderboard_page({})


@pytest.mark.parametrize("name", ["<img src=x>", "a|b", "[x](y)", "*", "_x_", "a`b", "x" * 61])
def test_an_entrys_name_is_no_markup(enter: MakeEntry, name: str) -> None:
    with pytest.raises(DatasetError, match="named by its folder"):
        read_entry(enter(name, 30))


def test_an_entry_of_an_earlier_simulation_version_comes_last_and_says_so(enter: MakeEntry) -> None:
    folders = enter("old", 48, simulation_version=1), enter("weak", 12), enter("strong", 24)
    page = leaderboard_page({path.name: read_entry(path) for path in folders})
    names = [line.split(" | ")[0].strip("| ") for line in page.splitlines() if line.startswith("| ")]
    assert names[-3:] == ["strong", "weak", "old (simulation version 1)"]


def test_each_track_has_its_column(enter: MakeEntry) -> None:
    entry = read_entry(enter("mine", 30))
    for column, (scale, objects) in enumerate(COLUMNS):
        results = {name: dict(each) for name, each in entry.results.items()}
        for cell, result in results[scale].items():
            if cell.objects == objects:
                row = dataclasses.replace(result.rows[0], metrics=Metrics(rate(0, 60), rate(0, 60)))
                results[scale][cell] = dataclasses.replace(result, rows=(row,))
        _, (_, _, *shares) = dataclasses.replace(entry, results=results).row()
        assert [share == "0.0 %" for share in shares[:4]] == [number == column for number in range(4)]


def test_other_files_are_no_part_of_an_entry(enter: MakeEntry, project_root: Path) -> None:
    folder = enter("mine", 30)
    path = next((folder / "row").glob("*.json"))
    run = read_result(path).run
    assert run is not None
    write_result(
        folder / "row" / "other.json", dataclasses.replace(read_result(path), run=dataclasses.replace(run, seed=7))
    )
    assert "row: 1 files that are no result of a declared cell" in lacking(folder)
    shutil.copy(project_root / "results" / "demo.json", folder / "row" / "other.json")
    assert "row: 1 files that are no result of a declared cell" in lacking(folder)


def test_a_script_checks_an_entry(
    enter: MakeEntry, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "check_entry.py"))
    folder = enter("mine", 30)
    monkeypatch.setattr("sys.argv", ["check_entry.py", str(folder)])
    assert script["main"]() == 0
    assert capsys.readouterr().out.count("real_sensors | mine-") == 18
    next((folder / "row").glob("*.json")).unlink()
    assert script["main"]() == 2
    assert "1 of 7 cells are missing" in capsys.readouterr().err


def test_an_evaluation_again_is_compared_in_every_measured_number(
    enter: MakeEntry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "check_entry.py"))
    folder, out = enter("mine", 30), tmp_path / "again"
    monkeypatch.setattr("sys.argv", ["check_entry.py", str(folder), "--evaluate", "--out", str(out)])
    called: list[str] = []

    def evaluate(command: list[str], **_: Any) -> None:
        called.append(command[0])
        scale = command[command.index("--scale") + 1]
        shutil.copytree(folder / scale, out / scale / "cells")
        if scale == "row":
            path = next((out / scale / "cells").glob("*.json"))
            row = read_result(path).rows[0]
            metrics = dataclasses.replace(row.metrics, repeated=rate(8, 8), untried={1: rate(0, 8)})
            edit(path, lambda one: dataclasses.replace(one, rows=(dataclasses.replace(row, metrics=metrics),)))

    monkeypatch.setattr("subprocess.run", evaluate)
    monkeypatch.setenv("PATH", "")
    assert script["main"]() == 1
    assert all(Path(program).is_absolute() for program in called), "of this installation, whatever PATH is"
    lines = capsys.readouterr().out.splitlines()
    assert [line.rpartition(" | ")[2] for line in lines if not line.endswith(" | ")] == ["repeated, untried"]


def test_an_entry_has_every_cell_of_declared_scenes(enter: MakeEntry) -> None:
    folder = enter("mine", 30)
    cell = next((folder / "row").glob("*.json"))
    other = f"{'0' * len(read_result(cell).run.options)}"  # type: ignore[union-attr]
    edit(cell, lambda one: dataclasses.replace(one, run=dataclasses.replace(one.run, options=other)))  # type: ignore[type-var]
    assert "made with other options than declared" in lacking(folder)
    cell.unlink()
    assert f"1 of 7 cells are missing, such as {cell.stem}" in lacking(folder)
    declared = (folder / DECLARATION).read_text()
    (folder / DECLARATION).write_text(declared.replace("--seed=700000", "--seed=710000"))
    assert lacking(folder).count("is not that of tracks.toml") == len(SCALES)


def test_an_entry_is_of_one_method_that_says_what_it_learned_from(enter: MakeEntry) -> None:
    table = '\n[methods.mine]\ntitle = "mine"\npolicy = "act"\ncheckpoint = "me/mine"\ndemonstrations = "mistakes"\n'
    table += f'revision = "{"a" * 40}"\n'
    table += f"scales = {list(SCALES)}\n"
    assert "learns_from does not say" in lacking(enter("silent", 30, "mine", table))
    source = "demonstrations of an expert that knows the hidden state"
    folder = enter("described", 30, "mine", f'{table}learns_from = "{source}"\n')
    assert read_entry(folder).learns_from == source
    static = '\n[demonstrations.seeing]\nexpert = "static"\n' + TABLE + 'demonstrations = "seeing"\n'
    assert "an expert that sees the hidden state" in lacking(enter("seeing", 30, table=static))
    assert "an expert reads the simulator" in lacking(enter("cheat", 60, table=TABLE.replace("dp3_adaptive", "expert")))
    cell = next((folder / "row").glob("*.json"))
    edit(cell, lambda one: dataclasses.replace(one, run=dataclasses.replace(one.run, method="expert")))  # type: ignore[type-var]
    assert "results of expert, mine, not of one declared method" in lacking(folder)


@pytest.mark.parametrize("scale", SCALES)
def test_a_method_of_one_scale_alone_is_no_entry(scale: str, enter: MakeEntry) -> None:
    table = f'\n[methods.mine]\nlike = "dp3_adaptive"\ntitle = "mine"\nscales = ["{scale}"]\n'
    folder = enter("mine", 30, "mine", table)
    for other in set(SCALES) - {scale}:
        for path in (folder / other).glob("*.json"):
            path.unlink()
    assert lacking(folder).count("no cell is declared for mine") == len(SCALES) - 1


def test_results_have_the_declared_scenes_and_episodes(enter: MakeEntry) -> None:
    folder = enter("mine", 30)
    first, second = sorted((folder / "row").glob("*.json"))[:2]
    edit(first, lambda one: dataclasses.replace(one, scenes="train"))
    row = dataclasses.replace(read_result(second).rows[0], metrics=Metrics(rate(3, 5), rate(3, 5)))
    row = dataclasses.replace(row, scene_outcomes="", scene_tries="")
    edit(second, lambda one: dataclasses.replace(one, rows=(row,)))
    said = lacking(folder)
    assert f"row, {first.stem}: 60 episodes of train scenes" in said
    assert f"row, {second.stem}: 5 episodes of test scenes" in said


@pytest.mark.parametrize(
    ("changes", "of_run", "of_row", "problem"),
    [
        ({"command": "lerobot-eval --env.split=train"}, {}, {}, "scale, command or steps"),
        ({}, {"scale": "hints"}, {}, "scale, command or steps"),
        ({}, {"steps": {"evaluate": StepDone(key="0" * 16, command="lerobot-eval --seed=5")}}, {}, "command or steps"),
        ({"seeds": (0, 59)}, {}, {}, "seeds 0 to 59, not 700000 to 700059"),
        ({}, {"data_version": 1}, {}, "data versions 1 and"),
        ({}, {}, {"mechanism_rules": "paper"}, "rules paper, not row"),
        ({}, {}, {"scene_outcomes": ""}, "without the outcome and the failed tries of each scene"),
        ({}, {}, {"scene_tries": ""}, "without the outcome and the failed tries of each scene"),
        ({}, {}, {"repeated": rate(0, 10**6), "untried": {1: rate(10**6, 10**6)}}, "repeated and untried are not"),
        ({}, {}, {"repeated": rate(0, 8), "untried": {1: rate(4, 4)}}, "repeated and untried are not"),
        ({}, {}, {"scene_tries": "3" * 15 + "4" * 45}, "more failed tries than those"),
        ({}, {"costs": {}}, {}, "without the costs and commits of its steps"),
    ],
)
def test_a_result_that_contradicts_itself_is_named(
    changes: dict[str, Any], of_run: dict[str, Any], of_row: dict[str, Any], problem: str, enter: MakeEntry
) -> None:
    folder = enter("mine", 30)
    path = next((folder / "row").glob("*.json"))
    result = read_result(path)
    assert result.run is not None
    counts = {name: of_row[name] for name in of_row.keys() & {"repeated", "untried"}}
    metrics = dataclasses.replace(result.rows[0].metrics, **counts)
    labels = {name: of_row[name] for name in of_row.keys() - counts.keys()}
    row = dataclasses.replace(result.rows[0], metrics=metrics, **labels)
    run = dataclasses.replace(result.run, **of_run)
    write_result(path, dataclasses.replace(result, **{"rows": (row,), "run": run, **changes}))
    assert problem in lacking(folder)


@pytest.mark.parametrize("name", ["collect", "train", "evaluate"])
def test_each_step_is_that_of_the_declaration(name: str, enter: MakeEntry) -> None:
    folder = enter("mine", 30)
    path = next((folder / "row").glob("*.json"))
    result = read_result(path)
    assert result.run is not None
    for command in (
        f"{result.run.steps[name].command} --x=1",
        result.run.steps[name].command.replace("--", "--no_", 1),
    ):
        step = dataclasses.replace(result.run.steps[name], command=command)
        run = dataclasses.replace(result.run, steps={**result.run.steps, name: step})
        own = step.command if name == "evaluate" else result.command
        write_result(path, dataclasses.replace(result, run=run, command=own))
        assert "scale, command or steps are not those" in lacking(folder)


@pytest.mark.parametrize(
    ("field", "problem"),
    [
        ('evaluate = ["--env.sensing=exact"]', "evaluated in other scenes (--env.sensing)"),
        (
            'evaluate = ["--env.max_failed_tries=9", "--env.self_calibration=true"]',
            "other scenes (--env.max_failed_tries)",
        ),
        ('evaluate = ["--seed=1"]', "evaluated in other scenes (--seed)"),
        ('evaluate = ["--env.type=adamanip_bottle"]', "evaluated in other scenes (--env.type)"),
        ('evaluate = ["--env.self_calibration=true"]', ""),
    ],
)
def test_a_method_chooses_its_observations_and_not_its_scenes(field: str, problem: str, enter: MakeEntry) -> None:
    table = f"{TABLE}{field}\n"
    folder = enter("mine", 30, "mine", table)
    if problem:
        assert problem in lacking(folder)
    else:
        assert read_entry(folder).method.title == "mine"


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"changed": True}, "made from a commit with changes, or from none"),
        ({"commit": None}, "made from a commit with changes, or from none"),
    ],
)
def test_an_entry_is_of_a_known_commit(changes: dict[str, Any], problem: str, enter: MakeEntry) -> None:
    assert lacking(enter("mine", 30, **changes)).count(problem) == 7 + 8 + 18


def test_each_step_of_an_entry_is_of_a_commit_without_changes(enter: MakeEntry) -> None:
    folder = enter("mine", 30)
    path = next((folder / "row").glob("*.json"))
    run = read_result(path).run
    assert run is not None
    costs = {**run.costs, "train": dataclasses.replace(run.costs["train"], changed=True)}
    edit(path, lambda one: dataclasses.replace(one, run=dataclasses.replace(run, costs=costs)))
    assert lacking(folder).count("made from a commit with changes, or from none") == 1


def test_an_entry_is_of_one_simulation_version(enter: MakeEntry) -> None:
    folder = enter("mine", 30)
    edit(next((folder / "row").glob("*.json")), lambda one: dataclasses.replace(one, simulation_version=1))
    assert f"simulation versions 1 and {SIMULATION_VERSION}" in lacking(folder)
    latest = f"the latest is {SIMULATION_VERSION}"
    assert latest in lacking(enter("future", 30, simulation_version=SIMULATION_VERSION + 1))
