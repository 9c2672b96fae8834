"""The leaderboard's rule, and its order."""

from __future__ import annotations

import dataclasses
import itertools
import json
from typing import Any

import pytest
from benchmark_helpers import SCALE, FakeRunner, benchmark, content, declared, run_all

from lerobot_adamanip.benchmark import leaderboard
from lerobot_adamanip.benchmark.cells import Cell
from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS
from lerobot_adamanip.benchmark.leaderboard import leaderboard_page, violations
from lerobot_adamanip.benchmark.result import CellResult, StepDone, parse_cell, read_cells
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.rates import rate

PRESENT = SIMULATION_VERSION


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> CellResult:
    """A result of one cell by the rule."""
    folder = tmp_path_factory.mktemp("leaderboard")
    changes = {"splits": ["seen"], "objects": "seen", "seeds": [1000], "evaluate": ["--seed=700000"]}
    scale = {**content()["scales"][SCALE], **changes}
    methods = {"ours": content()["methods"]["ours"]}
    run_all(benchmark(folder / "out", FakeRunner(folder), declared(scales={SCALE: scale}, methods=methods)))
    (result,) = read_cells(folder / "out" / "cells")
    return result


def entry(made: CellResult, share: float = 1.0, options: str = "", **changes: Any) -> list[CellResult]:
    """An entry that opens a share of all scenes, half of them within the best strategy's tries."""
    success, within = rate(round(100 * share), 100), rate(round(50 * share), 100)
    numbers = dataclasses.replace(made.numbers, success=success, within_best_tries=within)
    outcomes = "2" * within.count + "1" * (success.count - within.count) + "0" * (100 - success.count)
    tries = outcomes.translate(str.maketrans("012", "930"))
    changes = {"scene_seeds": (700000, 700099), "outcomes": outcomes, "failed_tries": tries, **changes}
    whole, step = dataclasses.replace(made, numbers=numbers, **changes), made.steps["evaluate"]
    results = []
    for category, objects in itertools.product(CATEGORIES, OBJECT_SPLITS):
        scenes = f"--eval.n_episodes=100 --env.type=adamanip_{category} --env.objects={objects}"
        command = f"{step.command} {scenes} {options}"
        steps = {**made.steps, "evaluate": StepDone(key=step.key, command=command)}
        cell = Cell(method="ours", category=category, objects=objects, seed=1000, trials=None)
        results.append(dataclasses.replace(whole, cell=cell, steps=steps))
    return results


def with_training(result: CellResult, option: str, key: str = "") -> CellResult:
    """A result whose training has one more option, and another key if given."""
    step = result.steps["train"]
    changed = StepDone(key=key or step.key, command=f"{step.command} {option}")
    return dataclasses.replace(result, steps={**result.steps, "train": changed})


def test_an_entry_by_the_rule_breaks_nothing(made: CellResult) -> None:
    assert list(violations(entry(made), PRESENT)) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"changed": True}, "changes"),
        ({"commit": None}, "from none"),
        ({"simulation_version": 1}, "simulation version 1, not "),
        ({"scene_seeds": (700100, 700199)}, "scenes 700100 to 700199, not 700000"),
        ("--env.split=validation", "--env.split=validation, not test"),
        ("--seed=1", "--seed=1, not 700000"),
        ("--env.mechanism_rules=upstream", "not paper"),
        ("--env.episode_length=99", "--env.episode_length must keep the default"),
        ("--env.objects=0:1", "--env.objects=0:1, not "),
        ("--config_path=mine.json", "--config_path must keep"),
    ],
)
def test_what_breaks_the_rule_is_said(made: CellResult, changes: Any, said: str) -> None:
    given = {"options": changes} if isinstance(changes, str) else changes
    found = list(violations(entry(made, **given), PRESENT))
    assert len(found) == len(CATEGORIES) * len(OBJECT_SPLITS)
    assert all(said in each for each in found)


def test_a_policy_is_trained_on_seen_objects(made: CellResult) -> None:
    collect = made.steps["collect"]
    novel = StepDone(key=collect.key, command=collect.command.replace("--objects=seen", "--objects=novel"))
    for steps in ({"evaluate": made.steps["evaluate"]}, {**made.steps, "collect": novel}):
        found = list(violations(entry(dataclasses.replace(made, steps=steps)), PRESENT))
        assert len(found) == len(CATEGORIES) * len(OBJECT_SPLITS)
        assert all("without a training on demonstrations of seen objects" in each for each in found)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--seed=1007", "trained with seed 1007, not 1000"),
        ("--dataset.root=demonstrations/eeeeeeeeeeeeeeee", "not made by the entry's own steps"),
        ("--policy.path=trainings/../theirs", "not made by the entry's own steps"),
    ],
)
def test_another_seed_dataset_or_policy_is_no_entry(made: CellResult, option: str, said: str) -> None:
    found = list(violations([with_training(each, option) for each in entry(made)], PRESENT))
    assert len(found) == len(CATEGORIES) * len(OBJECT_SPLITS)
    assert all(said in each for each in found)


def test_the_policy_of_the_last_training_is_evaluated_on_all_objects(made: CellResult) -> None:
    other = "--policy.path=trainings/eeeeeeeeeeeeeeee/checkpoints/last/pretrained_model"
    found = list(violations(entry(made, options=other), PRESENT))
    assert len(found) == len(CATEGORIES) * len(OBJECT_SPLITS)
    assert all("another policy than that of its last training" in each for each in found)
    whole = entry(made)
    renamed = with_training(whole[0], "--batch_size=32", key="f" * 16)
    assert f"{renamed.cell.category}: several policies of seed 1000" in list(violations([renamed, *whole[1:]], PRESENT))


@pytest.mark.parametrize(
    ("numbers", "changes"),
    [
        ({"within_best_tries": [5, 6]}, {}),
        ({"within_best_tries": [5, 5]}, {"outcomes": "", "failed_tries": ""}),
        ({}, {"outcomes": "22122"}),
        ({"within_best_tries": [3, 5]}, {"outcomes": "21022", "failed_tries": "00011"}),
    ],
    ids=str,
)
def test_a_result_that_contradicts_itself_is_refused(
    made: CellResult, numbers: dict[str, Any], changes: dict[str, Any]
) -> None:
    stored = json.loads(json.dumps(made.to_json()))
    assert parse_cell(stored).numbers == made.numbers
    with pytest.raises(ValueError, match=r"outcomes|within"):
        parse_cell({**stored, "numbers": {**stored["numbers"], **numbers}, **changes})


def test_everything_must_be_there_with_enough_episodes_of_one_method(made: CellResult) -> None:
    whole = entry(made)
    (found,) = violations(whole[1:], PRESENT)
    assert found == f"{whole[0].cell.category} {whole[0].cell.objects}: training seeds none, not 1000"

    def trained(results: list[CellResult], seed: int) -> list[CellResult]:
        return [
            with_training(dataclasses.replace(each, cell=dataclasses.replace(each.cell, seed=seed)), f"--seed={seed}")
            for each in results
        ]

    assert list(violations([*whole, *trained(whole[:2], 1001)], PRESENT)) == [], "more trainings of some categories"
    assert "| 50.0 % (1 to 2) |" in leaderboard_page({"more": [*whole, *trained(whole[:2], 1001)]})
    (found,) = violations([*whole, *trained(whole[:1], 1002)], PRESENT)
    assert found.endswith("training seeds 1000, 1002, not 1000, 1001"), "one is left out"
    best = list(violations(trained(whole, 1007), PRESENT))
    assert len(best) == len(whole)
    assert all(each.endswith("training seeds 1007, not 1000") for each in best), "the best of several is no entry"
    other = dataclasses.replace(whole[0], cell=dataclasses.replace(whole[0].cell, method="other"))
    assert "several methods: other, ours" in list(violations([*whole, other], PRESENT))
    few = [dataclasses.replace(each, numbers=made.numbers, outcomes=made.outcomes) for each in whole]
    found = list(violations(few, PRESENT))
    assert len(found) == len(few)
    assert all(f"not {leaderboard.EPISODES}" in each for each in found)


def test_the_best_stands_first(made: CellResult) -> None:
    page = leaderboard_page({"weak": entry(made, 0.4), "strong": entry(made, 0.8)})
    lines = [line for line in page.splitlines() if line.startswith("| ")]
    assert [line.split(" | ")[0].strip("| ") for line in lines[-2:]] == ["strong", "weak"]
    assert "| 40.0 % | 80.0 % | 80.0 % | 80.0 % |" in lines[-2]
    assert "No entry yet." in leaderboard_page({})
