"""The log of a training: parameters and loss, or nothing."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from benchmark_helpers import SCALE, FakeRunner, benchmark, declared, run_all

from lerobot_adamanip.benchmark.plots import plot_report
from lerobot_adamanip.benchmark.report import make_report
from lerobot_adamanip.benchmark.report_text import budget_table
from lerobot_adamanip.benchmark.run import read_training_log
from lerobot_adamanip.evaluation.results import LOGGED, TrainingLog

LINE = (
    "Training:  5%| 1/20 [00:12<03:43]INFO 2026-11-27 ot_train.py:641 step:1 smpl:10K loss:{:.3f} grdn:5.7 lr:6e-04\r"
)
HEAD = "INFO ot_train.py:447 num_learnable_params=356136 (356K)\n"


def log_of(path: Path, losses: list[float], head: str = HEAD) -> TrainingLog | None:
    path.write_text(head + "".join(map(LINE.format, losses)))
    return read_training_log(path)


def test_a_whole_training_is_read_and_an_interrupted_one_is_not(tmp_path: Path) -> None:
    path, losses = tmp_path / "train.log", [2.0] * 12 + [1.0] * 4 + [0.75] * 4
    found = log_of(path, losses)
    assert found == TrainingLog(parameters=356136, losses=tuple(losses))
    assert found.change == pytest.approx(-0.25)
    assert log_of(path, losses[1:]) is None
    assert log_of(path, losses + losses) is None
    assert log_of(path, losses, head="") is None
    assert log_of(path, losses, head=HEAD * 2) is None
    assert read_training_log(tmp_path / "absent.log") is None


def test_the_budget_counts_what_a_method_was_given(tmp_path: Path) -> None:
    methods = {
        "ours": {
            "title": "Ours", "policy": "dp3_adaptive", "demonstrations": "adaptive",
            "rounds": [{"corrections": 5, "steps": 4, "start": "trained"}],
        },
        "untrained": {"title": "Untrained", "policy": "luck"},
    }  # fmt: skip
    declaration = declared(methods=methods)
    results = [each.result for each in run_all(benchmark(tmp_path, FakeRunner(tmp_path), declaration)) if each.result]
    log = TrainingLog(parameters=2_500_000, losses=(2.0,) * (LOGGED - 4) + (1.8,) * 4)
    cost = {"seconds": 120.0, "machine": {"cores": 2, "gpu": False}}
    for number, result in enumerate(results):
        assert result.run is not None
        run = dataclasses.replace(
            result.run,
            trainings=dict.fromkeys((name for name in result.run.steps if name.startswith("train")), log),
            costs={name: dataclasses.replace(paid, **cost) for name, paid in result.run.costs.items()},
        )
        results[number] = dataclasses.replace(result, run=run)
    report = make_report(results, declaration, SCALE)
    assert report.mean_losses("ours") == pytest.approx([1.0] * (LOGGED - 4) + [0.9] * 4), "of the loss at the start"
    assert report.mean_losses("untrained") == []
    assert "losses.png" in {path.name for path in plot_report(report, tmp_path)}
    table = budget_table(report)
    (row,) = (line for line in table.splitlines() if line.startswith("| Ours"))
    cells = [each.strip() for each in row.strip("|").split("|")]
    assert cells[1] == "6 adaptive demonstrations, 6 corrections"  # 5 of two objects, rounded up
    assert cells[2:] == ["8 + 4 x 2", "12", "2.5 million", "-10 %"]
    assert "Untrained" not in table
