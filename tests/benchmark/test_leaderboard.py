"""Entries of the leaderboard: whole, of the declared scenes, and of known origin."""

from __future__ import annotations

import dataclasses
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import FakeRunner, benchmark, run_all

from lerobot_adamanip.benchmark.declaration import read_declaration
from lerobot_adamanip.benchmark.leaderboard import COLUMNS, DECLARATION, SCALES, TRACKS, leaderboard_page, read_entry
from lerobot_adamanip.benchmark.plan import all_cells, options_key
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.results import ResultFile, ResultRow, read_result, write_result
from lerobot_adamanip.util.errors import DatasetError

METHOD = "dp3_adaptive"
type MakeEntry = Callable[..., Path]


@pytest.fixture(name="enter")
def _enter(tmp_path: Path) -> MakeEntry:
    run_all(benchmark(tmp_path / "out", FakeRunner(tmp_path / "fake")))
    example = read_result(tmp_path / "out" / "cells" / "ours-safe-seen-1000.json")

    def make(name: str, opened: int, method: str = METHOD, table: str = "", **changes: Any) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        (folder / DECLARATION).write_text(TRACKS.read_text() + table)
        tracks = read_declaration(folder / DECLARATION)
        untried = {1: rate(3, 4), 2: rate(1, 2)}
        metrics = Metrics(rate(opened, 60), rate(opened // 2, 60), repeated=rate(1, 4), untried=untried)
        for scale in SCALES:
            (folder / scale).mkdir()
            for cell in all_cells(tracks, scale):
                if cell.method == method:
                    key = options_key(cell, tracks, scale)
                    assert example.run is not None
                    run = dataclasses.replace(example.run, scale=scale, method=method, seed=cell.seed, options=key)
                    row = ResultRow("Mine", "paper", cell.category, cell.objects, metrics)
                    one = dataclasses.replace(example, **{"rows": (row,), "commit": "0" * 40, "run": run, **changes})
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
    assert capsys.readouterr().out.count("real_sensors | dp3_adaptive-") == 18
    next((folder / "row").glob("*.json")).unlink()
    assert script["main"]() == 2
    assert "1 of 7 cells are missing" in capsys.readouterr().err


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
    edit(second, lambda one: dataclasses.replace(one, rows=(row,)))
    said = lacking(folder)
    assert f"row, {first.stem}: 60 episodes of train scenes" in said
    assert f"row, {second.stem}: 5 episodes of test scenes" in said


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
    table = f'\n[methods.mine]\nlike = "dp3_adaptive"\ntitle = "mine"\nscales = {list(SCALES)}\n{field}\n'
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


def test_an_entry_is_of_one_simulation_version(enter: MakeEntry) -> None:
    folder = enter("mine", 30)
    edit(next((folder / "row").glob("*.json")), lambda one: dataclasses.replace(one, simulation_version=1))
    assert f"simulation versions 1 and {SIMULATION_VERSION}" in lacking(folder)
