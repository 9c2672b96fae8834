"""The check with third-party validators: what it takes for a defect, and a validator that writes no report."""

from __future__ import annotations

import json
from pathlib import Path

import check_validators
import pytest

REPORTS = {
    "robovet": {"results": [{"check_id": "A-1", "severity": "PASS", "summary": "fine"}]},
    "rdq": {"findings": [{"severity": "WARNING", "message": "4 episodes are much shorter than usual"}]},
    "adduct": {"clusters": []},
    "lerobot-doctor": {"checks": []},
    "lerobot-quality-gates": {"findings": []},
}
WRONG = {"check_id": "STATS-303", "severity": "FAIL", "summary": "meta/stats.json disagrees with the data"}


@pytest.fixture
def commands(tmp_path: Path) -> Path:
    """Stand-ins of the validators, which write what lies in a file beside them."""
    folder = tmp_path / "out" / "venv" / "bin"
    folder.mkdir(parents=True)
    (folder.parent / "installed").touch()
    for name, report in REPORTS.items():
        (folder / f"{name}.stored").write_text(json.dumps(report))
        command = folder / name
        command.write_text(
            '#!/bin/sh\nfor last; do :; done\ncase "$last" in *.json) exec >"$last";; esac\ncat "$0.stored"\n'
        )
        command.chmod(0o755)
    return folder


def run(tmp_path: Path) -> int:
    return check_validators.main([str(tmp_path), "--out", str(tmp_path / "out")])


def test_expected_findings_alone_are_no_failure(
    tmp_path: Path, commands: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path) == 0
    assert capsys.readouterr().out.endswith("5 validators, 1 findings, 0 of them defects\n")


def test_any_other_finding_is_a_failure(tmp_path: Path, commands: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (commands / "robovet.stored").write_text(json.dumps({"results": [WRONG]}))
    assert run(tmp_path) == 1
    assert "robovet: STATS-303: meta/stats.json disagrees with the data\n    DEFECT" in capsys.readouterr().out


def test_a_validator_without_a_report_is_an_error(tmp_path: Path, commands: Path) -> None:
    (commands / "adduct.stored").write_text("Traceback")
    with pytest.raises(RuntimeError, match="adduct wrote no report"):
        run(tmp_path)
