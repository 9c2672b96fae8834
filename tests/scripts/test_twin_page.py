"""The page about a session on the twin says what came of it, good or bad."""

from __future__ import annotations

import json
from typing import Any

import pytest
from twin_page import PAGE, REPORT, page


@pytest.fixture
def report() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(REPORT.read_text(encoding="utf-8"))
    return found


def test_the_page_is_made_of_the_report(report: dict[str, Any]) -> None:
    assert PAGE.read_text(encoding="utf-8") == page(report)


def test_what_fell_short_is_said(report: dict[str, Any]) -> None:
    text = page({**report, "opened": 3, "passed": False})
    assert f"| 3 of {report['episodes']} |" in text
    assert "Not all of it" in text


def test_roll_outs_are_told_once_and_nothing_names_a_machine(report: dict[str, Any]) -> None:
    text = page(report)
    assert text.count("lerobot-rollout") == 1
    assert f"and {report['roll_outs']['seeds'] - 1} more" in text
    assert not [word for word in text.split() if word.startswith("/")]
