"""Accounts of attempts: by hidden value, kept and attempted."""

from __future__ import annotations

from typing import Any

from lerobot_adamanip.datasets.attempts import AttemptRecord, count, grouped_by_hidden_value


def attempt(kept: bool, hidden: dict[str, Any] | None, slot: int = 0) -> AttemptRecord:
    return AttemptRecord("safe_000", slot, 0, 1, hidden, kept, "success" if kept else "time limit", 9, False)


LISTED = [
    attempt(True, {"locked": True, "angle": 0.5}),
    attempt(False, {"locked": True, "angle": 1.5}),
    attempt(True, {"locked": False, "angle": 2.5}),
    attempt(False, None),
]


def test_every_attempt_counts() -> None:
    counts = count(LISTED, 3)
    assert (counts.kept, counts.attempted, counts.given_up) == (2, 4, 1)


def test_they_divide_by_each_hidden_value() -> None:
    groups = grouped_by_hidden_value(LISTED)
    table = {label: (sum(each.kept for each in group), len(group)) for label, group in groups.items()}
    assert table["locked = true"] == (1, 2)
    assert table["locked = false"] == (1, 1)
    assert table["angle < 1.5"] == (1, 1)
    assert table["angle >= 1.5"] == (1, 2)
    assert table["(no layout)"] == (0, 1)
    assert grouped_by_hidden_value([]) == {}
