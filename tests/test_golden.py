"""Behaviour changes only together with its version; see `golden_values`."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import golden
import golden_values
import numpy as np
import pytest
from golden_values import ALL, Golden, digest, statistics

PLAIN, DATA, SIMULATION = ALL


@pytest.mark.parametrize("each", ALL, ids=lambda each: each.name)
def test_stored_values_are_of_the_present_version(each: Golden) -> None:
    version, stored = each.stored()
    assert version == each.version, "run: python scripts/golden.py --write"
    assert stored.keys() == each.compute.keys(), each.advice()


def check(group: Golden, name: str) -> None:
    value = json.loads(json.dumps(group.compute[name]()))
    assert group.difference(name, value) == "", group.advice()


@pytest.mark.parametrize("name", PLAIN.compute)
def test_what_needs_no_simulator_is_as_its_version_says(name: str) -> None:
    check(PLAIN, name)


@pytest.mark.parametrize("name", DATA.compute)
def test_rows_and_trainings_are_as_their_version_says(name: str) -> None:
    check(DATA, name)


@pytest.mark.sim
@pytest.mark.parametrize("name", SIMULATION.compute)
def test_episodes_are_as_their_version_says(name: str) -> None:
    check(SIMULATION, name)


# The comparison ---------------------------------------------------------------------------------------------------


def fake(folder: Path, monkeypatch: pytest.MonkeyPatch, value: Any, version: int = 3, tolerance: float = 0.0) -> Golden:
    monkeypatch.setattr(golden_values, "GOLDEN", folder)
    monkeypatch.setattr(golden, "ROOT", folder)
    return Golden("fake", "DATA_VERSION", version, {"value": lambda: value}, tolerance)


def test_a_change_is_written_only_with_another_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = fake(tmp_path, monkeypatch, {"a": [1, 2.0]})
    assert golden.compare(first, write=True) == []
    before = first.path.read_text()
    changed = fake(tmp_path, monkeypatch, {"a": [1, 2.5]})
    differs = "value/a/1: 2.5, not 2. "
    assert golden.compare(changed, write=False) == [differs]
    refused = golden.compare(changed, write=True)
    assert refused == [differs, f"not written: {changed.advice()}"]
    assert "raise DATA_VERSION in lerobot_adamanip/contract/versions.py" in refused[1]
    assert first.path.read_text() == before
    raised = dataclasses.replace(changed, version=4)
    assert golden.compare(raised, write=True) == []
    assert raised.stored() == (4, {"value": {"a": [1, 2.5]}})


def test_digits_that_differ_between_processors_are_no_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    golden.compare(fake(tmp_path, monkeypatch, {"a": 0.5, "b": 200.0}), write=True)
    near = fake(tmp_path, monkeypatch, {"a": 0.5009, "b": 200.1}, tolerance=1e-3)
    far = fake(tmp_path, monkeypatch, {"a": 0.502, "b": 200.1}, tolerance=1e-3)
    assert golden.compare(near, write=False) == []
    assert golden.compare(far, write=False) == ["value/a: 0.502, not 0.5. "]
    for other in ({"a": 0.5}, {"a": 1, "b": 200.0}, {"a": float("nan"), "b": 200.0}, "text"):
        assert golden.compare(fake(tmp_path, monkeypatch, other, tolerance=1e-3), write=False) != [], other


def test_a_digest_ignores_last_digits_and_nothing_else() -> None:
    value = {"a": [1 / 640, np.float32(0.1)], "b": "text", "c": None, "d": np.eye(2)}
    assert digest(value) == digest({**value, "a": [np.nextafter(1 / 640, 0), 0.1]})
    assert digest(value) == digest(dict(reversed(value.items())))
    for change in ({"a": [1 / 640, 0.100002]}, {"b": "Text"}, {"c": False}, {"d": np.eye(2)[0]}, {"d": -np.eye(2)}):
        assert digest({**value, **change}) != digest(value), change


def test_means_of_a_cloud_follow_its_points_and_not_their_order() -> None:
    cloud = np.random.default_rng(0).random((2, 40, 3))
    assert statistics(cloud.reshape(2, -1)) == {**statistics(cloud.reshape(-1, 3)), "shape": [2, 120]}
    assert statistics(cloud[0]) == statistics(cloud[0, ::-1])
    moved = statistics(cloud[0] + (0.0, 0.0, 0.01))["mean"]
    np.testing.assert_allclose(np.subtract(moved, statistics(cloud[0])["mean"]), (0, 0, 0.01), atol=2e-6)


def test_the_documents_name_the_present_versions() -> None:
    text = Path(golden.ROOT, "docs", "concepts.md").read_text(encoding="utf-8")
    for each in (PLAIN, DATA):
        assert re.search(rf"`{each.version_name}` \({each.version}\)", text)
