"""`adamanip benchmark`: JSON and nothing else on stdout, progress on stderr, one message for a mistake."""

from __future__ import annotations

import functools
import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import FakeRunner

from lerobot_adamanip.benchmark.declaration import Method, read_declaration
from lerobot_adamanip.benchmark.run import BenchmarkRun
from lerobot_adamanip.cli import benchmark_run as command
from lerobot_adamanip.cli.main import main

UNAVAILABLE = {"sampling": "no policy 'sampling' is installed"}
SMALL = ["--scale", "smoke", "--methods", "sampling,dp3,dp3_adaptive", "--categories", "safe"]
INTERRUPTED = 130


def policies(methods: Mapping[str, Method]) -> tuple[dict[str, str], dict[str, str]]:
    print("a library talks")
    return dict.fromkeys(methods, "a" * 16), UNAVAILABLE


@pytest.fixture
def runner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeRunner:
    """What runs commands, in place of programs."""
    made = FakeRunner(tmp_path)
    monkeypatch.setattr(command, "BenchmarkRun", functools.partial(BenchmarkRun, runner=made))
    monkeypatch.setattr(command, "find_policies", policies)
    monkeypatch.chdir(tmp_path)
    return made


def printed(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 0) -> dict[str, Any]:
    assert main(["benchmark", *SMALL, *arguments, "--json"]) == status
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def states(found: dict[str, Any]) -> dict[str, str]:
    return {cell["method"]: cell["state"] for cell in found["cells"]}


def test_the_list_is_json_and_nothing_runs(runner: FakeRunner, capsys: pytest.CaptureFixture[str]) -> None:
    found = printed(capsys, "--list")
    assert set(found) == {"scale", "cells"}
    assert states(found) == {"sampling": "unavailable", "dp3": "missing", "dp3_adaptive": "missing"}
    assert [cell["reason"] for cell in found["cells"]] == [UNAVAILABLE["sampling"], "", ""]
    assert runner.called == []
    assert not Path("outputs").exists()


def test_it_runs_what_is_missing_and_writes_the_table(runner: FakeRunner, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", *SMALL]) == 0
    said = capsys.readouterr()
    assert re.search(r"\[2/3\] dp3-safe-seen-1000: collecting, log: \S+\.log$", said.err, re.MULTILINE)
    assert "cells: 3/3" in said.err
    assert re.search(r"^cells: 0/3 \(0 %\) after 0 s$", said.err, re.MULTILINE), "time counts from the start"
    assert "3 cells: 1 unavailable, 2 done" in said.out
    assert "a library talks" not in said.out
    table = Path("outputs/benchmark/smoke/report/benchmark.md").absolute()
    assert f"table: {table}" in said.out
    assert "| bottle | dp3_adaptive (anchors) |" not in table.read_text()
    assert "rows without a result are left out" in table.read_text()
    count = len(runner.called)
    found = printed(capsys)
    assert states(found) == {"sampling": "unavailable", "dp3": "done", "dp3_adaptive": "done"}
    assert found["cells"][2]["success"]["episodes"] == read_declaration().scale("smoke").episodes
    assert len(runner.called) == count


def test_a_report_needs_the_files_alone(runner: FakeRunner, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", *SMALL]) == 0
    made, count = tmp_path / "outputs" / "benchmark" / "smoke", len(runner.called)
    elsewhere = tmp_path / "elsewhere" / "smoke"
    shutil.copytree(made / "cells", elsewhere / "cells")
    found = printed_last(capsys, "--report", "--out", "elsewhere")
    assert len(runner.called) == count
    for name in ("benchmark.md", "benchmark.csv"):
        assert (elsewhere / "report" / name).read_text() == (made / "report" / name).read_text()
    assert Path(found["metrics"]).read_text().startswith("result,")
    assert Path(found["picture of success"]).exists()


def printed_last(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """What is printed now, and nothing of before."""
    capsys.readouterr()
    return printed(capsys, *arguments)


def test_a_cell_that_fails_is_told_and_the_status_is_one(
    runner: FakeRunner, capsys: pytest.CaptureFixture[str]
) -> None:
    runner.failing = "lerobot-train"
    assert states(printed(capsys, status=1)) == {"sampling": "unavailable", "dp3": "failed", "dp3_adaptive": "failed"}
    assert main(["benchmark", *SMALL]) == 1
    assert "failed       lerobot-train ended with status 7: steps/train-" in capsys.readouterr().out


def test_a_cluster_collects(runner: FakeRunner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "require_usable", lambda address, insecure: None)  # Ray is an extra
    assert main(["benchmark", *SMALL, "--cluster", "local", "--workers", "0"]) == 0
    for called in runner.called:
        assert (called[-2:] == ["--workers=0", "--cluster=local"]) == (called[0] == "adamanip")


def test_ctrl_c_says_how_to_go_on(
    runner: FakeRunner, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "BenchmarkRun", functools.partial(BenchmarkRun, runner=interrupted))
    monkeypatch.setattr("sys.argv", ["adamanip", "benchmark", *SMALL])
    assert main(["benchmark", *SMALL]) == INTERRUPTED
    said = capsys.readouterr()
    assert "adamanip benchmark --scale smoke" in said.err
    assert said.out == ""
    assert runner.called == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "dp4"], "Unknown method"),
        (["--categories", "safe,teapot"], "Unknown category"),
        (["--splits", "external"], "Unknown split of objects"),
        (["--seeds", "one"], "Not a seed"),
        (["--seeds", "7"], "has no such cells"),
        (["--splits", "novel"], "splits seen, unseen"),
        (["--seeds", "1000,7", "--methods", "dp3"], "seeds 7\n"),
        (["--scale", "smoke", "--splits", "seen,novel"], "splits novel\n"),
        (["--scale", "huge"], "Unknown scale"),
        (["--config", "absent.toml"], "Not a declaration of a benchmark"),
        (["--jobs", "0", "--methods", "dp3"], "Not a number of jobs"),
        ([], "Nothing was chosen, and scale cpu has 180 cells"),
        (["--list", "--report"], "Two things at once"),
    ],
)
def test_mistakes_are_one_message(
    arguments: list[str], message: str, runner: FakeRunner, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", *arguments]) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert message in said.err
    assert "allowed:" in said.err
    assert said.out == ""
    assert runner.called == []
