"""The check of the experts: what is planned, counted and refused; on episodes that nobody runs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from check_experts import SPLITS, Episode, below, main, summarise

from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.results import read_result


class Fake:
    """Runs nothing: every episode succeeds after 7 key frames, but those that ``fails`` picks."""

    def __init__(self, fails: Callable[[Episode], bool] = lambda episode: False) -> None:
        self.fails, self.seen = fails, list[Episode]()

    def __call__(self, episodes: list[Episode], workers: int) -> list[Episode]:
        self.seen += episodes
        hidden = ({"locked": e.seed % 2 == 0, "knob_range": 1.5} for e in episodes)
        return [
            replace(e, success=not self.fails(e), key_frames=0 if self.fails(e) else 7, hidden=each)
            for e, each in zip(episodes, hidden, strict=True)
        ]


def report(capsys: pytest.CaptureFixture[str], fake: Fake, *arguments: str) -> tuple[int, dict[str, Any]]:
    code = main([*arguments, "--json"], fake)
    return code, json.loads(capsys.readouterr().out)


def test_every_cell_has_as_many_episodes_and_both_experts_meet_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    fake = Fake()
    arguments = ("--category", "all", "--mechanism-rules", "paper,hard", "--splits", "seen,unseen", "--episodes", "9")
    code, said = report(capsys, fake, *arguments)
    assert code == 0
    cells = [row for row in said["results"] if row["split"] != "all"]
    assert ({row["attempted"] for row in cells}, len(cells)) == ({9}, 2 * 9 * 2 * 2)
    met = [
        {(e.mechanism_rules, e.object_id, e.seed) for e in fake.seen if e.kind == kind}
        for kind in ("adaptive", "static")
    ]
    assert met[0] == met[1]
    scenes = [(e.mechanism_rules, e.kind, e.object_id, e.seed) for e in fake.seen]
    assert len(set(scenes)) == len(scenes)
    assert set(said) >= {"command", "commit", "simulation_version", "versions", "seeds", "results", "failures"}


def test_objects_are_run_wherever_they_belong(capsys: pytest.CaptureFixture[str]) -> None:
    for category, objects, ids in (
        ("all", "door_900,door_009", {"door_900", "door_009"}),
        ("lamp", "3:5", {"lamp_003", "lamp_004"}),
    ):
        fake = Fake()
        report(capsys, fake, "--category", category, "--objects", objects, "--episodes", "4")
        assert ({e.object_id for e in fake.seen}, len(fake.seen)) == (ids, 8)


@pytest.mark.parametrize(
    "arguments",
    [
        ("--objects", "door_009"), ("--category", "all", "--objects", "fridge_001"), ("--objects", "safe_x"),
        ("--splits", "all"), ("--episodes", "0"), ("--mechanism-rules", "author"), ("--result", "/home/me/out.json"),
    ],
)  # fmt: skip
def test_a_wrong_option_is_refused_and_nothing_runs(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["scripts/check_experts.py", *arguments])
    fake = Fake()
    try:
        code: object = main(arguments, fake)
    except SystemExit as error:  # of the parser
        code = error.code
    assert (code, fake.seen) == (2, [])
    assert re.search("got:|error:", capsys.readouterr().err)


def test_a_share_below_the_threshold_is_told_and_fails(capsys: pytest.CaptureFixture[str]) -> None:
    def fails(episode: Episode) -> bool:
        return episode.kind == "static" and episode.seed % 10 == 0

    code, said = report(capsys, Fake(fails), "--category", "safe", "--splits", "seen", "--episodes", "20")
    assert (code, len(said["failures"])) == (1, 2)
    assert said["below"] == ["safe static paper seen: 0.900", "mean of static paper seen: 0.9000"]
    arguments = ("--category", "safe", "--splits", "seen", "--threshold", "0.9", "--mean", "0.9")
    assert report(capsys, Fake(fails), *arguments)[0] == 0


@pytest.mark.parametrize("field_name", ["mechanism_rules", "split", "category", "kind"])
def test_a_cell_below_the_threshold_fails_whatever_the_others_reach(field_name: str) -> None:
    whole = Episode("paper", "lamp", "adaptive", "seen", "lamp_000", 1, success=True, key_frames=5)
    other = {"mechanism_rules": "hard", "split": "unseen", "category": "safe", "kind": "static"}[field_name]
    cell = [replace(whole, seed=k, success=k > 0, **{field_name: other}) for k in range(10)]  # type: ignore[arg-type]
    low = below(summarise([whole] * 1000 + cell), 0.97, 0.9)
    assert [line.endswith(": 0.900") and other in line for line in low] == [True]


def test_a_scene_that_could_not_be_placed_counts_as_attempted() -> None:
    made = Episode("paper", "lamp", "adaptive", "seen", "lamp_000", 1)
    rows = summarise([replace(made, success=True, key_frames=5), replace(made, seed=2, placed=False)])
    assert [(row["attempted"], row["placed"], row["kept"]) for row in rows] == [(2, 1, 1), (2, 1, 1)]
    assert below(rows, 0.97, 0.99) == ["lamp adaptive paper seen: 0.500", "mean of adaptive paper seen: 0.5000"]


def test_a_result_file_has_a_row_for_each_cell_with_counts_by_what_is_hidden(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["scripts/check_experts.py", "--category", "safe"])
    path = tmp_path / "experts.json"
    assert main(["--category", "safe", "--splits", "seen,novel", "--episodes", "4", "--result", str(path)], Fake()) == 0
    result = read_result(path)
    assert result.command == "python scripts/check_experts.py --category safe"
    assert result.simulation_version == SIMULATION_VERSION
    objects, path = "safe_000,safe_036,safe_n001", tmp_path / "several.json"
    assert main(["--category", "safe", "--objects", objects, "--episodes", "6", "--result", str(path)], Fake()) == 0
    rows = [(row.objects, row.metrics.success.episodes) for row in read_result(path).rows]
    assert sorted(rows) == sorted([(split, 2) for split in SPLITS] * 2), "each object is of its own split"
    cells = [("adaptive", "seen"), ("static", "seen"), ("adaptive", "novel"), ("static", "novel")]
    assert [(row.subject, row.objects) for row in result.rows] == cells
    assert all(row.metrics.hidden == {"locked": rate(2, 2), "unlocked": rate(2, 2)} for row in result.rows)
    assert all(row.metrics.key_frames == {7: 4} for row in result.rows)
