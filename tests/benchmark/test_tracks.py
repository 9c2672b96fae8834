"""Declarations of tracks and sensors: each cell can be planned, held-out categories are in no training."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import SCALE, VERSIONS, content

from lerobot_adamanip.benchmark import declaration
from lerobot_adamanip.benchmark.declaration import PAPER_TABLE, parse_declaration, read_declaration
from lerobot_adamanip.benchmark.plan import (
    COLLECT,
    EVALUATE,
    MERGE,
    TRAIN,
    Cell,
    Step,
    all_cells,
    last_checkpoint,
    plan,
)
from lerobot_adamanip.benchmark.report import make_report, scene_options
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.sensing import parse_sensing
from lerobot_adamanip.mechanisms import categories_with

TRACKS, RECIPE, KINDS = (
    read_declaration(Path(declaration.__file__).with_name(name))
    for name in ("tracks.toml", "default_policy.toml", "memories.toml")
)

MEMORY_OPTIONS = {
    "--policy.memory_kind", "--policy.n_action_history_steps", "--policy.n_obs_steps", "--memory", "--env.memory",
    "--policy.drop_n_last_frames",
}  # fmt: skip
"""The last: rows that a diffusion policy does not learn from, which depend on its number of observations."""
PRODUCTS = {
    "--policy.input_features", "--policy.path", "--output_dir", "--env.episode_log", "--dataset.root",
    "--dataset.repo_id",
}  # fmt: skip
"""Options that name other steps' products, and the columns that a policy reads."""


def chain(scale: str, method: str, category: str) -> list[Step]:
    cell = Cell(method=method, category=category, objects="unseen", seed=1000)
    return list(plan(cell, TRACKS, scale, VERSIONS).chain())


def options(step: Step) -> dict[str, str]:
    return dict(word.split("=", 1) for word in step.command if word.startswith("--") and "=" in word)


@pytest.mark.parametrize("scale", TRACKS.scales)
def test_every_cell_of_a_track_is_planned_with_its_expert_and_luck(scale: str) -> None:
    methods = TRACKS.methods_of(scale)
    assert {"expert", "luck"} < set(methods)
    assert len(methods) >= 4
    for cell in all_cells(TRACKS, scale):
        assert plan(cell, TRACKS, scale, VERSIONS).kind == EVALUATE
    luck, expert = (options(chain(scale, name, "door")[-1]) for name in ("luck", "expert"))
    assert luck.pop("--max-failed-tries") == "0"
    assert expert.pop("--max-failed-tries") == "best"
    assert {**luck, "--episode-log": ""} == {**expert, "--episode-log": ""}


@pytest.mark.parametrize("scale", ["held_out_category", "held_out_category_five"])
def test_no_training_sees_a_held_out_category_beyond_what_is_declared(scale: str) -> None:
    trainings: dict[str, set[str]] = {}
    for category in TRACKS.scale(scale).categories:
        steps = chain(scale, "dp3_adaptive_elsewhere", category)
        group = next(group for group in TRACKS.scale(scale).held_out if category in group)
        collected = [options(step) for step in steps if step.kind == COLLECT]
        seen = {each["--category"]: each["--objects"] for each in collected}
        few = {category: "0:5"} if scale.endswith("five") else {}
        assert seen == {**dict.fromkeys(set(CATEGORIES) - set(group), "seen"), **few}
        assert sum(step.kind == MERGE for step in steps) == 1
        trained = [step for step in steps if step.kind == TRAIN]
        assert len(trained) == 1 + bool(few)
        trainings.setdefault(str(group), set()).add(trained[0].key)
        if few:
            assert last_checkpoint(trained[0].product).as_posix() == options(trained[1])["--policy.path"]
            assert options(trained[1])["--steps"] == str(TRACKS.scale(scale).shown_steps)
    assert {len(keys) for keys in trainings.values()} == {1}, "shared by the categories of a group"


@pytest.mark.parametrize("scale", ["held_out_category", "held_out_category_five"])
@pytest.mark.parametrize("method", ["dp3_adaptive_elsewhere", "dp3_adaptive_elsewhere_without_memory"])
def test_an_evaluation_allows_categories_that_its_policy_has_not_seen(scale: str, method: str) -> None:
    evaluation = chain(scale, method, "pen")[-1]
    assert options(evaluation)["--env.other_categories"] == "true"
    assert "--env.other_categories" not in dict(scene_options(shlex.join(evaluation.command))), "its scenes stay"


def test_what_is_trained_on_other_categories_does_not_depend_on_what_is_shown_then() -> None:
    first = [
        next(step.key for step in chain(scale, "dp3_adaptive_elsewhere", "pen") if step.kind == TRAIN)
        for scale in ("held_out_category", "held_out_category_five")
    ]
    assert first[0] == first[1]


def test_shown_demonstrations_are_as_many_as_declared_and_of_seen_objects() -> None:
    name, category = "held_out_category_five", "pressure_cooker"
    five = TRACKS.scale(name)
    many = dataclasses.replace(
        five, shown=30, demonstrations_per_object=True, held_out=((category,),), categories=(category,)
    )
    cell = Cell(method="dp3_adaptive_elsewhere", category=category, objects="unseen", seed=1000)
    steps = plan(cell, dataclasses.replace(TRACKS, scales={name: many}), name, VERSIONS).chain()
    (shown,) = [each for step in steps if step.kind == COLLECT if (each := options(step))["--category"] == category]
    assert (shown["--objects"], shown["--episodes-per-object"]) == (f"0:{CATEGORIES[category].seen}", "5")


@pytest.mark.parametrize(("scale", "rules"), [("row", "row"), ("changing", "changing")])
def test_rules_of_a_scale_are_those_of_its_demonstrations_and_evaluations(scale: str, rules: str) -> None:
    assert set(TRACKS.scale(scale).categories) == set(categories_with(rules))
    steps = chain(scale, "dp3_adaptive", "door")
    assert options(steps[0])["--mechanism-rules"] == options(steps[-1])["--env.mechanism_rules"] == rules


def test_hints_and_repeats_reach_the_commands() -> None:
    steps = chain("hints", "dp3_adaptive_told", "door")
    assert (options(steps[0])["--hints"], options(steps[-1])["--env.hints"]) == ("0.5", "0.5")
    kept = options(chain("again", "dp3_adaptive_over_episodes", "door")[-1])
    assert kept["--env.repeats"] == kept["--policy.memory_episodes"] == "3"
    assert kept["--eval.batch_size"] == "1"
    assert int(kept["--eval.n_episodes"]) % 3 == 0
    assert options(chain("again", "expert", "door")[-1])["--repeats"] == "3"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"held_out": [["safe"]]}, "has no data_of"), ({"shown": 5}, "shown needs held_out"),
        ({"shown_steps": 5}, "needs both shown and shown_steps"),
        ({"held_out": [["fridge"]]}, "held_out"), ({"mechanism_rules": "rows"}, "mechanism_rules"),
        ({"hints": 2.0}, "hints"),
    ],
)  # fmt: skip
def test_a_wrong_track_is_named(changes: dict[str, Any], message: str) -> None:
    written = content()
    written["scales"][SCALE].update(changes)
    with pytest.raises(ValueError, match=message):
        parse_declaration(written)


def test_errors_of_sensors_are_of_evaluations_of_the_published_weights_or_of_one_other_training() -> None:
    sensing: dict[str, dict[str, tuple[str, str]]] = {"mistakes": {}, "mistakes_d435": {}}
    trainings: dict[str, set[str]] = {name: set() for name in sensing}
    for name in (name for name in RECIPE.methods_of("test") if RECIPE.methods[name].demonstrations in sensing):
        last = plan(Cell(method=name, category="door", objects="seen", seed=1000), RECIPE, "test", VERSIONS)
        chosen = options(last)
        level = chosen.get("--env.sensing", "exact"), chosen.get("--env.self_calibration", "false")
        if name == "dp3_adaptive" or level != ("exact", "false"):
            sensing[RECIPE.methods[name].demonstrations][name] = level
            trainings[RECIPE.methods[name].demonstrations].add(last.needs[0].key)
            assert parse_sensing(level[0]) is not None
    assert [len(keys) for keys in trainings.values()] == [1, 1]
    assert all(len(set(levels.values())) == len(levels) for levels in sensing.values())
    assert sensing["mistakes"]["d435"] == sensing["mistakes_d435"]["trained_d435"] == ("d435", "false")


@pytest.mark.parametrize("path", sorted(PAPER_TABLE.parent.glob("*.toml")), ids=lambda path: path.stem)
def test_declared_effects_are_in_the_same_scenes(path: Path) -> None:
    """Else the report would leave them out without a word. An effect that the report adds has its methods' options."""
    declaration = read_declaration(path)
    for scale in declaration.scales:
        cells = set(all_cells(declaration, scale))
        for effect in make_report([], declaration, scale).effects:
            methods = [declaration.methods[name] for name in (effect.method, effect.without)]
            own = {option.partition("=")[0] for method in methods for option in method.evaluate}
            sensing = {declaration.demonstrations[one.demonstrations].sensing for one in methods if one.demonstrations}
            own |= {"--env.sensing"} if len(sensing) > 1 else set()
            for cell in (one for one in cells if one.method == effect.method):
                other = dataclasses.replace(cell, method=effect.without)
                if other in cells and not (effect.categories and cell.category not in effect.categories):
                    commands = [shlex.join(plan(each, declaration, scale, VERSIONS).command) for each in (cell, other)]
                    left, right = map(scene_options, commands)
                    allowed = set() if effect in declaration.effects else own
                    assert {name for name, _ in left ^ right} <= allowed, (scale, effect.title)


def test_a_whole_environment_decides_the_scenes() -> None:
    command, whole = "lerobot-eval --env.type=adamanip_safe", "--env={type: adamanip_bottle}"
    assert dict(scene_options(shlex.join([*command.split(), whole])))["--env"] == whole.removeprefix("--env=")


def test_kinds_of_memory_differ_in_nothing_else() -> None:
    """Equal demonstrations, steps and scenes; a training differs in the kind of memory alone."""
    assert {KINDS.methods[name].policy for name in KINDS.methods} == {"dp3_adaptive", "diffusion", "act"}
    for effect in KINDS.effects:
        left, right = (
            plan(Cell(method=name, category="safe", objects="seen", seed=1000), KINDS, "memories", VERSIONS)
            for name in (effect.method, effect.without)
        )
        steps = [{step.kind: options(step) for step in last.chain()} for last in (left, right)]
        for kind, words in steps[0].items():
            other = steps[1][kind]
            changed = {name for name in {*words, *other} if words.get(name) != other.get(name)}
            assert changed <= PRODUCTS | MEMORY_OPTIONS
