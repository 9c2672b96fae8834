"""`adamanip bench`: how it judges and prints. Its numbers are no test: speed depends on the machine."""

from __future__ import annotations

import json
from typing import Any

import pytest

from lerobot_adamanip.cli import bench
from lerobot_adamanip.cli import main as cli

RESULTS: dict[str, Any] = {
    "machine": {"cores": 2},
    "collection": {"episodes_per_minute": 9.5},
    "simulator": {"rendered_by_cast": 9.0},
    "observation_ms": {"raycast": {"total": 15.0}, "render": {"total": 99.0}},
    "action_ms": {"fast": {"batch_1": 130.0, "batch_10": 150.0}},
}


def test_a_missed_limit_is_told_and_no_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure(_self: bench.Bench) -> dict[str, Any]:
        print("a library talks")
        return RESULTS

    monkeypatch.setattr(bench.Bench, "_measure", measure)
    assert cli.main(["bench", "--json"]) == 0
    limits = json.loads(capsys.readouterr().out)["limits"]
    assert {name: each["ok"] for name, each in limits.items()} == {
        "collection.episodes_per_minute": True,
        "observation_ms.raycast.total": True,
        "simulator.rendered_by_cast": True,
        "action_ms.fast.batch_1": False,
    }
    assert cli.main(["bench"]) == 0
    assert "at most 100" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--device", "tpu"], ["--workers", "0"]])
def test_mistakes_are_one_message(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", *arguments]) == 2
    assert "Cannot measure that" in capsys.readouterr().err
