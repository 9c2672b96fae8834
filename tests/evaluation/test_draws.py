"""Reports of what policies draw, as tables: shares, what is new after failures, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lerobot_adamanip.evaluation.draws import CHOICES, MOTIONS, choices_page, motions_page, read_reports
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

NOW, BEFORE = "a" * 16, "b" * 16


def header(category: str, **changes: Any) -> dict[str, Any]:
    return {
        "command": f"python scripts/check.py --category {category}", "commit": "c" * 40, "fingerprint": NOW,
        "versions": {"python": "3.12.1"}, "category": category, **changes,
    }  # fmt: skip


def after(failed: int, repeated: float, **draws: int) -> dict[str, Any]:
    words = {name.replace("_", " "): count for name, count in draws.items()}
    return {"failed": failed, "draws": words, "repeat_of_tries": repeated, "repeat_of_all": repeated / 2}


def choices(category: str = "lamp", **changes: Any) -> dict[str, Any]:
    rows = [after(0, 0.0, no_try=50, push=30, turn=10), after(1, 0.125, no_try=2, turn=8)]
    episodes = {"mode 0": [10, 9], "mode 1": [10, 10]}
    return {**header(category), "split": "test", "after": rows, "episodes": episodes, **changes}


def motions(category: str = "lamp", **changes: Any) -> dict[str, Any]:
    spread = {"mm": [1.0, 2.5, 3.0], "deg": [0.0, 30.0, 40.0]}
    phases = {"try": {"rows": 7, "demonstrated": spread, "drawn": spread, "nearest": spread}}
    return {**header(category), "phases": phases, **changes}


def written(folder: Path, *reports: dict[str, Any]) -> Path:
    for number, report in enumerate(reports):
        again = "" if number == 0 else f"_{number}"
        (folder / f"{report['category']}{again}.json").write_text(json.dumps(report))
    return folder


def test_choices_are_shares_of_what_tries_something(tmp_path: Path) -> None:
    reports = read_reports(written(tmp_path, choices("lamp"), choices("safe", after=[after(0, 0.0, pull=4)])), CHOICES)
    page = choices_page(reports, {NOW})
    lines = [line for line in page.splitlines() if line.startswith("|")]
    assert lines[2] == "| safe 1 | 19/20 | pull 100 % | - |", "the order is that of the categories"
    assert lines[3] == "| lamp | 19/20 | push 75 %, turn 25 % | 87.5 % of 8 |"
    assert "not the present code's" not in page
    assert "not the present code's" in choices_page(reports, {BEFORE})


def test_reports_of_one_category_stand_side_by_side_by_the_names_of_their_files(tmp_path: Path) -> None:
    page = choices_page(read_reports(written(tmp_path, choices("lamp"), choices("lamp")), CHOICES), {NOW})
    told = [line.split(" | ")[0] for line in page.splitlines() if line.startswith("|")]
    assert told[2:] == ["| lamp", "| lamp 1"]


def test_motions_stand_beside_what_was_demonstrated(tmp_path: Path) -> None:
    page = motions_page(read_reports(written(tmp_path, motions()), MOTIONS), {NOW})
    told = "1/2.5/3 mm, 0/30/40°"
    assert f"| lamp | try | 7 | {told} | {told} | {told} |" in page


def test_no_reports_are_no_part_of_the_page(tmp_path: Path) -> None:
    assert read_reports(tmp_path / "absent", CHOICES) == {}


@pytest.mark.parametrize(
    "changes",
    [
        {"category": "teapot"},
        {"after": []},
        {"after": [after(0, 1.5, push=1)]},
        {"episodes": {"mode 0": [10]}},
        {"split": "training"},
        {"more": 1},
    ],
)
def test_what_is_no_report_is_one_error_with_its_name(tmp_path: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(DatasetError, match=r"(lamp|teapot)\.json"):
        read_reports(written(tmp_path, choices(**changes)), CHOICES)


def test_a_command_of_another_machine_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError):
        read_reports(written(tmp_path, choices(command="python check.py --policy /home/x/policy")), CHOICES)
