"""Failed tries by part and kind."""

from __future__ import annotations

from records import record

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.failed_tries import (
    KINDS_OF_TRIES,
    failed_tries_by_kind,
    failed_tries_text,
    kind_of_try,
)
from lerobot_adamanip.evaluation.report import summarise


def test_every_category_names_its_two_joints() -> None:
    assert set(KINDS_OF_TRIES) == set(CATEGORIES)
    expected = ["door pulled", "door pulled, back", "knob turned +", "knob turned -"]
    assert [kind_of_try("safe", joint, sign) for joint in (0, 1) for sign in (1, -1)] == expected


def test_failed_tries_are_counted_by_kind_and_successful_ones_are_not() -> None:
    tries = ((0, 1, True), (1, -1, True), (1, 1, False), (0, 1, True), (0, 1, False))
    episodes = [record(object_id="safe_000", try_sequence=tries), record(object_id="safe_001", seed=1)]
    counts = failed_tries_by_kind(episodes)
    assert counts["safe"]["door pulled"] == 2 + failed_tries_by_kind(episodes[1:])["safe"].get("door pulled", 0)
    assert counts["safe"]["knob turned -"] >= 1
    assert "knob turned +" not in failed_tries_by_kind(episodes[:1])["safe"]
    assert list(failed_tries_by_kind(episodes[:1])["safe"]) == ["door pulled", "knob turned -"]
    assert failed_tries_text({"safe": {"door pulled": 2}, "pen": {}}) == ["safe: door pulled 2", "pen: none"]
    assert summarise(episodes).to_json()["failed_tries_by_kind"] == counts
