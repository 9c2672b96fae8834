"""Runs of trainings: every step once, on from where it was, and a table that follows from the logs alone."""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
from pathlib import Path
from typing import Any

import policy_runs
import pytest
from policy_runs import Run, numbers, summary
from records import record

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.log import append_record
from lerobot_adamanip.evaluation.results import read_result


class Commands:
    """Stands in for LeRobot's commands: writes what they would leave behind, and fails when told to."""

    def __init__(self) -> None:
        self.called: list[list[str]] = []
        self.failing = ""

    def __call__(self, command: list[str], **_: Any) -> Any:
        name = Path(command[0]).name
        self.called.append([name, *command[1:]])
        if name == self.failing:
            return subprocess.CompletedProcess(command, 1)
        options = dict(word.removeprefix("--").partition("=")[::2] for word in command[1:])
        if name == "adamanip":
            folder = command[2 if command[1] == "collect" else command.index("--out") + 1]
            info = Path(folder) / "meta" / "info.json"
            info.parent.mkdir(parents=True)
            info.touch()
        if name == "lerobot-train":
            out = options.get("output_dir") or str(Path(options["config_path"]).parents[3])
            state = Path(out) / "checkpoints" / "last" / "training_state" / "training_step.json"
            state.parent.mkdir(parents=True, exist_ok=True)
            state.write_text(json.dumps({"step": int(options["steps"])}))
        if name == "lerobot-eval":
            with Path(options["env.episode_log"]).open("a") as log:
                log.write("one\n")
        return subprocess.CompletedProcess(command, 0)

    @property
    def names(self) -> list[str]:
        return [name for name, *_ in self.called]


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> Commands:
    made = Commands()
    monkeypatch.setattr(policy_runs.subprocess, "run", made)
    return made


def run_of(folder: Path, category: str = "door", **changes: Any) -> Run:
    values = {
        "data": str(folder / "data" / "{category}"), "episodes_per_object": 2, "train_objects": "seen", "steps": 10,
        "batch_size": 4, "seed": 3, "train": ["--policy.trunk_dim=64"], "split": "validation", "episodes": 5,
        "corrections": 0, "correction_steps": 4, "expert": "adaptive", "out": folder / "runs", "objects": ("seen",),
        "name": ("default",), "category": ("door",), "result": folder / "result.json", "title": "policies",
        "corrected": (), "expert_preset": "paper", "correction_start": "new", "spread": False,
        "after": None,
    }  # fmt: skip
    return Run(folder / "runs" / f"default-{category}", category, argparse.Namespace(**{**values, **changes}))


def all_of(run: Run) -> None:
    run.collect()
    run.train()
    run.correct()
    run.evaluate("seen")


def test_each_step_is_run_once(tmp_path: Path, commands: Commands) -> None:
    for _ in range(2):
        all_of(run_of(tmp_path))
    assert commands.names == ["adamanip", "lerobot-train", "lerobot-eval"]
    assert "--policy.trunk_dim=64" in commands.called[1]
    assert [entry["step"] for entry in policy_runs.steps(run_of(tmp_path).folder)] == ["collect", "train", "evaluate"]


def test_a_training_goes_on_to_more_steps(tmp_path: Path, commands: Commands) -> None:
    all_of(run_of(tmp_path))
    run_of(tmp_path, steps=20).train()
    assert "--resume=true" in commands.called[-1]
    assert "--steps=20" in commands.called[-1]


def test_an_evaluation_that_broke_off_is_begun_anew(tmp_path: Path, commands: Commands) -> None:
    run = run_of(tmp_path)
    run.collect()
    run.train()
    commands.failing = "lerobot-eval"
    run.log("seen").write_text("half\n")
    with pytest.raises(SystemExit, match="lerobot-eval failed"):
        run.evaluate("seen")
    assert list(summary(run.folder, 5)) == [], "half an evaluation is no result"
    commands.failing = ""
    run.log("seen").write_text("half\n")
    run.evaluate("seen")
    assert run.log("seen").read_text() == "one\n"


def test_a_policy_is_corrected_once_and_what_was_retrained_is_evaluated(tmp_path: Path, commands: Commands) -> None:
    for _ in range(2):
        all_of(run_of(tmp_path, corrections=3))
    train = "lerobot-train"
    assert commands.names == ["adamanip", train, "adamanip", "adamanip", train, "lerobot-eval"]
    first, on = (next(word for word in call if word.startswith("--output_dir=")) for call in commands.called[1:5:3])
    assert commands.called[2][commands.called[2].index("--policy") + 1].startswith(first.partition("=")[2])
    assert commands.called[5][1].startswith(f"--policy.path={on.partition('=')[2]}")


def test_corrections_may_go_on_from_the_trained_weights(tmp_path: Path, commands: Commands) -> None:
    for start in ("new", "trained"):
        all_of(run_of(tmp_path / start, corrections=3, correction_start=start, expert_preset="to_stop"))
    (_, fresh), (first, on) = (
        [call for call in commands.called if call[0] == "lerobot-train"][i : i + 2] for i in (0, 2)
    )
    weights = next(word for word in first if word.startswith("--output_dir=")).partition("=")[2]
    assert on[1].startswith(f"--policy.path={weights}")
    assert fresh[1] == "--policy.type=dp3_adaptive"
    assert "--policy.trunk_dim=64" in on
    recorded = [call for call in commands.called if call[1] == "collect"]
    assert all(call[call.index("--expert-preset") + 1] == "to_stop" for call in recorded)


def test_a_corrected_policy_is_corrected_again(tmp_path: Path, commands: Commands) -> None:
    all_of(run_of(tmp_path, corrections=3))
    first = tmp_path / "runs" / "default-door"
    again = dataclasses.replace(
        run_of(tmp_path, corrections=7, correction_start="trained", after="default"),
        folder=first.with_name("more-door"),
    )
    begun = len(commands.called)
    for _ in range(2):
        all_of(again)
    collect, merge, train, evaluate = commands.called[begun:]
    assert collect[collect.index("--policy") + 1].startswith(str(first / "retrain"))
    assert merge[2:4] == [str(first / "both"), str(again.folder / "corrections")]
    assert train[1].startswith(f"--policy.path={first / 'retrain'}")
    assert evaluate[1].startswith(f"--policy.path={again.folder / 'retrain'}")
    assert again.before == first
    assert dataclasses.replace(again, folder=first).before is None, "a run with a training of its own follows none"


def test_only_the_categories_that_were_named_are_corrected(tmp_path: Path, commands: Commands) -> None:
    for category in ("bottle", "door"):
        all_of(run_of(tmp_path, category, corrections=3, corrected=("door",)))
    assert commands.names.count("lerobot-train") == 3
    evaluated = [call[1] for call in commands.called if call[0] == "lerobot-eval"]
    assert "default-bottle/train/" in evaluated[0]
    assert "default-door/retrain/" in evaluated[1]


def test_the_suite_is_all_categories_in_one_and_is_told_what_to_do(tmp_path: Path, commands: Commands) -> None:
    all_of(run_of(tmp_path, "bottle"))
    for _ in range(2):
        all_of(run_of(tmp_path, policy_runs.SUITE))
    assert sum(call[1] == "collect" for call in commands.called) == len(CATEGORIES), "nothing is recorded again"
    merge, train, evaluation = commands.called[-3:]
    assert [Path(root).name for root in merge[2 : merge.index("--out")]] == list(CATEGORIES)
    assert {"--policy.use_instruction=true", "--policy.balance_tasks=true"} < set(train)
    assert "--env.type=adamanip" in evaluation


def test_a_result_file_holds_the_settings_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = run_of(tmp_path, name=("narrow", "wide"), category=("door", "lamp"), objects=("seen", "unseen")).options
    with pytest.raises(SystemExit, match="nothing to write"):
        policy_runs.write_results(options)
    for name, seconds in (("narrow", 60), ("wide", 90)):
        folder = tmp_path / "runs" / f"{name}-door"
        folder.mkdir(parents=True)
        trained = [{"step": step, "command": [], "seconds": seconds} for step in ("train", "retrain", "evaluate")]
        (folder / "steps.json").write_text(json.dumps(trained))
        log = folder / "validation-seen.jsonl"
        for seed in range(7):
            opened = record(object_id="door_000", seed=seed, success=seed > 2)
            append_record(log, opened)
        log.with_suffix(".done").touch()
        (folder / "validation-unseen.jsonl").write_text("half of it")
    monkeypatch.setattr(policy_runs.sys, "argv", ["policy_runs.py", "--name", "narrow,wide"])
    policy_runs.write_results(options)
    found = read_result(options.result)
    assert found.command == "python scripts/policy_runs.py --name narrow,wide"
    told = [(row.subject, row.category, row.objects, row.successes, row.train_minutes) for row in found.rows]
    # Five episodes were asked for; what was not finished does not count.
    assert told == [("narrow", "door", "seen", 2, 2.0), ("wide", "door", "seen", 2, 3.0)]
    assert found.kind == "policy"
    options.spread = True
    policy_runs.write_results(options)
    assert read_result(options.result).kind == "seeds"


def test_numbers_of_no_episode_are_no_success() -> None:
    assert numbers([])["interval"] == [0, 1]
    assert numbers([])["successes"] == 0
