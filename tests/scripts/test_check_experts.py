"""The check of the experts: what is planned, kept, resumed, counted and refused; on episodes that nobody runs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import check_common
import pytest
from check_experts import below, main, summarise
from expert_episodes import BATCH, BlindEnvironment, Episode, batches

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.results import read_result

Keep = Callable[[list[Episode]], None]


class Fake:
    """Runs nothing: every episode succeeds after 7 key frames, but those that ``fails`` picks."""

    def __init__(self, fails: Callable[[Episode], bool] = lambda episode: False, interrupt_after: int = 10**9) -> None:
        self.fails, self.interrupt_after, self.seen = fails, interrupt_after, list[Episode]()

    def __call__(self, episodes: list[Episode], workers: int, keep: Keep) -> None:
        for number, batch in enumerate(batches(episodes)):
            if number == self.interrupt_after:
                raise KeyboardInterrupt
            self.seen += batch
            keep([replace(e, success=not self.fails(e), key_frames=0 if self.fails(e) else 7) for e in batch])


def report(capsys: pytest.CaptureFixture[str], fake: Fake, *arguments: str) -> tuple[int, dict[str, Any]]:
    code = main([*arguments, "--json"], fake)
    return code, json.loads(capsys.readouterr().out)


def test_every_cell_has_as_many_episodes_and_both_experts_meet_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    fake = Fake()
    arguments = ("--category", "all", "--preset", "paper,hard", "--splits", "seen,unseen", "--episodes", "9")
    code, said = report(capsys, fake, *arguments)
    assert code == 0
    assert len(fake.seen) == 2 * 9 * 2 * 2 * 9
    cells = [row for row in said["results"] if row["split"] != "all"]
    assert {row["attempted"] for row in cells} == {9}
    assert len(cells) == 2 * 9 * 2 * 2
    met = {
        kind: {(e.preset, e.object_id, e.seed) for e in fake.seen if e.kind == kind} for kind in ("adaptive", "static")
    }
    assert met["adaptive"] == met["static"]
    seen = [e.object_id for e in fake.seen if (e.preset, e.kind, e.split) == ("hard", "adaptive", "seen")]
    assert len(set(seen)) == 8 * 9 + 6, "six pressure cookers are repeated, with other seeds"
    scenes = [(e.preset, e.kind, e.object_id, e.seed) for e in fake.seen]
    assert len(set(scenes)) == len(scenes)


def test_objects_are_run_wherever_they_belong(capsys: pytest.CaptureFixture[str]) -> None:
    for category in ("all", "door"):
        fake = Fake()
        code, _ = report(capsys, fake, "--category", category, "--objects", "door_900,door_009", "--episodes", "4")
        assert code == 0
        assert {e.object_id for e in fake.seen} == {"door_900", "door_009"}
        assert len(fake.seen) == 8
    fake = Fake()
    report(capsys, fake, "--category", "lamp", "--objects", "3:5", "--episodes", "2")
    assert {e.object_id for e in fake.seen} == {"lamp_003", "lamp_004"}


@pytest.mark.parametrize(
    "arguments",
    [("--category", "safe", "--objects", "door_009"), ("--category", "all", "--objects", "fridge_001"),
     ("--category", "safe", "--objects", "safe_x")],
)  # fmt: skip
def test_objects_that_are_not_there_are_refused_and_nothing_runs(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    fake = Fake()
    assert main(arguments, fake) == 2
    assert fake.seen == []
    told = capsys.readouterr().err
    assert all(word in told for word in ("got:", "allowed:", "try:"))


@pytest.mark.parametrize(
    "arguments", [("--splits", "all"), ("--episodes", "0"), ("--preset", "author"), ("--experts", "clairvoyant")]
)
def test_a_wrong_option_is_refused(arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments, Fake())
    assert caught.value.code == 2


def test_a_share_below_the_threshold_is_told_and_fails(capsys: pytest.CaptureFixture[str]) -> None:
    def fails(episode: Episode) -> bool:
        return episode.kind == "static" and episode.seed % 10 == 0

    code, said = report(capsys, Fake(fails), "--category", "safe", "--splits", "seen", "--episodes", "20")
    assert code == 1
    assert said["below"] == ["safe static: 0.900", "mean of static: 0.9000"]
    assert len(said["failures"]) == 2
    arguments = ("--category", "safe", "--splits", "seen", "--threshold", "0.9", "--mean", "0.9")
    assert report(capsys, Fake(fails), *arguments)[0] == 0


def test_a_scene_that_could_not_be_placed_counts_as_attempted() -> None:
    made = Episode("paper", "lamp", "adaptive", "seen", "lamp_000", 1)
    rows = summarise([replace(made, success=True, key_frames=5), replace(made, seed=2, placed=False)])
    assert [(row["attempted"], row["placed"], row["kept"]) for row in rows] == [(2, 1, 1), (2, 1, 1)]
    assert below(rows, 0.97, 0.99) == ["lamp adaptive: 0.500", "mean of adaptive: 0.5000"]


def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("--category", "safe", "--episodes", "25", "--out", str(tmp_path / "deep" / "out.json"))
    first, second, third = Fake(interrupt_after=2), Fake(), Fake()
    assert main(arguments, first) == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert len(first.seen) == 2 * BATCH
    code, said = report(capsys, second, *arguments)
    assert code == 0
    assert len(first.seen) + len(second.seen) == 100
    assert {e.identity for e in first.seen}.isdisjoint(e.identity for e in second.seen)
    assert report(capsys, third, *arguments)[1]["results"] == said["results"]
    assert third.seen == []
    at_once = report(capsys, Fake(), *arguments[:4])[1]
    assert at_once["results"] == said["results"]


def test_episodes_of_other_code_are_not_mixed_in(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("--category", "safe", "--episodes", "2", "--out", str(tmp_path / "out.json"))
    assert main(arguments, Fake()) == 0
    monkeypatch.setattr(check_common, "present_fingerprint", lambda: "other")
    fake = Fake()
    assert main(arguments, fake) == 2
    assert fake.seen == []
    assert "other code" in capsys.readouterr().err


def test_the_json_says_what_made_it(capsys: pytest.CaptureFixture[str]) -> None:
    code, said = report(capsys, Fake(), "--category", "safe", "--episodes", "3", "--first-seed", "42")
    assert code == 0
    assert set(said) >= {"command", "commit", "fingerprint", "versions", "seeds", "results", "failures"}
    assert said["seeds"] == [42, 10_044]


def test_a_result_file_has_a_row_for_each_cell_with_counts_by_what_is_hidden(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["scripts/check_experts.py", "--category", "safe"])
    path = tmp_path / "experts.json"
    arguments = ["--category", "safe", "--splits", "seen,novel", "--episodes", "4", "--result", str(path)]

    def run(episodes: list[Episode], workers: int, keep: Keep) -> None:
        keep([replace(e, success=True, hidden={"locked": e.seed % 2 == 0, "knob_range": 1.5}) for e in episodes])

    assert main(arguments, run) == 0
    result = read_result(path)
    assert result.command == "python scripts/check_experts.py --category safe"
    assert result.fingerprint == check_common.present_fingerprint()
    rows = [("adaptive", "seen", 4), ("static", "seen", 4), ("adaptive", "novel", 4), ("static", "novel", 4)]
    assert [(row.subject, row.objects, row.episodes) for row in result.rows] == rows
    assert all(row.hidden == {"locked": (2, 2), "unlocked": (2, 2)} for row in result.rows)


def test_a_result_with_a_path_of_this_machine_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["scripts/check_experts.py", "--out", "/home/me/out.json"])
    fake = Fake()
    assert main(["--result", str(tmp_path / "r.json")], fake) == 2
    assert fake.seen == []
    assert "must run elsewhere" in capsys.readouterr().err


def test_progress_is_told_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--category", "safe", "--episodes", "30"], Fake())
    shown = capsys.readouterr()
    assert "120/120 episodes" in shown.err
    assert shown.out.splitlines()[0].startswith("category")
    assert len(shown.out.splitlines()) == 1 + 2 * (2 + 1)


def test_a_batch_is_of_one_preset_and_one_category() -> None:
    episodes = [
        Episode(preset, category, "adaptive", "seen", f"{category}_000", seed)
        for seed in range(BATCH + 1)
        for preset in ("paper", "hard")
        for category in CATEGORIES
    ]
    made = batches(episodes)
    assert all(len({(e.preset, e.category) for e in batch}) == 1 for batch in made)
    assert sorted(len(batch) for batch in made) == [1] * 18 + [BATCH] * 18


def test_an_environment_without_eyes_goes_on_past_success() -> None:
    class Task:
        feedback, opened = "felt", iter([False, True, True])

        def execute(self, action: Any) -> None:
            self.action = action

        def succeeded(self) -> bool:
            return next(self.opened)

    env = BlindEnvironment(Task(), 45)
    ends = [env.step(number) for number in range(3)]
    assert not any(terminated for _, _, terminated, _, _ in ends)
    assert [info["is_success"] for *_, info in ends] == [False, True, True]
    assert env.opened_after == 2
