"""`adamanip bench`: how it judges and reports. What it measures is no test: speed depends on the machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lerobot_adamanip.cli import main as cli
from lerobot_adamanip.cli.bench import command as bench
from lerobot_adamanip.cli.bench.timing import Stopwatch, judge, median_ms, per_second, ratio, repeat_ms

RESULTS: dict[str, Any] = {
    "machine": {"cores": 2},
    "collection": {"episodes_per_minute": 9.5, "episodes_per_minute_steady": None},
    "simulator": {"rendered_by_cast": 9.0},
    "observation_ms": {"raycast": {"total": 11.0}, "render": {"total": 99.0}},
    "action_ms": {"fast": {"batch_1": 130.0, "batch_10": 150.0}},
}


def test_limits_hold_on_the_right_side() -> None:
    limits: dict[str, Any] = {"time": (60.0, "most"), "rate": (8.0, "least")}
    for time, rate, ok in ((60.0, 8.0, True), (59.0, 9.0, True), (60.1, 7.9, False)):
        verdicts = judge({"time": time, "rate": rate}, limits)
        assert [verdict["ok"] for verdict in verdicts.values()] == [ok, ok]
        assert all(set(verdict) == {"value", "limit", "kind", "ok"} for verdict in verdicts.values())
    assert set(judge({"time": 1.0}, limits)) == {"time"}


def test_rates_and_ratios_are_inverse_to_time() -> None:
    assert per_second(40.0) == 25.0
    assert ratio(50.0, 10.0) == 5.0
    assert per_second(0.0) == ratio(1.0, 0.0) == 0.0
    assert median_ms([0.001, 0.002, 9.0]) == 2.0


def test_a_warm_up_is_called_but_not_counted() -> None:
    calls = []
    repeat_ms(lambda: calls.append(None), 3, warm_up=2)
    assert len(calls) == 5
    watch = Stopwatch({"slow start": [9.0, 0.1, 0.1], "once": [0.5]})
    assert watch.medians_ms() == {"slow start": 100.0, "once": 500.0}


def test_the_report_is_json_and_judged() -> None:
    report = bench.finish(RESULTS)
    assert json.loads(json.dumps(report)) == report
    assert {name: verdict["ok"] for name, verdict in report["limits"].items()} == {
        "episodes_per_minute": True,
        "observation_ms": True,
        "rendered_by_cast": True,
        "action_ms": False,
    }


def test_a_missed_limit_is_reported_not_an_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure(_self: bench.Bench, _root: Path) -> dict[str, Any]:
        print("a library talks")
        return RESULTS

    monkeypatch.setattr(bench.Bench, "_measure", measure)
    assert cli.main(["bench", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["limits"]["action_ms"]["ok"] is False
    assert cli.main(["bench"]) == 0
    printed = capsys.readouterr().out
    assert "MISSED" in printed
    assert "action_ms.fast.batch_10" in printed


@pytest.mark.parametrize("options", [["--workers", "0"], ["--device", "abacus"], ["--batch-size", "0"]])
def test_mistakes_are_one_message(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", *options]) == 2
    assert "Cannot measure that" in capsys.readouterr().err


def test_the_machine_is_described() -> None:
    machine = bench.describe_machine()
    assert machine["cores"] >= 1
    assert json.loads(json.dumps(machine)) == machine
