"""Cells as declared; keys that change with what decides a result, and with nothing else."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import SCALE, VERSIONS, content, declared, with_scale
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS, PAPER_TABLE, Declaration, read_declaration
from lerobot_adamanip.benchmark.plan import (
    COLLECT,
    TRAIN,
    Cell,
    KeyVersions,
    Step,
    all_cells,
    evaluation_options,
    last_checkpoint,
    named_steps,
    options_key,
    plan,
    select_cells,
)
from lerobot_adamanip.benchmark.policies import find_policies, policy_package
from lerobot_adamanip.catalog import parse_object_selection, seen_objects
from lerobot_adamanip.cli.collect import CollectCommand
from lerobot_adamanip.cli.main import parse_command
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.results import EVALUATE, command_options
from lerobot_adamanip.util.errors import ConfigurationError


def option(command: Iterable[str], name: str) -> str:
    return command_options(shlex.join(command))[name]


def cell(method: str = "ours", objects: str = "seen", **changes: Any) -> Cell:
    return Cell(**{"method": method, "category": "safe", "objects": objects, "seed": 1000, **changes})


def steps(
    declaration: Declaration | None = None, versions: KeyVersions = VERSIONS, which: Cell | None = None
) -> dict[str, Step]:
    found = plan(which or cell(), declaration or declared(), SCALE, versions)
    return {step.kind: step for step in found.chain()}


def keys(**given: Any) -> dict[str, str]:
    return {kind: step.key for kind, step in steps(**given).items()}


def changed_kinds(**given: Any) -> set[str]:
    before, after = keys(), keys(**given)
    return {kind for kind in before if before[kind] != after[kind]}


# Cells ------------------------------------------------------------------------------------------------------------


def test_cells_are_all_combinations_each_once() -> None:
    declaration = read_declaration()
    for scale, chosen in declaration.scales.items():
        cells = all_cells(declaration, scale)
        methods = declaration.methods_of(scale)
        trainings = sum(len(chosen.seeds) if method.is_trained else 1 for method in methods.values())
        assert len(cells) == trainings * len(chosen.categories) * len(chosen.splits)
        assert len({each.name for each in cells}) == len(cells)
    cpu = all_cells(declaration, "cpu")
    order = [each.category for each in cpu]
    assert order == sorted(order, key=list(CATEGORIES).index), "a category is finished before the next begins"


def test_filters_choose_among_what_is_declared() -> None:
    declaration = read_declaration()
    wanted: dict[str, Any] = {"methods": ("act", "dp3"), "categories": ("safe",), "splits": ("seen",), "seeds": (1000,)}
    chosen = select_cells(declaration, "cpu", **wanted)
    assert [each.name for each in chosen] == ["act-safe-seen-1000", "dp3-safe-seen-1000"]
    assert select_cells(declaration, "cpu") == all_cells(declaration, "cpu")


@given(st.data())
def test_each_value_of_a_selection_is_of_a_selected_cell(data: st.DataObject) -> None:
    declaration = read_declaration(PAPER_TABLE.with_name("tracks.toml"))
    given_values: dict[str, Any] = {
        name: tuple(data.draw(st.lists(st.sampled_from(values), max_size=2, unique=True)))
        for name, values in {
            "methods": list(declaration.methods),
            "categories": ["safe", "lamp", "door"],
            "splits": list(OBJECT_SPLITS),
            "seeds": [1000, 1001, 5],
        }.items()
    }
    scale = data.draw(st.sampled_from(list(declaration.scales)))
    attributes = {"methods": "method", "categories": "category", "splits": "objects", "seeds": "seed"}

    def lacking(cells: list[Cell]) -> list[str]:
        return [
            str(value)
            for name, values in given_values.items()
            for value in values
            if value not in {getattr(cell, attributes[name]) for cell in cells}
        ]

    every = all_cells(declaration, scale)
    chosen = [
        cell
        for cell in every
        if all(not own or getattr(cell, attributes[name]) in own for name, own in given_values.items())
    ]
    if names := lacking(every) or lacking(chosen):
        with pytest.raises(ConfigurationError, match=".*".join(map(re.escape, names))):
            select_cells(declaration, scale, **given_values)
    else:
        assert select_cells(declaration, scale, **given_values) == chosen


# Commands ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["act", "dp3_adaptive_on_static", "dp3_adaptive"])
def test_collecting_is_a_command_of_ours(name: str) -> None:
    declaration = read_declaration()
    step = steps_of(declaration, name)[COLLECT]
    made = parse_command("collect", [*step.command[2:], *step.non_key_options])
    wanted = declaration.demonstrations[declaration.methods[name].demonstrations]
    assert (made.expert, made.trials, made.late_starts) == (wanted.expert, wanted.trials, wanted.late_starts)
    assert made.no_images == (not wanted.image_size)
    assert (made.image_size or 0) == wanted.image_size
    objects = len(made.spec().objects)
    assert 0 <= made.episodes_per_object * objects - declaration.scale("cpu").demonstrations < objects
    assert not made.root.is_absolute()
    assert made.max_attempts > CollectCommand.max_attempts, (
        "a scene that is hard to demonstrate in is no reason to stop"
    )
    assert not any("attempts" in word for word in step.command), "they decide nothing, and so are in no key"


def steps_of(declaration: Declaration, name: str) -> dict[str, Step]:
    return {each.kind: each for each in plan(cell(name), declaration, "cpu", VERSIONS).chain()}


@pytest.mark.parametrize("name", ["sampling", "act", "dp3_adaptive"])
def test_training_and_testing_are_commands_of_lerobots(name: str) -> None:
    import draccus
    import lerobot.policies  # noqa: F401
    from lerobot.configs.eval import EvalPipelineConfig
    from lerobot.configs.train import TrainPipelineConfig

    import lerobot_env_adamanip  # noqa: F401  (as LeRobot does with every installed plugin)

    found = steps_of(read_declaration(), name)
    train, test = found[TRAIN], found[EVALUATE]
    made = draccus.parse(config_class=TrainPipelineConfig, args=[*train.command[1:], *train.non_key_options])
    assert (made.policy.type, str(made.output_dir), made.save_freq) == (name, train.product, 400)
    checkpoint = option(test.command, "--policy.path")
    arguments = [word for word in test.command[1:] if checkpoint not in word]
    tested = draccus.parse(config_class=EvalPipelineConfig, args=[*arguments, f"--policy.type={made.policy.type}"])
    assert (tested.env.type, tested.eval.n_episodes, tested.env.split) == ("adamanip_safe", 50, "test")


def test_the_tests_are_those_of_the_demonstrations_objects_poses_and_points() -> None:
    declaration = with_scale(objects="0:3")
    for objects, said in (("seen", "0:3"), ("unseen", "unseen")):
        command = steps(declaration, which=cell(objects=objects))[EVALUATE].command
        assert option(command, "--env.objects") == said
        assert option(command, "--env.split") == "test"
    for objects, said in (("seen", "0:3"), ("unseen", "unseen_test"), ("novel", "novel_test")):
        command = steps(with_scale(objects="0:3", reports=True), which=cell(objects=objects))[EVALUATE].command
        assert option(command, "--env.objects") == said
    pictures = declared(demonstrations={"adaptive": {"image_size": 96, "num_points": 512}, "static": {}})
    tested = steps(pictures)[EVALUATE]
    assert (option(tested.command, "--env.image_size"), option(tested.command, "--env.num_points")) == ("96", "512")
    assert tested.non_key_options == ("--env.observe_images=true",)
    assert steps(declaration)[EVALUATE].non_key_options == (
        "--env.observe_images=false",
        "--env.image_size=128",
    )
    methods = content()["methods"]
    methods["ours"]["evaluate"] = ["--env.observe_images=true"]
    assert steps(declared(methods=methods))[EVALUATE].non_key_options == (), "no second word after a method's own"


def test_a_policy_that_needs_no_training_is_made_where_it_is_tested() -> None:
    methods = content()["methods"]
    methods["untrained"]["options"] = ["--policy.luck=0.5"]
    found = steps(declared(methods=methods), which=cell("untrained"))
    assert set(found) == {EVALUATE}
    assert {"--policy.type=luck", "--policy.luck=0.5"} < set(found[EVALUATE].command)


def test_a_checkpoint_on_the_hub_is_tested_and_not_trained() -> None:
    methods = content()["methods"]
    given = {"title": "Given", "policy": "act", "checkpoint": "me/act-{category}", "demonstrations": "adaptive"}
    given["revision"] = "v1.0"
    pictures = {"adaptive": {"image_size": 96}, "static": {}}
    chosen = declared(methods={**methods, "given": given}, demonstrations=pictures)
    found = steps(chosen, which=cell("given"))
    assert set(found) == {EVALUATE}
    category = option(found[EVALUATE].command, "--env.type").removeprefix("adamanip_")
    assert option(found[EVALUATE].command, "--policy.path") == f"me/act-{category}"
    assert option(found[EVALUATE].command, "--env.image_size") == "96", "it observes what its demonstrations hold"
    assert option(found[EVALUATE].command, "--policy.pretrained_revision") == "v1.0"
    assert len({each.seed for each in all_cells(chosen, SCALE) if each.method == "given"}) == 1
    other = declared(methods={**methods, "given": {**given, "revision": "v1.1"}}, demonstrations=pictures)
    assert steps(other, which=cell("given"))[EVALUATE].key != found[EVALUATE].key


def test_an_expert_is_tested_in_the_scenes_of_the_policies_and_once() -> None:
    methods = {**content()["methods"], "expert": {"title": "Expert", "expert": ["--expert=static", "--trials=2"]}}
    scale = {
        **content()["scales"][SCALE],
        "seeds": [1, 2],
        "evaluate": ["--seed=7", "--env.max_failed_tries=best", "--env.sensing=rough"],
    }
    declaration = declared(methods=methods, scales={SCALE: scale})
    assert [each.seed for each in all_cells(declaration, SCALE) if each.method == "expert"] == [1, 1]
    (test,) = plan(cell("expert"), declaration, SCALE, VERSIONS).chain()
    made = parse_command("expert", test.command[2:])
    assert (made.expert, made.trials, made.seed, made.episodes, made.sensing) == ("static", 2, 7, 5, "rough")
    assert str(made.episode_log.parent) == test.product
    policy = evaluation_options(shlex.join(steps(declaration)[EVALUATE].command))
    expert = evaluation_options(shlex.join(test.command))
    assert {name: policy[name] for name in expert if name != "--env.episode_log"} == {
        name: value for name, value in expert.items() if name != "--env.episode_log"
    }
    assert {"--env.type", "--env.objects", "--env.split", "--env.max_failed_tries", "--seed"} < expert.keys()


def test_an_expert_leaves_out_observations_and_no_other_option() -> None:
    methods = {**content()["methods"], "expert": {"title": "Expert", "expert": ["--expert=static"]}}

    def command(*own: str, **scale: Any) -> tuple[str, ...]:
        methods["expert"]["evaluate"] = list(own)
        scales = {SCALE: {**content()["scales"][SCALE], **scale}}
        return plan(cell("expert"), declared(methods=methods, scales=scales), SCALE, VERSIONS).command

    assert option(command(poses="fixed"), "--poses") == "fixed"
    unseen = ("--policy.use_amp=false", "--env.self_calibration=true", "--env.render_backend=cpu")
    assert command(evaluate=list(unseen))[:-1] == command()[:-1]
    for wrong in (
        "--env.max_failed_trys=0",
        "--env.locked=true",
        "--env.workspace_upper=[1,1,1]",
        "--eval.n_episode=3",
    ):
        for one in ({"evaluate": [wrong]}, {}):
            with pytest.raises(ConfigurationError, match="none of `adamanip expert`"):
                command(*([] if one else [wrong]), **one)


def test_demonstrations_are_counted_by_category_or_by_object() -> None:
    for is_per_object, wanted in ((False, "3"), (True, "6")):
        command = steps(with_scale(demonstrations_per_object=is_per_object))[COLLECT].command
        assert option(command, "--episodes-per-object") == wanted


def test_options_of_a_method_win() -> None:
    methods = content()["methods"]
    methods["ours"] |= {"train": ["--batch_size=7"], "evaluate": ["--env.episode_length=15"], "steps": {SCALE: 3}}
    found = steps(declared(methods=methods))
    assert (option(found[TRAIN].command, "--batch_size"), option(found[TRAIN].command, "--steps")) == ("7", "3")
    assert option(found[EVALUATE].command, "--env.episode_length") == "15"
    methods["ours"] |= {"train_at": {SCALE: ["--batch_size=9", "--policy.dim_model=8"], "other": ["--batch_size=5"]}}
    scales = {**content()["scales"], "other": content()["scales"][SCALE]}
    scales[SCALE]["evaluate"] = ["--env.episode_length=18", "--env.max_parallel_tasks=1"]
    found = steps(declared(methods=methods, scales=scales))
    command = found[TRAIN].command
    assert (option(command, "--batch_size"), option(command, "--policy.dim_model")) == ("9", "8")
    methods["ours"]["train_at"][cell().category] = ["--batch_size=11"]
    assert option(steps(declared(methods=methods, scales=scales))[TRAIN].command, "--batch_size") == "11"
    command = found[EVALUATE].command
    assert (option(command, "--env.episode_length"), option(command, "--env.max_parallel_tasks")) == ("15", "1")


def test_options_may_begin_from_other_weights_or_data() -> None:
    """LeRobot takes either a type or a path, and reads an existing folder whatever the name of the dataset is."""
    methods = content()["methods"]
    other = ["--policy.path=me/base", "--dataset.repo_id=me/data"]
    methods["ours"] |= {"learns_from": "more", "train": other, "rounds": [{"corrections": 5, "steps": 4}]}
    methods["ours"]["rounds"].append({"corrections": 2, "steps": 3, "start": "trained"})
    found = named_steps(plan(cell(), declared(methods=methods), SCALE, VERSIONS))
    for name, path in (("train", "me/base"), ("train_3", str(last_checkpoint(found["train_2"].product)))):
        options = command_options(shlex.join(found[name].command))
        assert options["--policy.path"] == path
        assert options["--dataset.repo_id"] == "me/data"
        assert not {"--policy.type", "--dataset.root"} & options.keys()
    methods["ours"] = {**content()["methods"]["ours"], "options": other[:1], "learns_from": "more"}
    assert "ours" not in find_policies(declared(methods=methods).methods)[1]


def test_a_training_is_logged_in_the_parts_of_its_own_length() -> None:
    methods = content()["methods"]
    methods["ours"]["train"] = ["--steps=600"]
    training = steps(declared(methods=methods))[TRAIN]
    assert option(("x", *training.non_key_options), "--log_freq") == "30"


def test_a_round_of_corrections_collects_with_the_policy_and_trains_on_everything() -> None:
    methods = content()["methods"]
    methods["ours"]["rounds"] = [
        {"corrections": 5, "steps": 4},
        {"corrections": 2, "steps": 3, "start": "trained"},
    ]
    found = named_steps(plan(cell(), declared(methods=methods), SCALE, VERSIONS))
    names = "collect train correct merge train_2 correct_2 merge_2 train_3 evaluate"
    assert list(found) == names.split()
    assert not any("trials" in word or "late" in word for word in found["correct"].command), "keys of results hold"
    chosen = {"adaptive": {"trials": 3, "late_starts": 0.5}, "static": {}}
    corrected = named_steps(plan(cell(), declared(methods=methods, demonstrations=chosen), SCALE, VERSIONS))["correct"]
    made = parse_command("collect", [*corrected.command[2:], *corrected.non_key_options])
    assert (made.trials, made.late_starts) == (3, 0.5)
    before = steps()
    assert (found["collect"], found["train"]) == (before[COLLECT], before[TRAIN]), "they are those without a round"
    first = found["correct"]
    made = parse_command("collect", [*first.command[2:], *first.non_key_options])
    assert (made.episodes_per_object, str(made.policy)) == (3, str(last_checkpoint(found["train"].product)))
    assert found["merge"].command[2:4] == (found["collect"].product, first.product)
    assert found["merge_2"].command[2:4] == (found["merge"].product, found["correct_2"].product)
    seeds = [parse_command("collect", found[name].command[2:]).seed for name in ("collect", "correct", "correct_2")]
    assert seeds[0] == seeds[1] != seeds[2], "two rounds in the same scenes could share an episode"
    for name, data, begin in (
        ("train_2", "merge", "--policy.type=dp3_adaptive"),
        ("train_3", "merge_2", f"--policy.path={last_checkpoint(found['train_2'].product)}"),
    ):
        assert option(found[name].command, "--dataset.root") == found[data].product
        assert begin in found[name].command
    assert option(found["evaluate"].command, "--policy.path") == str(last_checkpoint(found["train_3"].product))


def test_one_policy_for_all_categories_trains_on_the_data_of_another_method() -> None:
    methods = content()["methods"]
    methods["ours"]["rounds"] = [{"corrections": 5, "steps": 4}]
    methods["all"] = {"title": "One for all", "policy": "dp3_adaptive", "data_of": "ours", "steps": {SCALE: 30}}
    declaration = declared(
        methods=methods, scales={SCALE: {**content()["scales"][SCALE], "categories": ["safe", "door"]}}
    )
    tested = {name: plan(cell("all", category=name), declaration, SCALE, VERSIONS) for name in ("safe", "door")}
    (training,) = {each.needs[0] for each in tested.values()}
    (merged,) = training.needs
    each = [named_steps(plan(cell(category=name), declaration, SCALE, VERSIONS))["merge"] for name in ("safe", "door")]
    assert merged.needs == tuple(each)
    assert option(training.command, "--steps") == "30"
    for name, test in tested.items():
        assert option(test.command, "--env.type") == f"adamanip_{name}"


def test_a_path_of_this_machine_is_refused_before_anything_runs(tmp_path: Path) -> None:
    methods = content()["methods"]
    methods["ours"]["options"] = [f"--policy.backbone={tmp_path}/weights"]
    with pytest.raises(ConfigurationError, match="must run elsewhere"):
        steps(declared(methods=methods))


# Keys -------------------------------------------------------------------------------------------------------------


def test_what_a_step_reads_is_what_another_made() -> None:
    found = steps()
    assert found[COLLECT].command[-1] == option(found[TRAIN].command, "--dataset.root")
    assert option(found[EVALUATE].command, "--policy.path").startswith(option(found[TRAIN].command, "--output_dir"))
    assert all(found[kind].key in found[kind].product for kind in found)


def test_results_that_are_kept_are_of_what_is_declared() -> None:
    """Keys hold commands: an option that is called otherwise now must not change them."""
    scale, root = "control_rate", Path(__file__).parents[2]
    declaration = read_declaration(PAPER_TABLE.with_name(f"{scale}.toml"))
    folder = root / "results" / "benchmark" / scale
    stored = {path.stem: json.loads(path.read_text())["run"]["options"] for path in folder.glob("*.json")}
    assert stored
    keys = {each.name: options_key(each, declaration, scale) for each in all_cells(declaration, scale)}
    assert stored == {name: keys[name] for name in stored}


def in_order(parameter: object) -> str:
    """Returns a test's name: a set is told in another order by each process, and then no two processes run one test."""
    return str(sorted(parameter) if isinstance(parameter, set) else parameter)


EVERYTHING, TRAINING, TEST = {COLLECT, TRAIN, EVALUATE}, {TRAIN, EVALUATE}, {EVALUATE}


@pytest.mark.parametrize(
    ("scale", "kinds"),
    [
        ({"demonstrations": 7}, EVERYTHING), ({"objects": "0:3"}, EVERYTHING), ({"steps": 9}, TRAINING),
        ({"batch_size": 3}, TRAINING), ({"device": "cuda"}, TRAINING), ({"episodes": 6}, TEST),
        ({"environments": 1}, TEST), ({"poses": "fixed"}, EVERYTHING), ({"evaluate": ["--x=1"]}, TEST),
        ({"save_every": 1}, set()), ({"categories": ["door"]}, set()), ({"seeds": [1000, 6]}, set()),
        ({"note": "Small."}, set()), ({"beside_paper": True}, set()), ({"objects_at": {"door": "0:1"}}, set()),
        ({"objects_at": {"safe": "0:1"}}, EVERYTHING), ({"seeds": [6, 1000]}, EVERYTHING),
    ],
    ids=in_order,
)  # fmt: skip
def test_keys_follow_the_scale(scale: dict[str, Any], kinds: set[str]) -> None:
    assert changed_kinds(declaration=with_scale(**scale)) == kinds


def test_every_scale_has_demonstrations_of_seen_objects_alone() -> None:
    """As `adamanip collect` demands of all of them, late: after other categories were trained."""
    for path in PAPER_TABLE.parent.glob("*.toml"):
        for name, scale in read_declaration(path).scales.items():
            for category in scale.categories:
                selected = parse_object_selection(category, scale.objects_of(category))
                assert set(selected) <= set(seen_objects(category)), f"{path.name}, {name}, {category}"


@pytest.mark.parametrize(
    ("method", "kinds"),
    [
        ({"demonstrations": "static"}, EVERYTHING), ({"policy": "act"}, TRAINING), ({"train": ["--x=1"]}, TRAINING),
        ({"options": ["--policy.num_anchors=8"]}, TRAINING), ({"evaluate": ["--x=1"]}, TEST),
        ({"train_at": {SCALE: ["--x=1"]}}, TRAINING), ({"title": "Other"}, set()), ({"paper": "ACT"}, set()),
    ],
    ids=in_order,
)  # fmt: skip
def test_keys_follow_the_method(method: dict[str, Any], kinds: set[str]) -> None:
    methods = content()["methods"]
    methods["ours"] |= method
    assert changed_kinds(declaration=declared(methods=methods)) == kinds


@pytest.mark.parametrize(
    ("versions", "kinds"),
    [
        ({"simulation": 9}, EVERYTHING),
        ({"data": 9}, EVERYTHING),
        ({"policies": {**VERSIONS.policies, "ours": "their-lab 1.0"}}, TRAINING),
        ({"policies": {"untrained": "their-lab 1.1"}}, set()),
    ],
    ids=in_order,
)
def test_keys_follow_the_versions(versions: dict[str, Any], kinds: set[str]) -> None:
    assert changed_kinds(versions=dataclasses.replace(VERSIONS, **versions)) == kinds


def test_keys_of_policies_without_training_follow_all_versions() -> None:
    before = keys(which=cell("untrained"))
    for changes in ({"simulation": 9}, {"data": 9}, {"policies": {"untrained": "their-lab 1.1"}}):
        other = dataclasses.replace(VERSIONS, **changes)
        assert keys(which=cell("untrained"), versions=other) != before, changes


def test_keys_follow_the_cell() -> None:
    assert changed_kinds(which=cell(seed=1001)) == EVERYTHING, "each training has its own demonstrations"
    assert changed_kinds(declaration=with_scale(seeds=[0, 1000]), which=cell(seed=0)) == TRAINING, "seed 0 may be first"
    assert changed_kinds(which=cell(objects="unseen")) == TEST
    assert changed_kinds(which=cell(category="bottle")) == EVERYTHING


def test_the_options_key_knows_no_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    before = options_key(cell(), declared(), SCALE)
    monkeypatch.setattr("lerobot_adamanip.benchmark.plan.SIMULATION_VERSION", 99)
    assert before == options_key(cell(), declared(), SCALE)
    assert before != options_key(cell(), with_scale(steps=9), SCALE)
    assert before not in keys().values()


# Packages of policies ---------------------------------------------------------------------------------------------


def test_a_policy_of_others_has_the_version_of_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, package in (("lerobot.policies.act", ""), ("lerobot_policy_adamanip.dp3_adaptive", "")):
        assert policy_package(type("Config", (), {"__module__": f"{module}.configuration"})) == package
    theirs = type("Config", (), {"__module__": "their_policies.mine.configuration"})
    assert policy_package(theirs) == "", "a module on the path belongs to no distribution"
    monkeypatch.setattr("importlib.metadata.packages_distributions", lambda: {"their_policies": ["their-lab"]})
    monkeypatch.setattr("importlib.metadata.version", lambda name: "1.0")
    assert policy_package(theirs) == "their-lab 1.0"


def test_a_dense_set_of_demonstrations_has_dense_tests_with_the_same_rows() -> None:
    dense = {"control": "dense", "action": "ee_pose", "state": "full", "cloud": True}
    chain = steps(declared(demonstrations={"adaptive": dense, "static": {}}))
    names = ("control", "action", "state")
    recorded, tested = chain[COLLECT].command, chain[EVALUATE].command
    assert [option(recorded, f"--{name}") for name in names] == ["dense", "ee_pose", "full"]
    assert [option(tested, f"--env.{name}") for name in names] == ["dense", "ee_pose", "full"]
    assert "--cloud" in recorded
    assert option(tested, "--env.observe_cloud") == "true"
    assert not any("control" in word for word in steps()[COLLECT].command)


def test_memory_and_sensing_are_of_demonstrations_and_tests_and_mistakes_of_demonstrations_alone() -> None:
    chain = steps(
        declared(demonstrations={"adaptive": {"memory": "events", "sensing": "d435", "mistakes": 0.2}, "static": {}})
    )
    recorded, tested = chain["collect"].command, chain["evaluate"].command
    assert [option(recorded, f"--{name}") for name in ("memory", "sensing", "mistakes")] == ["events", "d435", "0.2"]
    assert [option(tested, f"--env.{name}") for name in ("memory", "sensing")] == ["events", "d435"]
    assert not any("mistakes" in word for word in tested)
    plain = steps(declared(demonstrations={"adaptive": {}, "static": {}}))
    assert not any(
        name in word for step in plain.values() for word in step.command for name in ("memory", "sensing", "mistakes")
    )
