"""`make publish`: a benchmark's policy, its data and the environments, on a Hub on loopback."""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
from pathlib import Path
from typing import Any

import publish
import pytest
from benchmark_helpers import FakeRunner, benchmark, declared, run_all
from loopback_hub import LoopbackHub

from lerobot_adamanip.benchmark.plan import FOLDERS, last_checkpoint
from lerobot_adamanip.evaluation.results import read_result, write_result

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def folder(published: Path, trained: Path, tmp_path: Path) -> Path:
    """A benchmark's folder with results of ``ours`` on safes, whose dataset and checkpoint are real."""
    root = tmp_path / "bench"
    for state in run_all(benchmark(root, FakeRunner(tmp_path / "fake"), declared())):
        assert state.result is not None
    run = read_result(root / "cells" / "ours-safe-seen-1000.json").run
    assert run is not None
    step = run.steps
    for name, product in (("collect", published), ("train", trained)):
        made = root / FOLDERS[name] / step[name].key
        made.rename(made.with_name(f"fake-{name}"))
        place = made if name == "collect" else last_checkpoint(made)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(product)
    return root


def test_a_policy_its_data_and_the_environments_are_published(folder: Path, run: Any, hub: LoopbackHub) -> None:
    options = ["--user", "someone", "--benchmark", str(folder), "--method", "ours", "--categories", "safe"]
    options += ["--name", "tiny", "--json"]
    assert publish.main([*options, "--dry-run"]) == 0
    assert not hub.repositories
    printed = json.loads(run(str(ROOT / "scripts" / "publish.py"), *options).stdout)
    assert [(each["kind"], each["repo_id"]) for each in printed] == [
        ("dataset", "someone/adamanip-tiny-safe"),
        ("model", "someone/tiny-safe"),
        ("environment", "someone/adamanip"),
    ]
    assert all(each["bytes"] > 0 and each["changed"] for each in printed)
    card = hub.files("models", "someone/tiny-safe")["README.md"].decode()
    for objects in ("seen", "unseen"):
        cell = read_result(folder / "cells" / f"ours-safe-{objects}-1000.json")
        success = cell.rows[0].metrics.success
        assert f"| Ours | safe | {objects} | paper | {success.count}/{success.episodes}" in card
        assert cell.command in card
    assert "someone/adamanip-tiny-safe" in card


def test_policies_of_two_names_share_no_dataset(folder: Path) -> None:
    shared = {"user": "someone", "benchmark": folder, "method": "ours", "seed": 1000, "categories": ("safe",)}
    pushed = [
        publish.publications(argparse.Namespace(**shared, name=name, private=True, dry_run=True))
        for name in (publish.NAME, "no-memory", "other")
    ]
    datasets, models, _ = zip(*pushed, strict=True)
    assert [each.repo_id for each in datasets] == [
        "someone/adamanip-safe",
        "someone/adamanip-no-memory-safe",
        "someone/adamanip-other-safe",
    ]
    assert [each.dataset for each in models] == [each.repo_id for each in datasets]


def test_a_policy_without_a_result_is_one_error(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert publish.main(["--user", "someone", "--benchmark", str(folder), "--method", "theirs", "--dry-run"]) == 2
    printed = capsys.readouterr().err
    assert "error: No result of this policy." in printed
    assert "theirs-bottle-seen-1000.json" in printed


def test_what_is_missing_is_known_before_anything_is_sent(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[str] = []
    monkeypatch.setattr(publish.PushCommand, "publish", lambda push: sent.append(push.repo_id))
    options = ["--user", "someone", "--benchmark", str(folder), "--method", "ours", "--categories", "safe,bottle"]
    assert publish.main(options) == 2
    assert "ours-bottle-seen-1000.json" in capsys.readouterr().err
    assert not sent


def test_results_on_a_card_are_of_the_published_training(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, options = folder / "cells" / "ours-safe-unseen-1000.json", ["--user", "someone", "--benchmark", str(folder)]
    options += ["--categories", "safe", "--dry-run"]
    result = read_result(path)
    assert result.run is not None
    train = dataclasses.replace(result.run.steps["train"], key="f" * 16)
    other = dataclasses.replace(result.run, steps={**result.run.steps, "train": train})
    later = dataclasses.replace(result.run, data_version=result.run.data_version + 1)
    for changed in (
        dataclasses.replace(result, run=other),
        dataclasses.replace(result, run=later),
        dataclasses.replace(result, simulation_version=1),
    ):
        write_result(path, changed)
        assert publish.main([*options, "--method", "ours"]) == 2
        assert "error: The results of a checkpoint are of several trainings" in capsys.readouterr().err
    write_result(path, dataclasses.replace(result, run=None))
    for method in ("ours", "untrained"):
        assert publish.main([*options, "--method", method]) == 2
        assert "error: A result of no training." in capsys.readouterr().err


def test_whose_it_is_must_be_said() -> None:
    """The environment variable USER, the name of the login, does not count."""
    done = subprocess.run(["make", "-n", "publish"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "make publish USER=you" in done.stderr
