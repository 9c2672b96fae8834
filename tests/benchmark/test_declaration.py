"""Declarations: the paper's is complete, mistakes are one message that names the field."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import SCALE, content, declared

from lerobot_adamanip.benchmark.declaration import GROUPS, PAPER_TABLE, parse_declaration, read_declaration
from lerobot_adamanip.benchmark.paper_rates import PAPER_CATEGORIES, SUCCESS, reported, reported_mean
from lerobot_adamanip.benchmark.policies import find_policies
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.errors import ConfigurationError


def test_the_papers_declaration_has_every_method_of_the_paper() -> None:
    found = read_declaration()
    assert {method.paper for method in found.methods.values()} - {""} == set(SUCCESS)
    assert set(found.scales) == {"smoke", "overfit", "cpu", "paper", "full"}
    assert found.scale("cpu").categories == tuple(CATEGORIES)
    assert found.scale("cpu").episodes >= 50


def test_the_papers_methods_learn_from_what_the_paper_trained_them_on() -> None:
    found = read_declaration()
    experts = {
        name: found.demonstrations[method.demonstrations].expert
        for name, method in found.methods.items()
        if method.paper
    }
    assert {name for name, expert in experts.items() if expert == "adaptive"} == {"adaafford", "dp3_adaptive"}
    assert set(experts.values()) == {"adaptive", "static"}
    for history in ("", "_without_history"):
        without, ours = (found.methods[f"dp3_adaptive{on}{history}"] for on in ("_on_static", ""))
        assert (without.policy, without.options, without.steps) == (ours.policy, ours.options, ours.steps)


def test_a_method_can_be_like_one_above_it() -> None:
    methods = {
        **content()["methods"],
        "variant": {"like": "ours", "title": "Variant", "evaluate": ["--a=b"]},
        "again": {"like": "variant", "title": "Again", "demonstrations": "static"},
    }
    found = declared(methods=methods).methods
    assert found["variant"] == replace(found["ours"], title="Variant", paper="", evaluate=("--a=b",))
    assert found["again"] == replace(found["variant"], title="Again", demonstrations="static")


def test_other_weights_need_a_line_that_says_what_they_learned_from() -> None:
    methods = content()["methods"]
    methods["ours"] |= {"options": ["--policy.path=me/pretrained"], "learns_from": "pretrained on pictures"}
    assert declared(methods=methods).methods["ours"].learns_from


def test_the_papers_numbers_are_of_all_categories_and_their_means_are_its_order() -> None:
    assert {len(values) for values in SUCCESS.values()} == {len(PAPER_CATEGORIES)}
    means = {name: reported_mean(name, PAPER_CATEGORIES) or 0.0 for name in SUCCESS}
    order = ["Ours", "Ours w/o adaptive", "DP3", "ACT", "AdaAfford", "VAT-Mart", "Sampling"]
    assert sorted(means, key=lambda name: -means[name]) == order
    assert reported("Ours", "microwave") == (100.0, 0.0)
    assert reported(None, "safe") is None
    assert reported("Ours", "jar") is None
    assert reported_mean("", ["safe"]) is None


def test_every_row_of_the_papers_table_can_be_made_here() -> None:
    methods = read_declaration().methods
    packages, unavailable = find_policies(methods)
    assert (packages, unavailable) == ({}, {}), "all are LeRobot's or ours"


def test_options_that_a_policy_cannot_read_are_a_reason_and_no_traceback() -> None:
    methods = declared().methods
    broken = ("--policy.kl_weight={", "--policy.chunk_size=abc", "--policy.n_action_steps=500", "--policy.no_such=1")
    given = {option: replace(methods["ours"], policy="act", options=(option,)) for option in broken}
    assert set(find_policies(given)[1]) == set(broken)


def changed(path: str, value: Any) -> dict[str, Any]:
    """The declaration with one value changed, ``None`` for left out."""
    made = content()
    *folders, name = path.split("/")
    inner = made
    for folder in folders:
        inner = inner[folder]
    inner[name] = value
    if value is None:
        del inner[name]
    return made


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("reference", "theirs", "reference is 'theirs'"),
        ("methods/ours/demonstrations", "some", "methods.ours.demonstrations is 'some'"),
        ("methods/ours/policy", None, "methods.ours needs a policy"),
        ("methods/ours/expert", ["--expert=static"], "methods.ours needs a policy, or an expert"),
        ("methods/theirs", {"title": "a", "like": "none"}, "methods.theirs.like is 'none'"),
        ("methods/theirs", {"title": "a", "like": "theirs"}, "methods.theirs.like is 'theirs'"),
        ("methods/theirs", {"like": "ours"}, "methods.theirs lacks title"),
        ("methods", {"ours": 3, "theirs": {"title": "a", "like": "ours"}}, "methods.theirs.like is 'ours'"),
        ("methods/theirs", {"title": "a", "expert": ["--a=b"], "demonstrations": "static"}, "without demonstrations"),
        ("methods/ours/checkpoint", "act", "USER/NAME of a checkpoint"),
        ("methods/theirs", {"title": "a", "policy": "b", "checkpoint": "c/d", "train": ["--a=b"]}, "has a checkpoint"),
        ("methods/theirs", {"title": "a", "policy": "b", "checkpoint": "c/d"}, "needs both checkpoint and revision"),
        ("methods/ours/revision", "v1", "needs both checkpoint and revision"),
        ("methods/ours/revision", "a b", "a commit (40 hex digits) or a tag"),
        ("methods/ours/revision", "main", "a commit (40 hex digits) or a tag"),
        ("methods/ours/data_of", "untrained", "methods.ours.data_of is 'untrained'"),
        ("methods/ours/data_of", "ours_on_static", "methods.ours has data_of another method"),
        ("methods/ours/polciy", "act", "methods.ours has an unknown field 'polciy'"),
        ("methods/ours/options", ["--steps=3"], "an option --policy.NAME=VALUE"),
        ("methods/ours/train", ["steps"], "an option --NAME=VALUE"),
        ("methods/ours/train", ["--output_dir=elsewhere"], "folder, package or push"),
        ("methods/ours/evaluate", ["--env.discover_packages_path=theirs"], "folder, package or push"),
        ("methods/ours/train", ["--save_checkpoint_to_hub=true"], "folder, package or push"),
        ("methods/ours/evaluate", ["--env={type: adamanip_safe, locked: false}"], "of no group"),
        (f"scales/{SCALE}/evaluate", ["--env=type: adamanip_safe"], "of no group"),
        ("methods/ours/evaluate", ["--env.fps=include mine.yaml"], "of no group, file"),
        ("methods/ours/evaluate", ["--env.fps='include mine.yaml'"], "of no group, file"),
        ("methods/ours/options", ["--policy.inference=!include mine.yaml"], "an option --policy.NAME=VALUE"),
        ("methods/ours/options", ["--policy.push_to_hub=true"], "an option --policy.NAME=VALUE"),
        ("methods/ours/options", ["--policy.type=act"], "an option --policy.NAME=VALUE"),
        (
            "methods/ours/options",
            ["--policy.path=somebody/else"],
            "methods.ours has --policy.path=somebody/else and no",
        ),
        ("methods/ours/options", ["--policy.pretrained_path=a/b"], "no learns_from"),
        ("methods/ours/train", ["--dataset.root=mine/unseen"], "no learns_from"),
        ("methods/ours/train_at", {SCALE: ["--dataset.repo_id=me/unseen"]}, "no learns_from"),
        ("methods/ours/evaluate", ["--policy.pretrained_revision=v1"], "no learns_from"),
        (f"scales/{SCALE}/evaluate", ["--policy.path=a/b"], f"scales.{SCALE}.evaluate has --policy.path=a/b"),
        ("methods/ours/steps", {"huge": 3}, "methods.ours.steps is 'huge'"),
        ("methods/ours/train_at", {"huge": []}, "methods.ours.train_at is 'huge'"),
        ("methods/ours/train_at", {"huge": ["steps"]}, "an option --NAME=VALUE"),
        ("methods/ours/paper", "ours", "paper is 'ours'"),
        ("methods/ours/title", "a | b", "title is 'a | b'"),
        ("methods/Ours", {}, "a name of small letters"),
        (f"scales/{SCALE}/episodes", 0, "episodes is 0"),
        (f"scales/{SCALE}/episodes", None, f"scales.{SCALE} lacks episodes"),
        (f"scales/{SCALE}/categories", ["teapot"], "'teapot'"),
        (f"scales/{SCALE}/splits", ["external"], "'external'"),
        (f"scales/{SCALE}/seeds", [], "seeds is []"),
        (f"scales/{SCALE}/seeds", [1000, 0], f"scales.{SCALE}.seeds has 0 after the first"),
        ("demonstrations/static/expert", "clever", "expert is 'clever'"),
        ("demonstrations/static/trials", 0, "trials is 0"),
        ("nonsense", 1, "unknown field 'nonsense'"),
    ],
)
def test_a_mistake_is_named(path: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError) as error:  # noqa: PT011  (the text is what matters)
        parse_declaration(changed(path, value))
    assert message in str(error.value)


def test_every_group_of_lerobots_options_is_refused_as_a_whole() -> None:
    from draccus.wrappers import DataclassWrapper
    from draccus.wrappers.wrapper import AggregateWrapper
    from lerobot.configs.eval import EvalPipelineConfig
    from lerobot.configs.train import TrainPipelineConfig

    configurations = (DataclassWrapper(kind) for kind in (EvalPipelineConfig, TrainPipelineConfig))
    children = [child for configuration in configurations for child in configuration._children]
    assert {child.name for child in children if isinstance(child, AggregateWrapper)} == set(GROUPS)
    for name in GROUPS:
        with pytest.raises(ValueError, match="of no group"):
            parse_declaration(changed("methods/ours/train", [f"--{name}={{}}"]))


def test_every_shipped_declaration_can_be_read_and_no_scale_has_the_name_of_another() -> None:
    """Result files are stored by scale."""
    scales = [name for path in PAPER_TABLE.parent.glob("*.toml") for name in read_declaration(path).scales]
    assert {"cpu", "validation"} < set(scales)
    assert len(scales) == len(set(scales))


def test_a_file_that_is_no_declaration_is_one_error(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    for text in ("reference = ", "reference = 'x'"):
        path.write_text(text)
        with pytest.raises(ConfigurationError, match=r"Not a declaration of a benchmark\.\n  got:     .*mine\.toml"):
            read_declaration(path)
    with pytest.raises(ConfigurationError, match="Not a declaration"):
        read_declaration(tmp_path / "absent.toml")
    with pytest.raises(ConfigurationError, match="Unknown scale"):
        declared().scale("huge")


def test_what_is_left_out_has_the_defaults_of_adamanip_collect() -> None:
    from lerobot_adamanip.cli.collect import CollectCommand

    made, collect = declared().demonstrations["adaptive"], CollectCommand(Path("root"))
    for name in ("expert", "trials", "late_starts", "num_points", "poses", "mechanism_rules"):
        assert getattr(made, name) == getattr(collect, name)


def test_the_page_tells_the_scales_and_methods_as_they_are() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "benchmark.md").read_text(encoding="utf-8")
    found = read_declaration()
    for name, scale in found.scales.items():
        cell = f"{len(scale.seeds)} × {scale.episodes}"
        demonstrations = f"{scale.demonstrations}{' of an object' * scale.demonstrations_per_object}"
        numbers = (demonstrations, f"{scale.steps:,}", cell, ", ".join(scale.splits))
        assert re.search(rf"^\| `{name}` \|.*\| {' . '.join(map(str, numbers))} \|$", page, re.MULTILINE), name
    for name, method in found.methods.items():
        learns = "nothing"
        if method.is_trained:
            wanted = found.demonstrations[method.demonstrations]
            learns = f"{wanted.expert}{', with pictures' if wanted.image_size else ''}"
        assert f"\n| `{name}` | {learns} | {method.paper or ''}{' ' * bool(method.paper)}|\n" in page, name
